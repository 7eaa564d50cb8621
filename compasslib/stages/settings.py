"""Settings of each stage, from the configuration of a cruise, and the files that the YAML files name.

A stage is given only the keys that it uses: a changed key re-runs only the stages that use it. Where the order of input
files matters, it is a parameter too (``names``, ``parts``, ``heads``), as Snakemake compares their set.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from compasslib import calibrations, plugins, readers
from compasslib.archive import deposit
from compasslib.calibrations import KINDS
from compasslib.config import calibrations as configured
from compasslib.config.cruise import CALIBRATIONS, CONFIG, Cruise
from compasslib.config.schema import Instrument, Mooring
from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.inference import kinds
from compasslib.preparation.quality import MAKERS
from compasslib.readers.files import list_converted

CONCEALED = tuple(f"C{k}" for k in range(1, 5))  # demonstration moorings whose truth is read for one page only
SIMULATED = (*(f"EG{k}" for k in range(1, 8)), *CONCEALED)  # the moorings of the demonstration cruise
DEPLOYMENT_KEYS = {"pressure_offset", "clock_offset_seconds", "clock_drift_seconds", "direction_reference"}
# Settings of a calibration that its result states, and on which the search for effects does not depend.
NOT_SEARCHED = ("table_step_deg", "parts", "object", "budget", "uncertainty")
Arguments = dict[str, Any]


@dataclass(frozen=True)
class Moorings:
    """Settings of the stages of a mooring, by its name, and files of its YAML file."""

    cruise: Cruise

    def mooring(self, name: str) -> Mooring:
        """Return the configuration of a mooring, for several affected instruments that of the first."""
        return self.cruise.moorings[self.parts(name)[0]]

    def parts(self, name: str) -> list[str]:
        """List the parts of a mooring, one for each affected instrument; for a part, the part itself."""
        return self.cruise.whole.get(name, [name])

    def roles(self, name: str) -> list[str]:
        """List the instruments that a mooring uses: the affected one and the references."""
        return used_instruments(self.mooring(name))

    def affected(self, name: str) -> str:
        """Return the record file of the affected instrument."""
        return f"results/{name}/work/{self.mooring(name).compromised}.nc"

    def references(self, name: str) -> list[str]:
        """List the record files of the references, none where the mooring has no reference."""
        return [f"results/{self.parts(name)[0]}/work/{role}.nc" for role in self.mooring(name).reference]

    def raw_files(self, name: str, role: str) -> list[str]:
        return list(self._instrument(name, role).files)

    def companion_files(self, name: str, role: str) -> list[str]:
        """List the further files that reading an instrument needs: named in its settings, or of one conversion."""
        neighbour, used = self._neighbour(name, role) or {}, self._instrument(name, role)
        recorded = used.files if used.format == "nortek" else ()
        converted = [each for file in recorded for each in list_converted(file, self.cruise.root)]
        tables = [*self._series(name, role).values(), *([neighbour["table"]] if "table" in neighbour else [])]
        files = [file for table in tables for file in table["files"]]
        return [*used.pressure_files, *files, *neighbour.get("raw", []), *converted]

    def ready_pairs(self, name: str) -> list[str]:
        """List the file of ready-made pairs, none where pairs are found by this software."""
        return list(self.mooring(name).fit.file or ())

    def observatory(self, name: str) -> list[str]:
        """List the files of the magnetic observatory that a mooring names, if any."""
        series = self.mooring(name).covariates.values()
        return [file for each in series if each.format == "iaga2002" for file in each.files]

    def calibrations(self, name: str) -> list[str]:
        """List the calibration of a mooring, or those before and after it; none where its compass is fitted."""
        return list(self.mooring(name).fit.name)

    @cached_property
    def gridded(self) -> dict[str, list[str]]:
        """File names of the gridded product, with daily means if configured, by mooring that is gridded."""
        wanted = {name: self.mooring(name).product for name in self.cruise.whole}
        return {name: ["gridded.nc", *["gridded_daily.nc"] * each.daily] for name, each in wanted.items() if each.grid}

    @cached_property
    def sites(self) -> dict[str, list[str]]:
        """Moorings at each site that has a name, in order of time."""
        at: dict[str, list[str]] = {}
        for name in sorted(self.cruise.whole, key=lambda name: self.mooring(name).start_s):
            if site := self.mooring(name).site:
                at.setdefault(site, []).append(name)
        return at

    def daily_means(self, site: str, usable: Sequence[str]) -> list[str]:
        """List the daily means of the moorings at a site of which an instrument can go on."""
        there = [name for name in self.sites[site] if set(self.parts(name)) & set(usable)]
        return [f"results/{name}/gridded_daily.nc" for name in there]

    def join_site(self, site: str) -> Arguments:
        names, attributes = self.sites[site], self._attributes(self.parts(self.sites[site][0])[0])
        compasses = [name for name, (moorings, _) in self.cruise.compasses.items() if len({*moorings} & {*names}) > 1]
        return {"names": names, "attributes": attributes, "compasses": compasses}

    def read(self, name: str, role: str) -> Arguments:
        return self._reading(name, role) | {
            "series": self._series(name, role),
            "neighbour": self._neighbour(name, role),
        }

    def overlap(self, name: str) -> Arguments:
        mooring = self.mooring(name)
        rules = self.cruise.options.overlap.model_dump()
        # The published method averages the bins instead of predicting the water at the reference's depth.
        rules["predict"] = rules["predict"] and mooring.fit.fitted != "von_appen"
        inside = {
            f"{role} ({part})" if each.differs else role: degrees
            for role in used_instruments(mooring)
            if (each := parse_applied_declination(mooring.instruments[role].declination_applied)) is not None
            for part, degrees in each._asdict().items()
        }
        place = {
            "latitude": mooring.latitude,
            "longitude": mooring.longitude,
            "start_s": mooring.start_s,
            "end_s": mooring.end_s,
            "declination": None if mooring.declination == "auto" else mooring.declination,
            "applied": {key: degrees for key, degrees in inside.items() if degrees},
        }
        columns = mooring.fit.columns.model_dump() if mooring.fit.columns else None
        return {
            "place": place,
            "rules": rules,
            "columns": columns,
            "compasses": _reference_compasses(mooring),
            "rotors": _rotors(mooring),
        }

    def fit(self, name: str) -> Arguments:
        """Return the arguments of the fit; those of ``at_mooring.compass_from_coefficients`` where they are given."""
        fit = self.mooring(name).fit
        given = fit.model_dump(include={"model", "coefficients", "covariance"}) if fit.coefficients else None
        return {"method": fit.fitted, "given": given, "sphere": self._sphere(name)}

    def transfer_calibration(self, name: str) -> Arguments:
        parts = list(self._instrument(name, self.mooring(name).compromised).parts)
        return {"parts": parts, "sphere": self._sphere(name), "names": self.calibrations(name)}

    def diagnose(self, name: str) -> Arguments:
        mooring = self.mooring(name)
        north = [mooring.instruments[role].direction_reference for role in mooring.reference]
        options = mooring.diagnose.model_dump() | {
            "reference_magnetic": not north or "magnetic" in north,
            "constant_confirmed": mooring.confirmed.constant,
        }
        if mooring.fit.coefficients and mooring.fit.model == "von_appen":  # a given series is not fitted again
            options["apply"] = False
        return {"options": options, "sphere_distance_m": mooring.instruments[mooring.compromised].sphere_distance_m}

    def correct(self, name: str) -> Arguments:
        mooring = self.mooring(name)
        roles = dict.fromkeys(role for part in self.parts(name) for role in self.roles(part))
        by_hand = [f"{role}: {flag}" for role in roles for flag in mooring.instruments[role].flags_by_hand]
        return {
            "site": {"name": mooring.name, "instrument": name.partition("/")[2]} | _place(mooring),
            "attributes": self._attributes(name),
            "superseded": self.superseded(name),
            "by_hand": by_hand,
        }

    def grid(self, name: str) -> Arguments:
        mooring = self.mooring(name)
        return self.correct(name) | {
            "options": dict(mooring.product.model_dump(mode="json")),
            "compasses": _reference_compasses(mooring),
            "rotors": _rotors(mooring),
            "parts": self.parts(name),
        }

    def superseded(self, name: str) -> dict[str, Any] | None:
        """Describe the deposit that a mooring's results supersede, with hashes of its files; None without one."""
        root, deposits = self.cruise.root, self.cruise.options.supersedes
        if not deposits:
            return None
        described = deposit.describe_superseded(root / deposits[0], configuration(self.cruise)[f"mooring {name}"], root)
        used = [self._instrument(each, role) for each in self.parts(name) for role in self.roles(each)]
        given = [file for each in used for file in (*each.files, *each.pressure_files)]
        given += [file for each in self.mooring(name).covariates.values() for file in each.files]
        given += [file for part in self.parts(name) for file in self.ready_pairs(part)]
        return described | {"files": {file: described["files"].get(file) for file in given}}

    def serial_number(self, name: str, role: str) -> str | None:
        """Look up an instrument's serial number in its attributes, for the affected one in the mooring's too."""
        stated = self._instrument(name, role).attributes
        return stated_serial_number(self._attributes(name) if role == self.mooring(name).compromised else stated)

    def _instrument(self, name: str, role: str) -> Instrument:
        return self.mooring(name).instruments[role]

    def _attributes(self, name: str) -> dict[str, Any]:
        """Merge the archive's attributes: the instrument's override the mooring's, which override the cruise's."""
        mooring = self.mooring(name)
        return self.cruise.options.attributes | mooring.attributes | mooring.instruments[mooring.compromised].attributes

    def _series(self, name: str, role: str) -> dict[str, dict[str, Any]]:
        """Return the settings of covariates in tables, which are read with the affected instrument, by name."""
        mooring = self.mooring(name)
        given = mooring.covariates.items() if role == mooring.compromised else ()
        return {key: each.model_dump(exclude={"format", "depth"}) for key, each in given if each.format == "table"}

    def _neighbour(self, name: str, role: str) -> Arguments | None:
        """Compose the argument ``neighbour`` of ``read.read``; None where the depth is the instrument's own."""
        mooring, instrument = self.mooring(name), self._instrument(name, role)
        if (other := instrument.depth_from) is None:
            return None
        if table := mooring.covariates.get(other):
            nominal, keys = table.depth, Arguments(table=table.model_dump(exclude={"format", "depth"}))
        else:
            nominal = mooring.instruments[other].depth
            keys = {"raw": self.raw_files(name, other)} | self._reading(name, other)
        return {"name": other, "depths_m": [instrument.depth, nominal], **keys}

    def _reading(self, name: str, role: str) -> Arguments:
        """Compose the format, the keys of its reader, and the arguments of ``deployment.apply_deployment``."""
        mooring, instrument = self.mooring(name), self._instrument(name, role)
        form = readers.get_format(instrument.format)
        reader = instrument.model_dump(
            mode="json", include={*form.keys} - ({*readers.TABLE_KEYS} - instrument.model_fields_set)
        )
        if "serial_number" in form.keys:
            reader["serial_number"] = self.serial_number(name, role)
        limits = MAKERS.get(instrument.format, {})
        deployment = instrument.model_dump(mode="json", include=DEPLOYMENT_KEYS) | {
            "start_s": mooring.start_s,
            "end_s": mooring.end_s,
            "water_depth": mooring.water_depth,
            "latitude": mooring.latitude,
            "nominal_depth": instrument.depth,
            "depth_named": bool(instrument.columns and instrument.columns.depth),
            # Some readers remove the declination themselves: a PD0 file may hold it as heading bias.
            "declination_applied": 0.0 if form.takes_declination else instrument.declination_applied or 0.0,
            "exclude": [(window.from_s, window.to_s) for window in instrument.exclude],
            "affected": role == mooring.compromised,
            "flags_by_hand": [flag.model_dump(exclude={"who", "why"}) for flag in instrument.flags_by_hand],
            "quality": {key: limits.get(key) if value is None else value for key, value in mooring.quality},
        }
        return {"form": instrument.format, "reader": reader, "deployment": deployment}

    def _sphere(self, name: str) -> bool:
        """Return whether iron near the affected instrument is declared."""
        affected = self._instrument(name, self.mooring(name).compromised)
        return affected.sphere is not None or bool(affected.sphere_distance_m)


