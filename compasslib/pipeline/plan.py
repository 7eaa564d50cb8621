"""What the workflow makes: its stages, the files that each reads and writes, and the jobs of a cruise.

The table of stages serves the Snakefile and ``process.process_mooring``. Snakemake waits for the record of each job
(``records``) in place of its files, as a mooring that is stopped has none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from compasslib import plugins, readers
from compasslib.archive import provenance
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline import records
from compasslib.pipeline.settings import (
    SCRIPTS,
    Calibrations,
    Compasses,
    Moorings,
    Wildcards,
    drawn,
    hash_code,
    used_instruments,
)

OF_CRUISE = ("curves", "differences", "currents")
JUDGED = ("diagnosis", "deviation", "assessment")
ALONE = (*JUDGED, "summary")  # of each mooring whose compass has others
SIMULATED = tuple(f"EG{k}" for k in range(1, 8))  # the moorings of the demonstration cruise
CRUISE, MOORING = "results", "results/{mooring}"
CALIBRATION, COMPASS = "results/calibrations/{calibration}", "results/compasses/{compass}"
SUMMARY, REPORT, MANIFEST = "results/summary.csv", "results/report.html", "results/ro-crate-metadata.json"

Given = Callable[[Any], Any]
Files = Mapping[str, "str | tuple[str, ...] | Given"]


@dataclass(frozen=True)
class Stage:
    """A stage and what its function takes, by the names of its arguments; what it does not take is only waited for.

    Args:
        function: module and name below ``compasslib.stages``.
        folder: of its results, with wildcards.
        label: of its log, record and benchmark in that folder.
        code: gives one hash of the modules behind it.
        reads: files below ``folder``, or what gives their paths in the cruise.
        writes: the same.
        settings: what gives each other argument.
    """

    function: str
    folder: str
    label: str
    code: Given
    reads: Files = field(default_factory=dict)
    writes: Files = field(default_factory=dict)
    settings: Mapping[str, Given] = field(default_factory=dict)


@dataclass(frozen=True)
class Plan:
    """The stages and jobs of one cruise."""

    cruise: Cruise
    scripts: Path

    @cached_property
    def moorings(self) -> Moorings:
        """What stages are given of a mooring's configuration."""
        return Moorings(self.cruise)

    @cached_property
    def calibrations(self) -> Calibrations:
        """What stages are given of a calibration's configuration."""
        return Calibrations(self.cruise)

    @cached_property
    def compasses(self) -> Compasses:
        """What stages are given of a compass that several records share."""
        return Compasses(self.cruise)

    @cached_property
    def stages(self) -> dict[str, Stage]:
        """The stages by the names of their rules."""
        return self._of_moorings() | self._of_calibrations() | self._of_compasses() | self._of_cruise()

    def code(self, rule: str, also: str = "") -> Given:
        """Give the function that hashes the modules behind the script of a rule."""
        return lambda wildcards: hash_code(provenance.sources(self.scripts / f"{rule}.py"), also)

    def _of_moorings(self) -> dict[str, Stage]:
        of, pairs, field_, fit = self.moorings, "overlap.nc", "work/field.json", "work/fit.json"
        judging = {
            "record": of.compromised,
            "references": of.reference,
            "pairs": pairs,
            "wide": "wide/overlap.nc",
            "fit": fit,
            "field": field_,
            "observatory": of.observatory,
        }
        judged = {name: f"{name}.json" for name in JUDGED}
        tables = {"table": "table.csv", "histograms": "histograms.csv"}
        options = {"options": of.diagnose, "sphere_distance_m": of.sphere_distance_m}
        checked = provenance.installed("compliance-checker")
        archived = {"site": of.site, "attributes": of.attributes, "sources": of.all_raw_files}

        def stage(rule: str, function: str, label: str = "", code: Given | None = None, **parts: Any) -> Stage:
            return Stage(function, MOORING, label or rule, code or self.code(rule), **parts)

        return {
            "read": stage(
                *("read", "read.read", "read_{role}"),
                code=lambda wildcards: of.reader_code(wildcards, self.scripts),
                reads={"companions": of.companion_files, "raw": of.raw_files},
                writes={"record": "work/{role}.nc"},
                settings={
                    "form": of.form,
                    "reader": of.reader_settings,
                    "deployment": of.deployment,
                    "series": of.series,
                },
            ),
            "overlap": stage(
                *("overlap", "overlap.overlap"),
                reads={
                    "upper": of.compromised,
                    "lower": of.reference,
                    "observatory": of.observatory,
                    "ready": of.ready_pairs,
                },
                writes={"field": field_, "pairs": pairs, "wide": "wide/overlap.nc"},
                settings={"place": of.place_and_declination, "rules": of.pairing_rules, "columns": of.pair_columns},
            ),
            "fit": stage(
                *("fit", "fit.fit"),
                reads={"record": of.compromised, "pairs": pairs, "field": field_},
                writes={"fit": fit},
                settings={"method": of.method, "tilt": of.tilt, "given": of.given_compass},
            ),
            "carry": stage(
                *("carry", "fit.carry", "fit"),
                reads={"calibration": of.calibration, "record": of.compromised, "pairs": pairs, "field": field_},
                writes={"fit": fit},
            ),
            "diagnose": stage(
                *("diagnose", "diagnose.diagnose"),
                reads=judging,
                writes=judged,
                settings=options,
            ),
            "diagnose_alone": stage(
                *("diagnose_alone", "diagnose.diagnose"),
                code=self.code("diagnose"),
                reads=judging,
                writes={name: f"work/alone/{name}.json" for name in ALONE},
                settings=options,
            ),
            "share": stage(
                *("share", "diagnose.share", "diagnose"),
                reads={"joined": self.compasses.joined, "alone": tuple(f"work/alone/{n}.json" for n in JUDGED)}
                | judging,
                writes=judged,
                settings=options | {"tilt": of.tilt},
            ),
            "correct": stage(
                *("correct", "correct.correct"),
                reads={name: judging[name] for name in ("record", "pairs", "field", "observatory")}
                | {name: judged[name] for name in ("deviation", "assessment")},
                writes={"corrected": "corrected.nc"} | tables,
                settings=archived,
            ),
            "grid": stage(
                *("grid", "grid.grid"),
                reads={
                    "corrected": of.of_members("corrected.nc"),
                    "records": of.affected,
                    "references": of.reference,
                    "pairs": of.of_members(pairs),
                    "deviations": of.of_members("deviation.json"),
                    "assessments": of.of_members("assessment.json"),
                    "fields": of.of_members(field_),
                    "observatory": of.observatory,
                },
                writes={"gridded": of.gridded},
                settings={"options": of.product, "compasses": of.reference_compasses} | archived,
            ),
            "compare": stage(
                *("compare", "correct.compare"),
                reads={"pairs": pairs, "deviation": "deviation.json"},
                writes={"forms": "forms.json"},
            ),
            "figures": stage(
                *("figures", "figures.figures"),
                reads=judged
                | {"pairs": pairs, "histograms": "histograms.csv", "product": "corrected.nc", "gridded": of.gridded},
                writes={"figures": of.figures, "pictures": "work/pictures.json"},
            ),
            "sections": stage(
                *("sections", "figures.sections"),
                reads={"gridded": of.gridded},
                writes={"figures": of.figures, "pictures": "work/pictures.json"},
            ),
            "check_conventions": stage(
                *("conventions", "cruise.conventions"),
                code=self.code("conventions", checked),
                reads={"products": of.archived, "gridded": of.gridded, "records": of.records},
                writes={"conventions": "conventions.json"},
            ),
        }

    def _of_calibrations(self) -> dict[str, Stage]:
        of = self.calibrations
        made = {"calibration": "calibration.json", "table": "table.csv", "points": "points.csv"}

        def code(rule: str, module: Callable[[Any], list[str]]) -> Given:
            return lambda wildcards: hash_code(provenance.sources(self.scripts / f"{rule}.py", *module(wildcards)))

        return {
            "calibrate": Stage(
                *("calibrate.calibrate", CALIBRATION, "calibrate"),
                code("calibrate", of.module),
                reads={"raw": of.raw_files, "earlier": of.earlier},
                writes=made,
                settings={"kind": of.kind, "settings": of.settings},
            ),
            "diagnose_calibration": Stage(
                *("diagnose.diagnose_calibration", CALIBRATION, "diagnose"),
                code("diagnose_calibration", of.diagnosis_module),
                # Waits for the calibration, so that what cannot be read is said once.
                reads={"calibration": "calibration.json", "raw": of.raw_files},
                writes={"diagnosis": "diagnosis.json"},
                settings={"kind": of.kind, "settings": of.settings, "options": of.diagnose},
            ),
            "diagnosis_figure": Stage(
                *("drawings.diagnosis_figure", CALIBRATION, "diagnosis_figure"),
                self.code("diagnosis_figure"),
                reads={"diagnosis": "diagnosis.json"},
                writes={"figures": of.diagnosis_figures},
            ),
            "calibration_figures": Stage(
                *("drawings.calibration_figures", CALIBRATION, "figures"),
                self.code("calibration_figures"),
                reads=made,
                writes={"figures": of.figures},
            ),
        }

    def _of_compasses(self) -> dict[str, Stage]:
        of = self.compasses
        return {
            "join": Stage(
                *("diagnose.join", COMPASS, "join"),
                self.code("join"),
                reads={"summaries": of.summaries, "calibrations": of.calibrations},
                writes={"joined": "compass.json", "diagnosis": "diagnosis.json"},
                settings={"spheres": of.spheres, "min_effect_deg": of.min_effect_deg},
            ),
            "joined_figures": Stage(
                *("drawings.joined_figures", COMPASS, "figures"),
                self.code("joined_figures"),
                reads={"joined": "compass.json"},
                writes={"figures": of.figures},
            ),
        }

    def _of_cruise(self) -> dict[str, Stage]:
        cruise, of = self.cruise, self.moorings
        summarized = ("deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "work/field.json")
        configuration = of.configuration()
        files = {"summary": [*self.per_mooring(*summarized, "overlap.nc"), *self.records_of_instruments()]}
        files["report"] = [*self.table(), *self.pictures(), *self.per_mooring("work/pictures.json")]
        files["report"] += [*self.pictures_of_cruise(), *self.calibrated(), *self.joined()]
        templates = provenance.digest(of.templates())
        return {
            "summary": Stage(
                *("cruise.summary", CRUISE, "summary"),
                self.code("summary"),
                reads={"files": lambda wildcards: files["summary"]},
                writes={"summary": "summary.csv"},
                settings={
                    "roles": lambda wildcards: {name: used_instruments(m) for name, m in cruise.moorings.items()},
                },
            ),
            "cruise_figures": Stage(
                *("drawings.cruise_figures", CRUISE, "cruise_figures"),
                self.code("cruise_figures"),
                reads={
                    "deviations": lambda wildcards: self.per_mooring("deviation.json"),
                    "assessments": lambda wildcards: self.per_mooring("assessment.json"),
                },
                writes={"figures": lambda wildcards: drawn(cruise, CRUISE, OF_CRUISE)},
            ),
            "report": Stage(
                *("report.report", CRUISE, "report"),
                self.code("report", templates),
                reads={"files": lambda wildcards: files["report"]},
                writes={"page": "report.html"},
                settings={
                    "attributes": lambda wildcards: cruise.options.attributes,
                    "moorings": lambda wildcards: of.described(),
                    "calibrations": lambda wildcards: list(cruise.calibrations),
                    "compasses": lambda wildcards: list(self.compasses.members),
                },
            ),
            "provenance": Stage(
                *("cruise.provenance", CRUISE, "provenance"),
                self.code("provenance"),
                reads={
                    "settings": lambda wildcards: sorted({file for group in configuration.values() for file in group}),
                    "products": lambda wildcards: self.products(),
                },
                writes={"manifest": "ro-crate-metadata.json"},
                settings={
                    "configuration": lambda wildcards: configuration,
                    "attributes": lambda wildcards: cruise.options.attributes,
                },
            ),
            "complete": Stage(
                *("cruise.complete", CRUISE, "complete"),
                self.code("complete"),
                settings={"folders": lambda wildcards: self.folders()},
            ),
        }

    @cached_property
    def jobs(self) -> dict[str, tuple[str, Wildcards]]:
        """Rule and wildcards of all jobs that the cruise may have, by their records."""
        return {self.record(rule, of): (rule, of) for rule, of in self._jobs()}

    def _jobs(self) -> Iterator[tuple[str, Wildcards]]:
        for name, mooring in self.cruise.moorings.items():
            yield from (("read", Wildcards(name, role)) for role in used_instruments(mooring))
            shared = name in self.compasses.moorings
            rules = ["overlap", "carry" if mooring.fit.method == "calibration" else "fit"]
            rules += ["diagnose_alone", "share"] if shared else ["diagnose"]
            gridded = ["grid"] if self.moorings.gridded(Wildcards(name)) else []
            yield from ((rule, Wildcards(name)) for rule in (*rules, "correct", *gridded, "compare", "figures"))
            yield "check_conventions", Wildcards(name)
        for name in self.together:
            yield from ((rule, Wildcards(name)) for rule in ("grid", "sections", "check_conventions"))
        for name in self.cruise.calibrations:
            rules = ["calibrate", "calibration_figures"]
            rules += ["diagnose_calibration", "diagnosis_figure"] if self.calibrations.is_diagnosed(name) else []
            yield from ((rule, Wildcards(calibration=name)) for rule in rules)
        for name in self.compasses.members:
            yield from ((rule, Wildcards(compass=name)) for rule in ("join", "joined_figures"))
        if self.cruise.moorings:
            yield from ((rule, Wildcards()) for rule in ("summary", "cruise_figures"))
        if self.cruise.moorings or self.cruise.calibrations:
            yield from ((rule, Wildcards()) for rule in ("report", "provenance", "complete"))

    @cached_property
    def writers(self) -> dict[str, str]:
        """The record of the job that writes each file."""
        return {file: record for record, job in self.jobs.items() for file in records.flat(self.files(*job)["writes"])}

    def record(self, rule: str, wildcards: Any) -> str:
        """Name the record of a job."""
        stage = self.stages[rule]
        return f"{stage.folder}/logs/{stage.label}.json".format(**_named(wildcards))

    def files(self, rule: str, wildcards: Any) -> dict[str, dict[str, Any]]:
        """List the files that a job reads and writes, by the names of arguments."""
        stage = self.stages[rule]
        return {
            part: {name: self._paths(stage.folder, given, wildcards) for name, given in files.items()}
            for part, files in (("reads", stage.reads), ("writes", stage.writes))
        }

    def _paths(self, folder: str, given: str | tuple[str, ...] | Given, wildcards: Any) -> Any:
        if callable(given):
            return given(wildcards)
        named = _named(wildcards)
        if isinstance(given, str):
            return f"{folder}/{given}".format(**named)
        return [f"{folder}/{path}".format(**named) for path in given]

    def inputs(self, rule: str) -> Given:
        """Give the function that lists what Snakemake waits for before a job: raw files, and records of other jobs."""

        def waited_for(wildcards: Any) -> list[str]:
            if rule == "complete":
                return [record for record in self.everything() if record != self.record(rule, wildcards)]
            reads = records.flat(self.files(rule, wildcards)["reads"])
            return list(dict.fromkeys(self.writers.get(file, file) for file in reads))

        return waited_for

    def params(self, rule: str) -> dict[str, Given]:
        """Give the functions of a rule's parameters; a change of one of them runs its jobs again."""
        stage = self.stages[rule]
        return {"files": lambda wildcards: self.files(rule, wildcards), **stage.settings, "code": stage.code}

    def names(self, rule: str) -> str:
        """Constrain a wildcard to the moorings, calibrations or compasses that a rule is for."""
        names = {of.mooring or of.calibration or of.compass: None for name, of in self.jobs.values() if name == rule}
        return only(names)

    def everything(self, wildcards: Any = None) -> list[str]:
        """List the records of all jobs of a run."""
        checked = self.cruise.options.conventions.check
        return [record for record, (rule, _) in self.jobs.items() if checked or rule != "check_conventions"]

    def conventions(self, wildcards: Any = None) -> list[str]:
        """List the records of the jobs that check the netCDF files of all moorings."""
        return [record for record, (rule, _) in self.jobs.items() if rule == "check_conventions"]

    def configured(self, wildcards: Any = None) -> list[str]:
        """List all files that the rules make, those that are made by name too."""
        return [*self.writers, *(f"{folder}/stopped.json" for folder in self.folders())]

    @cached_property
    def together(self) -> list[str]:
        """Moorings of several affected instruments, whose velocities go onto one grid."""
        wholes = [name for name in self.cruise.whole if name not in self.cruise.moorings]
        return [name for name in wholes if self.moorings.gridded(Wildcards(name))]

    def folders(self) -> list[str]:
        """List the folders of results of all moorings, calibrations and compasses."""
        calibrations = (f"{CRUISE}/calibrations/{name}" for name in self.cruise.calibrations)
        joined = (f"{CRUISE}/compasses/{name}" for name in self.compasses.members)
        moorings = dict.fromkeys((*self.cruise.moorings, *self.cruise.whole))
        return [*(f"{CRUISE}/{name}" for name in moorings), *calibrations, *joined]

    def per_mooring(self, *files: str) -> list[str]:
        return [f"{CRUISE}/{name}/{file}" for file in files for name in self.cruise.moorings]

    def records_of_instruments(self) -> list[str]:
        """List the records of the instruments that moorings use."""
        moorings = self.cruise.moorings.items()
        return [f"{CRUISE}/{name}/work/{role}.nc" for name, mooring in moorings for role in used_instruments(mooring)]

    def table(self) -> list[str]:
        return [SUMMARY] if self.cruise.moorings else []

    def pictures(self) -> list[str]:
        names = (*self.cruise.moorings, *self.together)
        return [file for name in names for file in self.moorings.figures(Wildcards(name))]

    def pictures_of_cruise(self) -> list[str]:
        return drawn(self.cruise, CRUISE, OF_CRUISE) if self.cruise.moorings else []

    def calibrated(self) -> list[str]:
        """List all files of the calibrations."""
        return [file for file in self._writers_of_parts() if file.startswith(f"{CRUISE}/calibrations/")]

    def joined(self) -> list[str]:
        """List all files of the compasses that several records share."""
        return [file for file in self._writers_of_parts() if file.startswith(f"{CRUISE}/compasses/")]

    def _writers_of_parts(self) -> list[str]:
        stages = self._of_calibrations() | self._of_compasses()
        jobs = [(stages[rule], of) for rule, of in self._jobs() if rule in stages]
        paths = [{n: self._paths(stage.folder, given, of) for n, given in stage.writes.items()} for stage, of in jobs]
        return [file for group in paths for file in records.flat(group)]

    def products(self) -> list[str]:
        """List the files from which the jobs' records lead back to all others."""
        last = ("corrected.nc", "assessment.json", "forms.json")
        made = [file for name in self.cruise.whole for file in self.moorings.gridded(Wildcards(name))]
        checked = self.per_mooring("conventions.json") if self.cruise.options.conventions.check else []
        checked += [f"{CRUISE}/{name}/conventions.json" for name in self.together if checked]
        made += [*checked, *self.table(), *self.pictures_of_cruise(), *self.calibrated()]
        made += [file for file in self.joined() if not file.endswith(".json")]
        return [*self.per_mooring(*last), *self.pictures(), *made, REPORT]


def plan(cruise: Cruise, scripts: Path = SCRIPTS) -> Plan:
    """Plan a cruise, after refusing what no stage can do.

    Raises:
        InputError: a mooring that no rule can simulate, or an effect or reader of another package that cannot be taken.
    """
    if plugins.declared_plugins(plugins.EFFECTS):
        import_module("compasslib.effects").all_effects()  # looks at them before any work
    for form in {each.format for mooring in cruise.moorings.values() for each in mooring.instruments.values()}:
        readers.get_format(form)  # imports another package's
    for name, file in cruise.mooring_files.items() if cruise.options.demonstration else ():
        if name not in SIMULATED:
            advice = "delete demonstration: true from config.yaml; measured moorings are never simulated"
            raise InputError(f"{file}: name", expected=" or ".join(SIMULATED), found=name, advice=advice)
    return Plan(cruise, scripts)


def only(names: Iterable[str]) -> str:
    """Constrain a wildcard to these names and nothing that merely looks like them."""
    return "|".join(map(re.escape, names)) or "(?!)"


def _named(wildcards: Any) -> dict[str, str]:
    return wildcards._asdict() if isinstance(wildcards, Wildcards) else dict(wildcards.items())
