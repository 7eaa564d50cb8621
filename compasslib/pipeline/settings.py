"""Files, modules and settings that each stage takes from the cruise's configuration.

A stage is given only the keys that it uses, so that a change of a key re-runs only the stages that it affects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from compasslib import calibrations, plugins, readers
from compasslib.archive import deposit, provenance
from compasslib.calibrations import KINDS
from compasslib.config import calibrations as configured
from compasslib.config import compasses
from compasslib.config.cruise import CALIBRATIONS, CONFIG, Cruise
from compasslib.config.schema import Instrument, Mooring
from compasslib.earthfield import parse_applied_declination
from compasslib.inference import kinds

DEPLOYMENT_KEYS = ("pressure_offset", "clock_offset_seconds", "clock_drift_seconds", "direction_reference")
FIGURES = ("deviation", "diagnosis", "histograms", "progressive", "roses", "scatter", "sticks", "timeline")
OF_GRID = ("section", "profile")  # figures of the gridded product
SCRIPTS = provenance.WORKFLOW / "scripts"
EFFECTS = str(provenance.PACKAGE / "effects/__init__.py")


class Wildcards(NamedTuple):
    """The subject of one job, as Snakemake's wildcards."""

    mooring: str = ""
    role: str = ""
    calibration: str = ""
    compass: str = ""