@dataclass(frozen=True)
class Calibrations:
    """Settings of the stages of a calibration, by its name."""

    cruise: Cruise

    def raw_files(self, name: str) -> list[str]:
        return list(self.cruise.calibrations[name].raw_files)

    def compared_with(self, name: str) -> list[str]:
        """List the calibrations to compare with, possibly none."""
        return list(self.cruise.calibrations[name].compare_with)

    def calibrate(self, name: str) -> Arguments:
        file = self.cruise.calibrations[name]
        heads = list(file.files) if file.kind == "two_heads" else []
        return {"kind": file.kind, "settings": configured.settings(file), "heads": heads}

    def compare_calibrations(self, name: str) -> Arguments:
        return {"names": self.compared_with(name)}

    def diagnose(self, name: str) -> Arguments:
        used = self.calibrate(name)
        used["settings"] = {key: value for key, value in used["settings"].items() if key not in NOT_SEARCHED}
        return used | {"options": dict(self.cruise.options.diagnose.model_dump())}

    @property
    def diagnosed(self) -> list[str]:
        """Calibrations of the kinds that are searched for unmodelled effects."""
        return [name for name, file in self.cruise.calibrations.items() if file.kind in kinds.KINDS]

    @property
    def figures(self) -> dict[tuple[str, ...], list[str]]:
        """Names of figures, by which the calibrations that have them are grouped."""
        groups: dict[tuple[str, ...], list[str]] = {}
        for name, file in self.cruise.calibrations.items():
            figures = [*calibrations.figure_names(file.kind)]
            figures += ["compared"] * bool(file.compare_with and KINDS[file.kind].by_heading)
            figures += ["diagnosis"] * (name in self.diagnosed)
            groups.setdefault(tuple(figures), []).append(name)
        return groups


