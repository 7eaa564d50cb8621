"""Plan of the workflow for a cruise: its stages, the files that each reads and writes, and its jobs.

The table of stages is used by the Snakefile and by ``process.process_mooring``. Snakemake waits for the record of each
job (``records``) instead of its files, because a stopped mooring has none.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from typing import Any

from compasslib import plugins, readers
from compasslib.archive import provenance
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline import records, stages
from compasslib.pipeline.settings import (
    SCRIPTS,
    Calibrations,
    Compasses,
    Moorings,
    Wildcards,
    hash_code,
    list_figures,
    used_instruments,
)
from compasslib.pipeline.stages import CRUISE, OF_CRUISE, Given, Stage

SIMULATED = (*(f"EG{k}" for k in range(1, 8)), *records.CONCEALED)  # the moorings of the demonstration cruise
BEFORE_JOINING = ("read", "overlap", "fit", "carry", "diagnose_alone")
SUMMARY, REPORT = "results/summary.csv", "results/report.html"


@dataclass(frozen=True)
class Plan:
    """The stages and jobs of one cruise."""

    cruise: Cruise
    scripts: Path
    _files: dict[tuple[str, ...], dict[str, dict[str, Any]]] = field(default_factory=dict, init=False)  # cache, by job

    @cached_property
    def moorings(self) -> Moorings:
        """Inputs and settings of a mooring's stages."""
        return Moorings(self.cruise)

    @cached_property
    def calibrations(self) -> Calibrations:
        """Inputs and settings of a calibration's stages."""
        return Calibrations(self.cruise)

    @cached_property
    def compasses(self) -> Compasses:
        """Inputs and settings of the stages of a compass that several records share."""
        return Compasses(self.cruise)

    @cached_property
    def stages(self) -> dict[str, Stage]:
        """The stages by name of rule."""
        return (
            stages.of_moorings(self) | stages.of_calibrations(self) | stages.of_compasses(self) | stages.of_cruise(self)
        )

    def code(self, rule: str, also: str = "") -> Given:
        """Return a function that hashes the modules behind the script of a rule."""
        return lambda wildcards: hash_code(provenance.sources(self.scripts / f"{rule}.py"), also)

    @cached_property
    def jobs(self) -> dict[str, tuple[str, Wildcards]]:
        """Rule and wildcards of all possible jobs of the cruise, by path of the record."""
        return {self.record(rule, wildcards): (rule, wildcards) for rule, wildcards in self._jobs()}

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
        if self.concealed:
            yield "concealed", Wildcards()
        if self.cruise.moorings or self.cruise.calibrations:
            yield from ((rule, Wildcards()) for rule in ("report", "provenance", "complete"))

    def mooring_jobs(self) -> dict[str, list[str]]:
        """Group the job records by mooring or calibration, each run by one rule, by name of that rule.

        The jobs that a shared compass waits for before it is joined form a separate group.
        """
        groups: dict[str, list[str]] = {}
        for record, (rule, job) in self.jobs.items():
            shared = job.mooring in self.compasses.moorings and rule in BEFORE_JOINING
            kind = "calibration" if job.calibration else "alone" if shared else "mooring"
            if (name := job.calibration or job.mooring.partition("/")[0]) and rule != "check_conventions":
                groups.setdefault(f"{kind}_{name}", []).append(record)
        return groups

    def described_jobs(self, records_: list[str]) -> Given:
        """Return a function that describes jobs for ``whole.run_jobs``."""

        def describe(wildcards: Any) -> list[dict[str, Any]]:
            return [
                {
                    "rule": rule,
                    "function": self.stages[rule].function,
                    "wildcards": {name: value for name, value in of._asdict().items() if value},
                    "input": self.inputs(rule)(of),
                    "log": str(Path(record).with_suffix(".log")),
                    "params": {name: given(of) for name, given in self.params(rule).items()},
                }
                for record in records_
                for rule, of in [self.jobs[record]]
            ]

        return describe

    def inputs_of(self, records_: list[str]) -> Given:
        """Return a function that lists the inputs of a group of jobs, except records of the group itself."""
        jobs = [self.jobs[record] for record in records_]
        waited_for = cache(lambda: dict.fromkeys(file for rule, of in jobs for file in self.inputs(rule)(of)))
        return lambda wildcards: [file for file in waited_for() if file not in records_]

    @cached_property
    def writers(self) -> dict[str, str]:
        """The record of the job that writes each file."""
        return {file: record for record, job in self.jobs.items() for file in records.flat(self.files(*job)["writes"])}

    def record(self, rule: str, wildcards: Any) -> str:
        """Return the path of a job's record."""
        stage = self.stages[rule]
        return f"{stage.folder}/logs/{stage.label}.json".format(**_named(wildcards))

    def files(self, rule: str, wildcards: Any) -> dict[str, dict[str, Any]]:
        """Return the files that a job reads and writes, by name of argument."""
        stage, job = self.stages[rule], (rule, *_named(wildcards).values())
        if job not in self._files:
            self._files[job] = {
                part: {name: self._paths(stage.folder, given, wildcards) for name, given in files.items()}
                for part, files in (("reads", stage.reads), ("writes", stage.writes))
            }
        return self._files[job]

    def _paths(self, folder: str, given: str | tuple[str, ...] | Given, wildcards: Any) -> Any:
        if callable(given):
            return given(wildcards)
        named = _named(wildcards)
        if isinstance(given, str):
            return f"{folder}/{given}".format(**named)
        return [f"{folder}/{path}".format(**named) for path in given]

    def inputs(self, rule: str) -> Given:
        """Return a function that lists Snakemake's inputs of a job: raw files, and records of the jobs before it."""

        def waited_for(wildcards: Any) -> list[str]:
            if rule == "complete":
                return [record for record in self.everything() if record != self.record(rule, wildcards)]
            reads = records.flat(self.files(rule, wildcards)["reads"])
            return list(dict.fromkeys(self.writers.get(file, file) for file in reads))

        return waited_for

    def params(self, rule: str) -> dict[str, Given]:
        """Return the functions of a rule's parameters; a change of a parameter re-runs the job."""
        stage = self.stages[rule]
        return {"files": lambda wildcards: self.files(rule, wildcards), **stage.settings, "code": stage.code}

    def names(self, rule: str) -> str:
        """Return the wildcard constraint, a regular expression, for a rule's moorings, calibrations or compasses."""
        jobs = (wildcards for name, wildcards in self.jobs.values() if name == rule)
        names = {w.mooring or w.calibration or w.compass: None for w in jobs}
        return only(names)

    def everything(self, wildcards: Any = None) -> list[str]:
        """List the records of all jobs of a run."""
        checked = self.cruise.options.conventions.check
        return [record for record, (rule, _) in self.jobs.items() if checked or rule != "check_conventions"]

    def conventions(self, wildcards: Any = None) -> list[str]:
        """List the records of the jobs that check the netCDF files of all moorings."""
        return [record for record, (rule, _) in self.jobs.items() if rule == "check_conventions"]

    def configured(self, wildcards: Any = None) -> list[str]:
        """List all files that the rules can make, including those made only on request."""
        return [*self.writers, *(f"{folder}/stopped.json" for folder in self.folders())]

    @cached_property
    def together(self) -> list[str]:
        """Moorings of several affected instruments, whose velocities are gridded together."""
        wholes = [name for name in self.cruise.whole if name not in self.cruise.moorings]
        return [name for name in wholes if self.moorings.gridded(Wildcards(name))]

    @cached_property
    def concealed(self) -> list[str]:
        """Demonstration moorings whose results are compared with the truth on one page."""
        return [
            name for name in self.cruise.moorings if self.cruise.options.demonstration and name in records.CONCEALED
        ]

    def folders(self) -> list[str]:
        """List the result folders of all moorings, calibrations and compasses."""
        calibrations = (f"{CRUISE}/calibrations/{name}" for name in self.cruise.calibrations)
        joined = (f"{CRUISE}/compasses/{name}" for name in self.compasses.members)
        moorings = dict.fromkeys((*self.cruise.moorings, *self.cruise.whole))
        return [*(f"{CRUISE}/{name}" for name in moorings), *calibrations, *joined]

    def per_mooring(self, *files: str) -> list[str]:
        return [f"{CRUISE}/{name}/{file}" for file in files for name in self.cruise.moorings]

    def records_of_instruments(self) -> list[str]:
        """List the record files of the instruments that moorings use."""
        moorings = self.cruise.moorings.items()
        return [f"{CRUISE}/{name}/work/{role}.nc" for name, mooring in moorings for role in used_instruments(mooring)]

    def table(self) -> list[str]:
        return [SUMMARY] if self.cruise.moorings else []

    def pictures(self) -> list[str]:
        names = (*self.cruise.moorings, *self.together)
        return [file for name in names for file in self.moorings.figures(Wildcards(name))]

    def pictures_of_cruise(self) -> list[str]:
        return list_figures(self.cruise, CRUISE, OF_CRUISE) if self.cruise.moorings else []

    def calibrated(self) -> list[str]:
        """List all files of the calibrations."""
        return [file for file in self._writers_of_parts() if file.startswith(f"{CRUISE}/calibrations/")]

    def joined(self) -> list[str]:
        """List all files of the compasses that several records share."""
        return [file for file in self._writers_of_parts() if file.startswith(f"{CRUISE}/compasses/")]

    def _writers_of_parts(self) -> list[str]:
        parts = stages.of_calibrations(self) | stages.of_compasses(self)
        jobs = [(parts[rule], wildcards) for rule, wildcards in self._jobs() if rule in parts]
        paths = [
            {n: self._paths(stage.folder, given, wildcards) for n, given in stage.writes.items()}
            for stage, wildcards in jobs
        ]
        return [file for group in paths for file in records.flat(group)]

    def products(self) -> list[str]:
        """List the final files, from which the job records lead back to all others."""
        last = ("corrected.nc", "assessment.json", "forms.json")
        made = [file for name in self.cruise.whole for file in self.moorings.gridded(Wildcards(name))]
        checked = self.per_mooring("conventions.json") if self.cruise.options.conventions.check else []
        checked += [f"{CRUISE}/{name}/conventions.json" for name in self.together if checked]
        made += [*checked, *self.table(), *self.pictures_of_cruise(), *self.calibrated()]
        made += [file for file in self.joined() if not file.endswith(".json")]
        return [*self.per_mooring(*last), *self.pictures(), *made, REPORT]