@dataclass(frozen=True)
class Moorings:
    """Inputs and settings of a mooring's stages; each method takes a job's wildcards."""

    cruise: Cruise

    def templates(self) -> list[str]:
        return sorted(str(path) for path in (provenance.PACKAGE / "report/templates").iterdir())

    def reader_code(self, wildcards: Any, scripts: Path = SCRIPTS) -> str:
        """Hash the modules that read one instrument, with the reader of its own format only."""
        reader = readers.get_format(self._instrument(wildcards).format)
        modules = provenance.sources(scripts / "read.py", f"compasslib.readers.{reader.module}")
        return hash_code(modules, reader.plugin)

    def raw_files(self, wildcards: Any) -> list[str]:
        return list(self._instrument(wildcards).files)

    def companion_files(self, wildcards: Any) -> list[str]:
        """List the files besides the raw ones that the reading of one instrument needs and that its settings name."""
        series = [file for each in self.series(wildcards).values() for file in each["files"]]
        return [*self._instrument(wildcards).pressure_files, *series]

    def series(self, wildcards: Any) -> dict[str, dict[str, Any]]:
        """Return the settings of covariates in tables, which are read with the affected instrument, by name."""
        mooring = self._mooring(wildcards)
        given = mooring.covariates.items() if wildcards.role == mooring.compromised else ()
        return {name: each.model_dump(exclude={"format"}) for name, each in given if each.format == "table"}

    def all_raw_files(self, wildcards: Any) -> list[str]:
        """List the raw files that one mooring uses: of instruments, covariates and ready-made pairs."""
        mooring = self._mooring(wildcards)
        used = [mooring.instruments[role] for role in self.instrument_names(wildcards)]
        series = [file for each in mooring.covariates.values() if each.format == "table" for file in each.files]
        instruments = [file for each in used for file in (*each.files, *each.pressure_files)]
        pairs = [file for member in self.members(wildcards) for file in self.ready_pairs(member)]
        return [*instruments, *series, *pairs]

    def form(self, wildcards: Any) -> str:
        return str(self._instrument(wildcards).format)

    def reader_settings(self, wildcards: Any) -> dict[str, Any]:
        """Select the keys of one instrument that are arguments of its reader."""
        instrument = self._instrument(wildcards)
        unset = {key for key in readers.TABLE_KEYS if key not in instrument.model_fields_set}
        keys = [key for key in readers.get_format(instrument.format).keys if key not in unset]
        numbered = {"serial_number": self.serial_number(wildcards)} if "serial_number" in keys else {}
        return _plain(instrument, [key for key in keys if key not in numbered]) | numbered

    def deployment(self, wildcards: Any) -> dict[str, Any]:
        """Compose the arguments of ``deployment.apply_deployment``."""
        mooring, instrument = self._mooring(wildcards), self._instrument(wildcards)
        # Some readers remove the declination themselves: a PD0 file may hold it as heading bias.
        taken = readers.get_format(instrument.format).takes_declination
        inside = 0.0 if taken else instrument.declination_applied or 0.0
        return _plain(instrument, DEPLOYMENT_KEYS) | {
            "start_s": mooring.start_s,
            "end_s": mooring.end_s,
            "water_depth": mooring.water_depth,
            "latitude": mooring.latitude,
            "nominal_depth": instrument.depth,
            "declination_applied": inside,
            "exclude": [(window.from_s, window.to_s) for window in instrument.exclude],
            "affected": wildcards.role == mooring.compromised,
            "quality": mooring.quality.model_dump(),
        }

    def place_and_declination(self, wildcards: Any) -> dict[str, Any]:
        """Compose the arguments of ``earthfield.field_along``: position, dates and declination of one mooring."""
        mooring = self._mooring(wildcards)
        inside = {
            f"{role} ({part})" if each.differs else role: degrees
            for role in used_instruments(mooring)
            if (each := parse_applied_declination(mooring.instruments[role].declination_applied)) is not None
            for part, degrees in each._asdict().items()
        }
        return {
            "latitude": mooring.latitude,
            "longitude": mooring.longitude,
            "start_s": mooring.start_s,
            "end_s": mooring.end_s,
            "declination": None if mooring.declination == "auto" else mooring.declination,
            "applied": {name: degrees for name, degrees in inside.items() if degrees},
        }

    def pairing_rules(self, wildcards: Any) -> dict[str, Any]:
        """Compose the pairing rules; the published method averages the bins, as published, instead of predicting."""
        rules = self.cruise.options.overlap.model_dump()
        published = self._mooring(wildcards).fit.fitted == "von_appen"
        return rules | {"predict": rules["predict"] and not published}

    def members(self, wildcards: Any) -> list[Wildcards]:
        """List a mooring's parts, one per affected instrument; for a part, the part itself."""
        return [Wildcards(name) for name in self.cruise.whole.get(wildcards.mooring, [wildcards.mooring])]

    def of_members(self, file: str) -> Callable[[Any], list[str]]:
        """Return a function that lists one file of the results of each affected instrument."""
        return lambda wildcards: [f"results/{member.mooring}/{file}" for member in self.members(wildcards)]

    def affected(self, wildcards: Any) -> list[str]:
        """List the record files of all affected instruments."""
        return [self.compromised(member) for member in self.members(wildcards)]

    def compromised(self, wildcards: Any) -> str:
        return _record(wildcards.mooring, self._mooring(wildcards).compromised)

    def reference(self, wildcards: Any) -> list[str]:
        """List the record files of the references, none where the mooring has no reference."""
        member = self.members(wildcards)[0].mooring
        return [_record(member, role) for role in self._mooring(wildcards).reference]

    def records(self, wildcards: Any) -> list[str]:
        if wildcards.mooring not in self.cruise.moorings:
            return []
        return [_record(wildcards.mooring, role) for role in used_instruments(self._mooring(wildcards))]

    def archived(self, wildcards: Any) -> list[str]:
        """List corrected.nc and overlap.nc; none for a mooring whose several affected instruments have their own."""
        folder = f"results/{wildcards.mooring}"
        return [f"{folder}/corrected.nc", f"{folder}/overlap.nc"] if wildcards.mooring in self.cruise.moorings else []

    def method(self, wildcards: Any) -> str:
        return str(self._mooring(wildcards).fit.fitted)

    def ready_pairs(self, wildcards: Any) -> list[str]:
        """List the file of ready-made pairs, none where pairs are found by this software."""
        return list(self._mooring(wildcards).fit.file or ())

    def pair_columns(self, wildcards: Any) -> dict[str, Any] | None:
        columns = self._mooring(wildcards).fit.columns
        return None if columns is None else columns.model_dump()

    def given_compass(self, wildcards: Any) -> dict[str, Any] | None:
        """Return model, coefficients and covariance of a compass given in the YAML file; None where it is fitted."""
        fit = self._mooring(wildcards).fit
        return fit.model_dump(include={"model", "coefficients", "covariance"}) if fit.coefficients else None

    def tilt(self, wildcards: Any) -> bool:
        return bool(self._mooring(wildcards).fit.tilt)

    def diagnose(self, wildcards: Any) -> dict[str, Any]:
        """Compose the options of the search for unmodelled effects in one mooring."""
        mooring = self._mooring(wildcards)
        trusted = [mooring.instruments[name].direction_reference for name in mooring.reference]
        magnetic = not trusted or "magnetic" in trusted
        derived = {"reference_magnetic": magnetic, "constant_confirmed": mooring.confirmed.constant}
        if mooring.fit.coefficients and mooring.fit.model == "von_appen":  # a given series is not fitted again
            derived["apply"] = False
        return mooring.diagnose.model_dump() | derived

    def product(self, wildcards: Any) -> dict[str, Any]:
        return dict(self._mooring(wildcards).product.model_dump(mode="json"))

    def gridded(self, wildcards: Any) -> list[str]:
        """List the files of the gridded product, with daily means if configured; none where it is switched off."""
        wanted = self._mooring(wildcards).product
        whole = wildcards.mooring in self.cruise.whole  # not one of several affected instruments
        files = ["gridded.nc", *["gridded_daily.nc"] * wanted.daily] if wanted.grid and whole else []
        return [f"results/{wildcards.mooring}/{file}" for file in files]

    def figures(self, wildcards: Any) -> list[str]:
        single = FIGURES if wildcards.mooring in self.cruise.moorings else ()
        names = (*single, *(OF_GRID if self.gridded(wildcards) else ()))
        return list_figures(self.cruise, f"results/{wildcards.mooring}", names)

    def instrument_names(self, wildcards: Any) -> list[str]:
        """Return the names of the affected instruments and of the references."""
        return [
            *(self._mooring(each).compromised for each in self.members(wildcards)),
            *self._mooring(wildcards).reference,
        ]

    def reference_compasses(self, wildcards: Any) -> list[dict[str, Any]]:
        """List the arguments of ``deviation.reference.reference_compass`` for each reference."""
        mooring = self._mooring(wildcards)
        return [
            {
                "name": name,
                "sigma_deg": mooring.instruments[name].compass_sigma_deg,
                "iron_nT": mooring.instruments[name].compass_iron_nT,
                "magnetic": mooring.instruments[name].direction_reference == "magnetic",
            }
            for name in mooring.reference
        ]

    def rotors(self, wildcards: Any) -> list[bool]:
        """List whether each reference counts its speed by a mechanical rotor."""
        mooring = self._mooring(wildcards)
        return [mooring.instruments[name].kind == "rotor" for name in mooring.reference]

    def sphere(self, wildcards: Any) -> bool:
        """Return whether iron near the affected instrument is declared."""
        mooring = self._mooring(wildcards)
        return mooring.instruments[mooring.compromised].sphere is not None or bool(self.sphere_distance_m(wildcards))

    def sphere_distance_m(self, wildcards: Any) -> tuple[float, float] | None:
        mooring = self._mooring(wildcards)
        return mooring.instruments[mooring.compromised].sphere_distance_m

    def observatory(self, wildcards: Any) -> list[str]:
        """List the files of the magnetic observatory that one mooring names, if any."""
        covariates = self._mooring(wildcards).covariates.values()
        return [file for each in covariates if each.format == "iaga2002" for file in each.files]

    def calibrations(self, wildcards: Any) -> list[str]:
        """List the calibration of a mooring, or those before and after it."""
        return [_calibration(name) for name in self._mooring(wildcards).fit.name]

    def parts(self, wildcards: Any) -> list[str]:
        """List the parts mounted near the affected compass."""
        mooring = self._mooring(wildcards)
        return list(mooring.instruments[mooring.compromised].parts)

    def superseded(self, wildcards: Any) -> dict[str, Any] | None:
        """Describe the deposit that the results of one mooring supersede; None where there is none."""
        if not self.cruise.options.supersedes:
            return None
        configuration, files = self.configuration()[f"mooring {wildcards.mooring}"], self.all_raw_files(wildcards)
        deposited = self.cruise.root / self.cruise.options.supersedes[0]
        described = deposit.describe_superseded(deposited, configuration, self.cruise.root)
        return described | {"files": {file: described["files"].get(file) for file in files}}

    def site(self, wildcards: Any) -> dict[str, Any]:
        mooring = self._mooring(wildcards)
        return {"name": mooring.name} | _place(mooring)

    def attributes(self, wildcards: Any) -> dict[str, Any]:
        """Merge the archive's attributes: the instrument's override the mooring's, which override the cruise's."""
        mooring = self._mooring(wildcards)
        return self.cruise.options.attributes | mooring.attributes | mooring.instruments[mooring.compromised].attributes

    def configuration(self) -> dict[str, list[str]]:
        """List the YAML files behind each mooring, calibration and compass, and under "" those of the whole cruise."""
        of_whole = {name: self.cruise.mooring_files[parts[0]] for name, parts in self.cruise.whole.items()}
        moorings = {f"mooring {name}": [CONFIG, file] for name, file in (self.cruise.mooring_files | of_whole).items()}
        calibrations = {f"calibration {n}": [CONFIG, f"{CALIBRATIONS}/{n}.yaml"] for n in self.cruise.calibrations}
        both = compasses.members(self.cruise.moorings, self.cruise.calibrations).items()
        joined = {
            f"compass {name}": [
                CONFIG,
                *(self.cruise.mooring_files[mooring] for mooring in names),
                *(f"{CALIBRATIONS}/{calibration}.yaml" for calibration in given),
            ]
            for name, (names, given) in both
        }
        return {"": [CONFIG]} | moorings | calibrations | joined

    def given(self, scripts: Path = SCRIPTS) -> list[str]:
        """List the files that jobs depend on: YAML files, raw files and scripts of this software."""
        settings = [file for files in self.configuration().values() for file in files]
        moorings = self.cruise.moorings.values()
        instruments = [instrument for mooring in moorings for instrument in mooring.instruments.values()]
        raw = [file for instrument in instruments for file in (*instrument.files, *instrument.pressure_files)]
        raw += [file for mooring in moorings for file in mooring.fit.file or ()]
        raw += [file for mooring in moorings for series in mooring.covariates.values() for file in series.files]
        raw += [file for calibration in self.cruise.calibrations.values() for file in calibration.raw_files]
        return list(dict.fromkeys([*settings, *raw, *map(str, scripts.glob("*.py"))]))

    def described(self) -> dict[str, dict[str, Any]]:
        return {name: _described(mooring) for name, mooring in self.cruise.moorings.items()}

    def array(self) -> list[dict[str, Any]]:
        """Describe position and instruments of each mooring, with all of its affected instruments together."""
        moorings = {name.split("/")[0]: mooring for name, mooring in self.cruise.moorings.items()}
        roles = {(name, role): "reference" for name, mooring in moorings.items() for role in mooring.reference}
        roles |= {(name.split("/")[0], m.compromised): "affected" for name, m in self.cruise.moorings.items()}
        return [
            {"name": name}
            | _place(mooring)
            | {
                "instruments": [
                    {
                        "depth_m": None if each.format == "mmp_acm" else each.depth,
                        "orientation": each.orientation,
                        "role": roles.get((name, role), "other"),
                    }
                    for role, each in mooring.instruments.items()
                ],
            }
            for name, mooring in moorings.items()
        ]

    def serial_number(self, wildcards: Any) -> str | None:
        """Look up an instrument's serial number in its attributes, for the affected one in the mooring's too."""
        stated = self._instrument(wildcards).attributes
        known = self.attributes(wildcards) if wildcards.role == self._mooring(wildcards).compromised else stated
        return next((str(known[key]) for key in ("serial_number", "sensor_serial_number") if key in known), None)

    def reading(self, wildcards: Any) -> dict[str, Any]:
        """Compose the arguments of ``read.record_of`` for one instrument."""
        return {
            "raw": self.raw_files(wildcards),
            "form": self.form(wildcards),
            "reader": self.reader_settings(wildcards),
            "deployment": self.deployment(wildcards),
            "series": self.series(wildcards),
        }

    def _mooring(self, wildcards: Any) -> Mooring:
        return self.cruise.moorings[self.members(wildcards)[0].mooring]

    def _instrument(self, wildcards: Any) -> Instrument:
        return self._mooring(wildcards).instruments[wildcards.role]


