"""What the rules of the whole cruise need: files and settings of all moorings and calibrations that were not stopped.

Each method takes a job's wildcards, as some are stopped only after the rules were written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from compasslib.run.calibrations import Calibrations
from compasslib.run.plan import FIGURES, Plan, made
from compasslib.run.stopped import Stopped

SUMMARY, REPORT, MANIFEST = "results/summary.csv", "results/report.html", "results/ro-crate-metadata.json"
LAST = ("corrected.nc", "assessment.json", "forms.json", *(f"figures/{figure}.png" for figure in FIGURES))


@dataclass(frozen=True)
class Whole:
    """Answers for the rules that take all moorings together."""

    plan: Plan
    calibrations: Calibrations
    stopped: Stopped = field(default_factory=Stopped)

    def of(self, *files: str) -> Callable[[Any], list[str]]:
        """Return what gives these files of each mooring."""
        return lambda wildcards: [f"results/{name}/{file}" for file in files for name in self._moorings()]

    def records(self, wildcards: Any) -> list[str]:
        """Return the records of the instruments of all moorings."""
        roles = self.plan.roles(self._moorings()).items()
        return [f"results/{name}/work/{role}.nc" for name, used in roles for role in used]

    def roles(self, wildcards: Any) -> dict[str, list[str]]:
        """Return the instruments that each mooring uses."""
        return self.plan.roles(self._moorings())

    def described(self, wildcards: Any) -> dict[str, dict[str, Any]]:
        """Return place, dates and instruments of each mooring."""
        told = self.plan.described()
        return {name: told[name] for name in self._moorings()}

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
        """Return the same by what they are of, as ``Plan.configuration`` names it."""
        told = self.reasons(wildcards)
        return {f"{part[:-1]} {name}": why for part, reasons in told.items() for name, why in reasons.items()}

    def conventions(self, wildcards: Any) -> list[str]:
        """Return what was found of each mooring's netCDF files."""
        return [f"results/{name}/conventions.json" for name in self._moorings()]

    def table(self, wildcards: Any) -> list[str]:
        """Return the summary; none where there are no moorings."""
        return [SUMMARY] if self.plan.cruise.moorings else []

    def products(self, wildcards: Any) -> list[str]:
        """Return the files from which the jobs' records lead back to all others."""
        checked = self.conventions(wildcards) if self.plan.cruise.options.conventions.check else []
        page = [REPORT] if self.plan.cruise.moorings or self.plan.cruise.calibrations else []
        return [*self.of(*LAST)(wildcards), *checked, *self.table(wildcards), *self.calibrated(wildcards), *page]

    def everything(self, wildcards: Any = None) -> list[str]:
        """Return all files that a run makes, so that none which is missing goes unseen."""
        last = self.products(wildcards)
        each = [file for name, roles in self.roles(wildcards).items() for file in made(name, roles)]
        return list(dict.fromkeys([*each, *last, *([MANIFEST] if last else [])]))

    def _moorings(self) -> list[str]:
        return [name for name in self.plan.cruise.moorings if name not in self.stopped.moorings]

    def _calibrations(self) -> list[str]:
        return [name for name in self.plan.cruise.calibrations if name not in self.stopped.calibrations]