@dataclass(frozen=True)
class Compasses:
    """Compasses that several records share, and the settings of their stages, by name."""

    cruise: Cruise

    @cached_property
    def moorings(self) -> dict[str, str]:
        """The compass of each mooring that names one."""
        return {mooring: name for name, (moorings, _) in self.cruise.compasses.items() for mooring in moorings}

    def combine_records(self, name: str) -> Arguments:
        """Return the smallest effect of interest, and the sphere or frame of each record, None if not stated."""
        moorings, given = self.cruise.compasses[name]
        moored = {mooring: self.cruise.moorings[mooring] for mooring in moorings}
        stated = {key: mooring.instruments[mooring.compromised].sphere for key, mooring in moored.items()}
        stated |= {key: self.cruise.calibrations[key].sphere for key in given}
        spheres = {key: sphere if isinstance(sphere, str) else None for key, sphere in stated.items()}
        return {"spheres": spheres, "min_effect_deg": self.cruise.options.diagnose.min_effect_deg}


def configuration(cruise: Cruise) -> dict[str, list[str]]:
    """List the YAML files behind each mooring, calibration and compass, and under "" those of the whole cruise."""
    of_mooring = cruise.mooring_files | {name: cruise.mooring_files[parts[0]] for name, parts in cruise.whole.items()}
    of_calibration = {name: f"{CALIBRATIONS}/{name}.yaml" for name in cruise.calibrations}
    files = {"": [CONFIG]} | {f"mooring {name}": [CONFIG, file] for name, file in of_mooring.items()}
    files |= {f"calibration {name}": [CONFIG, file] for name, file in of_calibration.items()}
    joined = {f"compass {name}": members for name, members in cruise.compasses.items()}
    joined |= {f"site {site}": (names, []) for site, names in Moorings(cruise).sites.items()}
    for subject, (moorings, given) in joined.items():
        files[subject] = [CONFIG, *(of_mooring[name] for name in moorings), *(of_calibration[name] for name in given)]
    return files