@dataclass(frozen=True)
class Calibrations:
    """Inputs and settings of a calibration's stages; each method takes a job's wildcards."""

    cruise: Cruise

    def raw_files(self, wildcards: Any) -> list[str]:
        return list(self.cruise.calibrations[wildcards.calibration].raw_files)

    def earlier(self, wildcards: Any) -> list[str]:
        """List the calibrations to compare with, possibly none."""
        return [_calibration(other) for other in self.cruise.calibrations[wildcards.calibration].compare_with]

    def kind(self, wildcards: Any) -> str:
        return str(self.cruise.calibrations[wildcards.calibration].kind)

    def settings(self, wildcards: Any) -> dict[str, Any]:
        return configured.settings(self.cruise.calibrations[wildcards.calibration])

    def diagnose(self, wildcards: Any) -> dict[str, Any]:
        return dict(self.cruise.options.diagnose.model_dump())

    def is_diagnosed(self, name: str) -> bool:
        return self.cruise.calibrations[name].kind in kinds.KINDS

    def figures(self, wildcards: Any) -> list[str]:
        folder = f"results/calibrations/{wildcards.calibration}"
        names, kind = calibrations.figure_names(self.kind(wildcards)), self.kind(wildcards)
        compared = bool(self.earlier(wildcards)) and KINDS[kind].by_heading
        return list_figures(self.cruise, folder, [*names, *(["compared"] if compared else [])])

    def diagnosis_figures(self, wildcards: Any) -> list[str]:
        return list_figures(self.cruise, f"results/calibrations/{wildcards.calibration}", ("diagnosis",))

    def module(self, wildcards: Any) -> list[str]:
        """Return the module that calibrates this kind, which the stage imports by name."""
        return [f"compasslib.calibrations.{KINDS[self.kind(wildcards)].module}"]

    def diagnosis_module(self, wildcards: Any) -> list[str]:
        return [kinds.KINDS[self.kind(wildcards)]]


