"""What each rule of the workflow needs from the cruise's configuration: files, modules and narrow settings.

A rule is given only the keys that it uses, so that a change of one key re-runs the stages it affects and no other.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from compasslib import calibrations, plugins, readers
from compasslib.archive import provenance
from compasslib.calibrations import KINDS
from compasslib.config import calibrations as configured
from compasslib.config import compasses
from compasslib.config.cruise import CALIBRATIONS, CONFIG, Cruise
from compasslib.config.schema import Instrument, Mooring
from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.inference import kinds
from compasslib.pipeline.compasses import Compasses
from compasslib.pipeline.stopped import Stopped

DEPLOYMENT_KEYS = ("pressure_offset", "clock_offset_seconds", "clock_drift_seconds", "direction_reference")
EFFECTS = str(provenance.PROJECT / "compasslib/effects/__init__.py")
METHODS = ("exact", "von_appen", "calibration")
FIGURES = ("deviation", "diagnosis", "progressive", "roses", "scatter", "sticks", "timeline")
MADE = (
    *("corrected.nc", "assessment.json", "forms.json", "deviation.json", "diagnosis.json", "overlap.nc"),
    *("wide/overlap.nc", "work/field.json", "work/fit.json", "work/pictures.json"),
    *(f"figures/{figure}.png" for figure in FIGURES),
)  # of each mooring, beside its instruments' records
SIMULATED = tuple(f"EG{k}" for k in range(1, 8))  # the moorings of the demonstration cruise


SUMMARY, REPORT, MANIFEST = "results/summary.csv", "results/report.html", "results/ro-crate-metadata.json"
LAST = ("corrected.nc", "assessment.json", "forms.json", *(f"figures/{figure}.png" for figure in FIGURES))


@dataclass(frozen=True)
class Moorings:
    """Answers for the Snakefile; each method takes a job's wildcards."""

    cruise: Cruise
    scripts: Path

    def code(self, script: str, beside: str = "") -> Callable[[Any], str]:
        """Return what gives one hash of the library files behind a script, and a version of another program beside."""
        return lambda wildcards: _code(provenance.sources(self.scripts / script), beside)

    def templates(self) -> list[str]:
        """Return the templates of the report."""
        return sorted(str(path) for path in (provenance.PROJECT / "compasslib/report/templates").iterdir())

    def reader_code(self, wildcards: Any) -> str:
        """Return one hash of the library files behind the reading of one instrument, its own format's reader only."""
        reader = readers.get_format(self._instrument(wildcards).format)
        return _code(provenance.sources(self.scripts / "read.py", f"compasslib.readers.{reader.module}"), reader.plugin)

    def raw_files(self, wildcards: Any) -> list[str]:
        """Return the raw files of one instrument."""
        return list(self._instrument(wildcards).files)

    def companion_files(self, wildcards: Any) -> list[str]:
        """Return the files that the reading of one instrument needs besides; it is given them by its settings."""
        series = [file for one in self.series(wildcards).values() for file in one["files"]]
        return [*self._instrument(wildcards).pressure_files, *series]

    def series(self, wildcards: Any) -> dict[str, dict[str, Any]]:
        """Return the tables of other series that the search may use, with the instrument that is corrected."""
        mooring = self._mooring(wildcards)
        given = mooring.covariates.items() if wildcards.role == mooring.compromised else ()
        return {name: one.model_dump(exclude={"format"}) for name, one in given if one.format == "table"}

    def all_raw_files(self, wildcards: Any) -> list[str]:
        """Return the raw files of the instruments that one mooring uses."""
        mooring = self._mooring(wildcards)
        used = [mooring.instruments[role] for role in _roles(mooring)]
        series = [file for one in mooring.covariates.values() if one.format == "table" for file in one.files]
        return [file for one in used for file in (*one.files, *one.pressure_files)] + series

    def form(self, wildcards: Any) -> str:
        """Return the format of one instrument."""
        return str(self._instrument(wildcards).format)

    def reader_settings(self, wildcards: Any) -> dict[str, Any]:
        """Return the keys of one instrument that its reader takes."""
        instrument = self._instrument(wildcards)
        unset = {key for key in readers.TABLE_KEYS if key not in instrument.model_fields_set}
        keys = [key for key in readers.get_format(instrument.format).keys if key not in unset]
        numbered = {"serial_number": self.serial_number(wildcards)} if "serial_number" in keys else {}
        return _plain(instrument, [key for key in keys if key not in numbered]) | numbered

    def deployment(self, wildcards: Any) -> dict[str, Any]:
        """Return what turns one instrument's series into its record inside the deployment."""
        mooring, instrument = self._mooring(wildcards), self._instrument(wildcards)
        # Some readers take it out themselves: a PD0 file may hold it as heading bias.
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
        }

    def place_and_declination(self, wildcards: Any) -> dict[str, Any]:
        """Return position, dates and declination of one mooring."""
        mooring = self._mooring(wildcards)
        inside = {
            f"{role} ({part})" if one.differs else role: degrees
            for role in _roles(mooring)
            if (one := parse_applied_declination(mooring.instruments[role].declination_applied)) is not None
            for part, degrees in one._asdict().items()
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
        """Return what makes a pair; the published method keeps the published mean of the bins."""
        rules = self.cruise.options.overlap.model_dump()
        published = self._mooring(wildcards).fit.method == "von_appen"
        return rules | {"predict": rules["predict"] and not published}

    def compromised(self, wildcards: Any) -> str:
        """Return the record of the instrument to correct."""
        return _record(wildcards.mooring, self._mooring(wildcards).compromised)

    def reference(self, wildcards: Any) -> list[str]:
        """Return the records of the references; none where the mooring has none."""
        return [_record(wildcards.mooring, role) for role in self._mooring(wildcards).reference]

    def records(self, wildcards: Any) -> list[str]:
        """Return the records of the instruments that one mooring uses."""
        return [_record(wildcards.mooring, role) for role in _roles(self._mooring(wildcards))]

    def roles(self, names: Iterable[str]) -> dict[str, list[str]]:
        """Return the instruments that each of some moorings uses; others of its results are of an earlier time."""
        return {name: _roles(self.cruise.moorings[name]) for name in names}

    def method(self, wildcards: Any) -> str:
        """Return the method that one mooring is fitted by."""
        return str(self._mooring(wildcards).fit.method)

    def tilt(self, wildcards: Any) -> bool:
        """Return whether pitch and roll enter the fit of one mooring."""
        return bool(self._mooring(wildcards).fit.tilt)

    def diagnose(self, wildcards: Any) -> dict[str, Any]:
        """Return what may be chosen about the search for unmodelled effects in one mooring."""
        mooring = self._mooring(wildcards)
        trusted = [mooring.instruments[name].direction_reference for name in mooring.reference]
        magnetic = not trusted or "magnetic" in trusted
        beside = {"reference_magnetic": magnetic, "constant_confirmed": mooring.confirmed.constant}
        return mooring.diagnose.model_dump() | beside

    def observatory(self, wildcards: Any) -> list[str]:
        """Return the files of the observatory that one mooring names, none where it names none."""
        every = self._mooring(wildcards).covariates.values()
        return [file for one in every if one.format == "iaga2002" for file in one.files]

    def by_calibration(self) -> list[str]:
        """Return the moorings that a calibration elsewhere corrects."""
        return [name for name, mooring in self.cruise.moorings.items() if mooring.fit.method == "calibration"]

    def by_pairs(self) -> list[str]:
        """Return the moorings that their own pairs correct."""
        return [name for name in self.cruise.moorings if name not in self.by_calibration()]

    def calibration(self, wildcards: Any) -> str:
        """Return the calibration that corrects one mooring."""
        return f"results/calibrations/{self._mooring(wildcards).fit.name}/calibration.json"

    def site(self, wildcards: Any) -> dict[str, Any]:
        """Return name and place of one mooring."""
        mooring = self._mooring(wildcards)
        return {
            "name": mooring.name,
            "latitude": mooring.latitude,
            "longitude": mooring.longitude,
            "water_depth_m": mooring.water_depth,
        }

    def attributes(self, wildcards: Any) -> dict[str, Any]:
        """Return the archive's attributes: the cruise's, the mooring's over them, the instrument's over both."""
        mooring = self._mooring(wildcards)
        return self.cruise.options.attributes | mooring.attributes | mooring.instruments[mooring.compromised].attributes

    def configuration(self) -> dict[str, list[str]]:
        """Return the YAML files behind each mooring and calibration, and under "" those behind the whole cruise."""
        moorings = {f"mooring {name}": [CONFIG, file] for name, file in self.cruise.mooring_files.items()}
        calibrations = {f"calibration {n}": [CONFIG, f"{CALIBRATIONS}/{n}.yaml"] for n in self.cruise.calibrations}
        both = compasses.members(self.cruise.moorings, self.cruise.calibrations).items()
        joined = {
            f"compass {name}": [
                CONFIG,
                *(self.cruise.mooring_files[mooring] for mooring in of),
                *(f"{CALIBRATIONS}/{calibration}.yaml" for calibration in given),
            ]
            for name, (of, given) in both
        }
        return {"": [CONFIG]} | moorings | calibrations | joined

    def described(self) -> dict[str, dict[str, Any]]:
        """Return place, dates and instruments of each mooring, for the report."""
        return {name: _described(mooring) for name, mooring in self.cruise.moorings.items()}

    def serial_number(self, wildcards: Any) -> str | None:
        """Return what the metadata say, the mooring's attributes being the affected instrument's."""
        own = self._instrument(wildcards).attributes
        known = self.attributes(wildcards) if wildcards.role == self._mooring(wildcards).compromised else own
        return next((str(known[key]) for key in ("serial_number", "sensor_serial_number") if key in known), None)

    def _mooring(self, wildcards: Any) -> Mooring:
        return self.cruise.moorings[wildcards.mooring]

    def _instrument(self, wildcards: Any) -> Instrument:
        return self._mooring(wildcards).instruments[wildcards.role]


@dataclass(frozen=True)
class Calibrations:
    """Answers for the rules; each method takes a job's wildcards."""

    cruise: Cruise
    scripts: Path

    def made(self, name: str) -> list[str]:
        """Return all files that the rules make of one calibration."""
        tables = [f"results/calibrations/{name}/{file}.csv" for file in ("table", "points")]
        diagnosis = self._diagnosis(name) if self._diagnosed(name) else []
        return [self.content(name), *tables, *self._drawn(name), *diagnosis]

    def content(self, name: str) -> str:
        """Return a calibration's calibration.json."""
        return f"results/calibrations/{name}/calibration.json"

    def raw_files(self, wildcards: Any) -> list[str]:
        """Return the raw files of one calibration, in the order of its YAML file."""
        return list(self.cruise.calibrations[wildcards.calibration].files)

    def earlier(self, wildcards: Any) -> list[str]:
        """Return the calibration that one is compared with; none where it stands alone."""
        other = self.cruise.calibrations[wildcards.calibration].compare_with
        return [] if other is None else [self.content(other)]

    def kind(self, wildcards: Any) -> str:
        """Return the kind of one calibration."""
        return str(self.cruise.calibrations[wildcards.calibration].kind)

    def settings(self, wildcards: Any) -> dict[str, Any]:
        """Return the keys of one calibration's file that its kind takes."""
        return configured.settings(self.cruise.calibrations[wildcards.calibration])

    def modules(self, wildcards: Any) -> tuple[str, ...]:
        """Return the library files behind one calibration, its own kind's only."""
        own = f"compasslib.calibrations.{KINDS[self.kind(wildcards)].module}"
        return provenance.sources(self.scripts / "calibrate.py", own)

    def diagnosis_modules(self, wildcards: Any) -> tuple[str, ...]:
        """Return the library files behind the diagnosis of one calibration, its own kind's only."""
        own = kinds.KINDS[self.kind(wildcards)]
        return provenance.sources(self.scripts / "diagnose_calibration.py", own)

    def diagnose(self) -> dict[str, Any]:
        """Return what was chosen about diagnoses."""
        return dict(self.cruise.options.diagnose.model_dump())

    def figures(self, kind: str) -> list[str]:
        """Return the figures of one kind."""
        return calibrations.figure_names(kind)

    def figure_modules(self, wildcards: Any) -> tuple[str, ...]:
        """Return the library files behind the figures of one calibration."""
        return provenance.sources(self.scripts / "calibration_figures.py")

    def of_kind(self, kind: str) -> list[str]:
        """Return the calibrations of one kind."""
        return [name for name, file in self.cruise.calibrations.items() if file.kind == kind]

    def _diagnosed(self, name: str) -> bool:
        return self.cruise.calibrations[name].kind in kinds.KINDS

    def _diagnosis(self, name: str) -> list[str]:
        there = f"results/calibrations/{name}"
        return [f"{there}/diagnosis.json", f"{there}/figures/diagnosis.png"]

    def _drawn(self, name: str) -> list[str]:
        figures = self.figures(self.cruise.calibrations[name].kind)
        return [f"results/calibrations/{name}/figures/{figure}.png" for figure in figures]


@dataclass(frozen=True)
class Plan:
    """Answers for the rules that take all moorings together."""

    moorings: Moorings
    calibrations: Calibrations
    compasses: Compasses
    stopped: Stopped

    @property
    def cruise(self) -> Cruise:
        """Return the cruise's configuration."""
        return self.moorings.cruise

    def of(self, *files: str) -> Callable[[Any], list[str]]:
        """Return what gives these files of each mooring."""
        return lambda wildcards: [f"results/{name}/{file}" for file in files for name in self._moorings()]

    def records(self, wildcards: Any) -> list[str]:
        """Return the records of the instruments of all moorings."""
        roles = self.moorings.roles(self._moorings()).items()
        return [f"results/{name}/work/{role}.nc" for name, used in roles for role in used]

    def roles(self, wildcards: Any) -> dict[str, list[str]]:
        """Return the instruments that each mooring uses."""
        return self.moorings.roles(self._moorings())

    def described(self, wildcards: Any) -> dict[str, dict[str, Any]]:
        """Return place, dates and instruments of each mooring, those that were stopped among them."""
        return self.moorings.described()

    def calibrated(self, wildcards: Any) -> list[str]:
        """Return all files of the calibrations."""
        return [file for name in self._calibrations() for file in self.calibrations.made(name)]

    def calibration_names(self, wildcards: Any) -> list[str]:
        """Return the names of the calibrations."""
        return self._calibrations()

    def reasons(self, wildcards: Any) -> dict[str, dict[str, str]]:
        """Return why each of the others was stopped."""
        return {"moorings": dict(self.stopped.moorings), "calibrations": dict(self.stopped.calibrations)}

    def stopped_of(self, wildcards: Any) -> dict[str, str]:
        """Return the same by what they are of, as ``Moorings.configuration`` names it."""
        stopped = self.reasons(wildcards)
        return {f"{part[:-1]} {name}": why for part, reasons in stopped.items() for name, why in reasons.items()}

    def conventions(self, wildcards: Any) -> list[str]:
        """Return what was found of each mooring's netCDF files."""
        return [f"results/{name}/conventions.json" for name in self._moorings()]

    def table(self, wildcards: Any) -> list[str]:
        """Return the summary; none where there are no moorings."""
        return [SUMMARY] if self.cruise.moorings else []

    def products(self, wildcards: Any) -> list[str]:
        """Return the files from which the jobs' records lead back to all others."""
        checked = self.conventions(wildcards) if self.cruise.options.conventions.check else []
        page = [REPORT] if self.cruise.moorings or self.cruise.calibrations else []
        made = [*self.of(*LAST)(wildcards), *checked, *self.table(wildcards), *self.calibrated(wildcards)]
        return [*made, *self.compasses.drawn(), *page]

    def everything(self, wildcards: Any = None) -> list[str]:
        """Return all files that a run makes, so that none which is missing goes unseen."""
        last = self.products(wildcards)
        each = [file for name, roles in self.roles(wildcards).items() for file in made(name, roles)]
        return list(dict.fromkeys([*each, *self.compasses.made(), *last, *([MANIFEST] if last else [])]))

    def given(self) -> list[str]:
        """Return what jobs are given: settings, raw files, scripts and templates of this software."""
        settings = [file for files in self.moorings.configuration().values() for file in files]
        moorings, calibrations = self.cruise.moorings.values(), self.cruise.calibrations.values()
        instruments = [one for mooring in moorings for one in mooring.instruments.values()]
        series = [one for mooring in moorings for one in mooring.covariates.values()]
        raw = [file for one in instruments for file in (*one.files, *one.pressure_files)]
        raw += [file for each in (series, calibrations) for one in each for file in one.files]
        software = [*map(str, self.moorings.scripts.glob("*.py")), *self.moorings.templates()]
        return list(dict.fromkeys([*settings, *raw, *software]))

    def configured(self, wildcards: Any = None) -> list[str]:
        """Return all files that the rules make, those that are made by name too."""
        return [*self.everything(), *self.conventions(wildcards), MANIFEST]

    def _moorings(self) -> list[str]:
        return [name for name in self.cruise.moorings if name not in self.stopped.moorings]

    def _calibrations(self) -> list[str]:
        return [name for name in self.cruise.calibrations if name not in self.stopped.calibrations]


def made(name: str, roles: Iterable[str]) -> list[str]:
    """Return all files that the rules make of one mooring, its conventions apart."""
    return [*(f"results/{name}/{file}" for file in MADE), *(_record(name, role) for role in roles)]


def plan(cruise: Cruise, scripts: Path) -> Plan:
    """Return the answers for the Snakefile, after refusing what no stage can do.

    Raises:
        InputError: a method that no fit offers, a kind of calibration that is not offered, a mooring that no rule can
            simulate, or an effect or reader of another package that cannot be taken.
    """
    if plugins.declared_plugins(plugins.EFFECTS):
        import_module("compasslib.effects").all_terms()  # looks at them before any work
    for form in {one.format for mooring in cruise.moorings.values() for one in mooring.instruments.values()}:
        readers.get_format(form)  # imports another package's
    for name, mooring in cruise.moorings.items():
        file = cruise.mooring_files[name]
        if cruise.options.demonstration and name not in SIMULATED:
            advice = "delete demonstration: true from config.yaml; measured moorings are never simulated"
            raise InputError(f"{file}: name", expected=" or ".join(SIMULATED), found=name, advice=advice)
        _refuse(f"{file}: fit.method", mooring.fit.method, METHODS)
    for name, given in cruise.calibrations.items():
        _refuse(f"{CALIBRATIONS}/{name}.yaml: kind", given.kind, tuple(KINDS))
    stopped = Stopped()
    return Plan(Moorings(cruise, scripts), Calibrations(cruise, scripts), Compasses(cruise, stopped), stopped)


def hashed(modules: Callable[[Any], tuple[str, ...]]) -> Callable[[Any], str]:
    """Return what gives one hash of the library files behind a job, as a parameter of its rule.

    Args:
        modules: gives these files for a job's wildcards.
    """
    return lambda wildcards: _code(modules(wildcards))


def only(names: Iterable[str]) -> str:
    """Return the constraint of a wildcard that may be one of these names and nothing that merely looks like them.

    Args:
        names: of moorings or calibrations, perhaps none.
    """
    return "|".join(re.escape(name) for name in names) or "(?!)"


def _code(modules: tuple[str, ...], beside: str = "") -> str:
    """Return one hash of library files, and what else the job goes by: other packages' effects where it knows any."""
    known = plugins.declared_plugins(plugins.EFFECTS) if EFFECTS in modules else ()
    return " ".join(filter(None, (provenance.code(modules), beside, *map(plugins.code_identity, known))))


def _refuse(where: str, found: str, offered: Sequence[str]) -> None:
    """Refuse what the schema knows and this version does not do.

    Raises:
        InputError: it is not offered.
    """
    if found not in offered:
        advice = "this version does not offer it yet"
        raise InputError(where, expected=" or ".join(offered), found=found, advice=advice)


def _described(mooring: Mooring) -> dict[str, Any]:
    roles = {"affected": [mooring.compromised], "reference": mooring.reference}
    texts = {
        role: ", ".join(_instrument_text(name, mooring.instruments[name]) for name in names) or "none"
        for role, names in roles.items()
    }
    return {
        "latitude": mooring.latitude,
        "longitude": mooring.longitude,
        "water_depth_m": mooring.water_depth,
        "start": mooring.start.isoformat(),
        "end": mooring.end.isoformat(),
        "instruments": texts,
        "roles": _roles(mooring),
    }


def _instrument_text(name: str, instrument: Instrument) -> str:
    depth = "" if instrument.depth is None else f", {instrument.depth:g} m"
    return f"{name} ({instrument.format}{depth})"


def _roles(mooring: Mooring) -> list[str]:
    return [mooring.compromised, *mooring.reference]


def _record(mooring: str, role: str) -> str:
    return f"results/{mooring}/work/{role}.nc"


def _plain(instrument: Instrument, keys: Sequence[str]) -> dict[str, Any]:
    dumped = instrument.model_dump(mode="json")
    return {key: dumped[key] for key in keys}