def needs(cruise: Cruise) -> Arguments:
    """Return the calibrations that each mooring needs, and the moorings and calibrations of each compass."""
    moorings = Moorings(cruise)
    needed = {name: moorings.calibrations(name) for name in cruise.moorings}
    return {"needed": needed, "shared": cruise.compasses}


def used_instruments(mooring: Mooring) -> list[str]:
    """List the instruments that a mooring uses: the affected one and the references."""
    return [mooring.compromised, *mooring.reference]


def stated_serial_number(attributes: Mapping[str, Any]) -> str | None:
    """Look up the serial number among the attributes of an instrument."""
    return next((str(attributes[key]) for key in ("serial_number", "sensor_serial_number") if key in attributes), None)


def report(cruise: Cruise) -> Arguments:
    """Describe the configuration for the report."""

    def described(mooring: Mooring, roles: Sequence[str]) -> str:
        used = [(role, mooring.instruments[role]) for role in roles]
        depths = [f", {each.depth:g} m" if each.depth is not None else "" for _, each in used]
        each = [f"{role} ({file.format}{depth})" for (role, file), depth in zip(used, depths, strict=True)]
        return ", ".join(each) or "none"

    moorings = {
        name: _place(mooring)
        | {"start": mooring.start.isoformat(), "end": mooring.end.isoformat()}
        | {
            "instruments": {
                "affected": described(mooring, [mooring.compromised]),
                "reference": described(mooring, mooring.reference),
            }
        }
        for name, mooring in cruise.moorings.items()
    }
    known = {"calibrations": list(cruise.calibrations), "compasses": list(cruise.compasses)}
    return {"attributes": cruise.options.attributes, "moorings": moorings, **known}