@dataclass(frozen=True)
class Compasses:
    """Inputs and settings of the stages of a shared compass; each method takes a job's wildcards."""

    cruise: Cruise

    @cached_property
    def members(self) -> dict[str, tuple[list[str], list[str]]]:
        """Moorings and calibrations of each compass."""
        return compasses.members(self.cruise.moorings, self.cruise.calibrations)

    @cached_property
    def moorings(self) -> dict[str, str]:
        """The compass of each mooring that names one."""
        return {mooring: name for name, (moorings, _) in self.members.items() for mooring in moorings}

    def summaries(self, wildcards: Any) -> list[str]:
        """List the summaries of each mooring of a compass, analysed separately."""
        return [f"results/{name}/work/alone/summary.json" for name in self.members[wildcards.compass][0]]

    def calibrations(self, wildcards: Any) -> list[str]:
        return [_calibration(name) for name in self.members[wildcards.compass][1]]

    def min_effect_deg(self, wildcards: Any) -> float:
        return self.cruise.options.diagnose.min_effect_deg

    def spheres(self, wildcards: Any) -> dict[str, str | None]:
        """Return the sphere or frame that carried the instrument of each record of a compass, None if not stated."""
        moorings, given = self.members[wildcards.compass]
        moored = {name: self.cruise.moorings[name] for name in moorings}
        stated = {name: mooring.instruments[mooring.compromised].sphere for name, mooring in moored.items()}
        stated |= {name: self.cruise.calibrations[name].sphere for name in given}
        return {name: sphere if isinstance(sphere, str) else None for name, sphere in stated.items()}

    def figures(self, wildcards: Any) -> list[str]:
        return list_figures(self.cruise, f"results/compasses/{wildcards.compass}", ("coefficients", "curve"))

    def joined(self, wildcards: Any) -> str:
        """Return the path of the joint result of a mooring's compass."""
        return f"results/compasses/{self.moorings[wildcards.mooring]}/compass.json"


