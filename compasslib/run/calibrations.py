"""What the rules of calibrations need from the cruise's configuration: files, modules and narrow settings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compasslib import calibration
from compasslib.archive import provenance
from compasslib.calibration import KINDS
from compasslib.config import calibrations
from compasslib.config.cruise import CALIBRATIONS, Cruise
from compasslib.run.plan import refuse
from compasslib.search import kinds


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
        return calibrations.settings(self.cruise.calibrations[wildcards.calibration])

    def modules(self, wildcards: Any) -> tuple[str, ...]:
        """Return the library files behind one calibration, its own kind's only."""
        own = f"compasslib.calibration.{KINDS[self.kind(wildcards)].module}"
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
        return calibration.figures(kind)

    def figure_modules(self, wildcards: Any) -> tuple[str, ...]:
        """Return the library files behind the figures of one calibration, its own kind's only."""
        kind = self.kind(wildcards)
        own = [f"compasslib.plots.{KINDS[kind].module}"] if KINDS[kind].figures else []
        return provenance.sources(self.scripts / "calibration_figures.py", *own)

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


def plan(cruise: Cruise, scripts: Path) -> Calibrations:
    """Return the answers for the rules, after refusing kinds that this version does not offer.

    Raises:
        InputError: a calibration of such a kind.
    """
    for name, file in cruise.calibrations.items():
        refuse(f"{CALIBRATIONS}/{name}.yaml: kind", file.kind, tuple(KINDS))
    return Calibrations(cruise, scripts)