def array(cruise: Cruise) -> list[dict[str, Any]]:
    """Describe place and instruments of each mooring, with all of its affected instruments together."""
    order = ("other", "affected", "reference")  # in which their symbols are drawn, the smallest last
    described = []
    for name, parts in cruise.whole.items():
        mooring = cruise.moorings[parts[0]]
        roles = dict.fromkeys(mooring.instruments, "other") | dict.fromkeys(mooring.reference, "reference")
        roles |= {cruise.moorings[part].compromised: "affected" for part in parts}
        instruments = []
        for each in sorted(mooring.instruments, key=lambda each: (order.index(roles[each]), each)):
            instrument = mooring.instruments[each]
            depth_m = None if instrument.format == "mmp_acm" else instrument.depth
            instruments.append({"depth_m": depth_m, "orientation": instrument.orientation, "role": roles[each]})
        described.append({"name": name, **_place(mooring), "instruments": instruments})
    return described


def check_cruise(cruise: Cruise) -> None:
    """Refuse what no stage can process: unknown simulations, unusable plug-ins or deposits, unequal axes of a site.

    Raises:
        InputError: a mooring cannot be simulated, or an effect or reader of another package, or a deposit, is unusable.
    """
    if plugins.declared_plugins(plugins.EFFECTS):
        from compasslib.effects import all_effects

        all_effects()
    for form in {each.format for mooring in cruise.moorings.values() for each in mooring.instruments.values()}:
        readers.get_format(form)  # imports that of another package
    for name, file in cruise.mooring_files.items() if cruise.options.demonstration else ():
        if name not in SIMULATED:
            advice = "delete demonstration: true from config.yaml; measured moorings are never simulated"
            raise InputError(f"{file}: name", expected=" or ".join(SIMULATED), found=name, advice=advice)
    moorings = Moorings(cruise)
    for name in cruise.moorings if cruise.options.supersedes else ():
        moorings.superseded(name)
    for first, *others in moorings.sites.values():
        for name in others:
            grids = [moorings.mooring(each).product.grid for each in (first, name)]
            axes = [f"{{step_m: {grid.step_m:g}, from_m: {grid.from_m:g}}}" for grid in grids if grid]
            if axes[0] != axes[1]:
                where = f"{cruise.mooring_files[cruise.whole[name][0]]}: product.grid"
                advice = "write the same for all of the site"
                raise InputError(where, expected=f"{axes[0]} as {first}", found=axes[1], advice=advice)


def _place(mooring: Mooring) -> dict[str, Any]:
    return {"latitude": mooring.latitude, "longitude": mooring.longitude, "water_depth_m": mooring.water_depth}


def _rotors(mooring: Mooring) -> list[bool]:
    return [mooring.instruments[role].kind == "rotor" for role in mooring.reference]


def _reference_compasses(mooring: Mooring) -> list[Arguments]:
    """List the arguments of ``deviation.model.reference_compass`` for each reference."""
    return [
        {
            "name": role,
            "sigma_deg": each.compass_sigma_deg,
            "iron_nT": each.compass_iron_nT,
            "magnetic": each.direction_reference == "magnetic",
        }
        for role, each in ((role, mooring.instruments[role]) for role in mooring.reference)
    ]