def plan(cruise: Cruise, scripts: Path = SCRIPTS) -> Plan:
    """Plan a cruise, after refusing what no stage can process.

    Raises:
        InputError: a mooring cannot be simulated, or an effect or reader of another package, or a deposit, is unusable.
    """
    if plugins.declared_plugins(plugins.EFFECTS):
        import_module("compasslib.effects").all_effects()  # checks them before any work
    for form in {each.format for mooring in cruise.moorings.values() for each in mooring.instruments.values()}:
        readers.get_format(form)  # imports that of another package
    for name, file in cruise.mooring_files.items() if cruise.options.demonstration else ():
        if name not in SIMULATED:
            advice = "delete demonstration: true from config.yaml; measured moorings are never simulated"
            raise InputError(f"{file}: name", expected=" or ".join(SIMULATED), found=name, advice=advice)
    planned = Plan(cruise, scripts)
    for name in cruise.moorings if cruise.options.supersedes else ():
        planned.moorings.superseded(Wildcards(name))  # refuses a file that is not a deposit
    return planned


def only(names: Iterable[str]) -> str:
    """Return a regular expression that matches these names only, as wildcard constraint."""
    return "|".join(map(re.escape, names)) or "(?!)"


def moorings_of(arguments: Sequence[str]) -> list[str] | None:
    """List the moorings whose configuration suffices for a job on a cluster; None where others may be needed.

    Args:
        arguments: command line of Snakemake on the node, from which alone the Snakefile can learn the job's targets.
    """
    targets = arguments[arguments.index("--target-jobs") + 1 :] if "--target-jobs" in arguments else []
    names = [target.strip("'").removesuffix(":") for target in takewhile(lambda target: target[:1] != "-", targets)]
    whole = names and all(name.startswith("mooring_") for name in names)
    return [name.removeprefix("mooring_") for name in names] if whole else None


def _named(wildcards: Any) -> dict[str, str]:
    return wildcards._asdict() if isinstance(wildcards, Wildcards) else dict(wildcards.items())