def list_figures(cruise: Cruise, folder: str, names: Iterable[str]) -> list[str]:
    """List the figure files in a folder of results, in all configured formats."""
    return [f"{folder}/figures/{name}.{ending}" for ending in cruise.options.figures.formats for name in names]


def hash_code(modules: tuple[str, ...], also: str = "") -> str:
    """Hash library files, ``also``, and the effects of plug-in packages where the modules include effects."""
    known = plugins.declared_plugins(plugins.EFFECTS) if EFFECTS in modules else ()
    return " ".join(filter(None, (provenance.code(modules), also, *map(plugins.code_identity, known))))


def _described(mooring: Mooring) -> dict[str, Any]:
    roles = {"affected": [mooring.compromised], "reference": mooring.reference}
    depths = {name: each.depth for name, each in mooring.instruments.items()}
    texts = {
        role: ", ".join(
            f"{name} ({mooring.instruments[name].format}{'' if depths[name] is None else f', {depths[name]:g} m'})"
            for name in names
        )
        or "none"
        for role, names in roles.items()
    }
    return _place(mooring) | {
        "start": mooring.start.isoformat(),
        "end": mooring.end.isoformat(),
        "instruments": texts,
        "roles": used_instruments(mooring),
    }


def _place(mooring: Mooring) -> dict[str, Any]:
    return {"latitude": mooring.latitude, "longitude": mooring.longitude, "water_depth_m": mooring.water_depth}


def used_instruments(mooring: Mooring) -> list[str]:
    """List the instruments that a mooring uses: the affected one and the references."""
    return [mooring.compromised, *mooring.reference]


def _calibration(name: str) -> str:
    return f"results/calibrations/{name}/calibration.json"


def _record(mooring: str, role: str) -> str:
    return f"results/{mooring}/work/{role}.nc"


def _plain(instrument: Instrument, keys: Sequence[str]) -> dict[str, Any]:
    dumped = instrument.model_dump(mode="json")
    return {key: dumped[key] for key in keys}
