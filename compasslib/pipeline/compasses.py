"""What the rules of a compass that several records share need from the cruise's configuration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from compasslib.config import compasses
from compasslib.config.cruise import Cruise
from compasslib.pipeline.stopped import Stopped

FIGURES = ("coefficients", "curve")
ALONE = ("diagnosis", "deviation", "assessment", "summary")  # of each mooring whose compass has a name


@dataclass(frozen=True)
class Compasses:
    """Answers for the rules; each method takes a job's wildcards."""

    cruise: Cruise
    stopped: Stopped
    figures: tuple[str, ...] = FIGURES

    @cached_property
    def members(self) -> dict[str, tuple[list[str], list[str]]]:
        """Moorings and calibrations of each compass."""
        return compasses.members(self.cruise.moorings, self.cruise.calibrations)

    @cached_property
    def moorings(self) -> dict[str, str]:
        """The compass of each mooring that names one."""
        return {mooring: name for name, (moorings, _) in self.members.items() for mooring in moorings}

    @property
    def others(self) -> list[str]:
        """Moorings that are judged by themselves."""
        return [name for name in self.cruise.moorings if name not in self.moorings]

    def summaries(self, wildcards: Any) -> list[str]:
        """Return what each mooring of a compass tells, those that were stopped left out."""
        moorings, _ = self.members[wildcards.compass]
        return [f"results/{name}/work/alone/summary.json" for name in moorings if name not in self.stopped.moorings]

    def calibrations(self, wildcards: Any) -> list[str]:
        """Return the calibrations of a compass, those that were stopped left out."""
        _, given = self.members[wildcards.compass]
        return [f"results/calibrations/{n}/calibration.json" for n in given if n not in self.stopped.calibrations]

    def spheres(self, wildcards: Any) -> dict[str, str | None]:
        """Return in which sphere each record of a compass was."""
        moorings, given = self.members[wildcards.compass]
        moored = {name: self.cruise.moorings[name] for name in moorings}
        own = {name: mooring.instruments[mooring.compromised].sphere for name, mooring in moored.items()}
        return own | {name: self.cruise.calibrations[name].sphere for name in given}

    def joined(self, wildcards: Any) -> str:
        """Return what the records of a mooring's compass tell together."""
        return f"results/compasses/{self.moorings[wildcards.mooring]}/compass.json"

    def names(self) -> list[str]:
        """Return the compasses of which there are results: those with a record that was not stopped."""
        stopped = self.stopped
        return [
            name
            for name, (moorings, given) in self.members.items()
            if not (stopped.moorings.keys() >= {*moorings} and stopped.calibrations.keys() >= {*given})
        ]

    def listed(self, wildcards: Any) -> list[str]:
        """Return the compasses for the report."""
        return self.names()

    def shown(self, wildcards: Any) -> list[str]:
        """Return what the report shows of the compasses."""
        each = ("compass.json", "diagnosis.json")
        return [*(f"results/compasses/{name}/{file}" for name in self.names() for file in each), *self.drawn()]

    def drawn(self) -> list[str]:
        """Return the figures of the compasses, from which the jobs' records lead back to all else."""
        return [f"results/compasses/{name}/figures/{figure}.png" for name in self.names() for figure in self.figures]

    def made(self) -> list[str]:
        """Return all files of the compasses, and what each of their moorings shows alone."""
        going = [name for name in self.moorings if name not in self.stopped.moorings]
        alone = [f"results/{name}/work/alone/{file}.json" for name in going for file in ALONE]
        return [*self.shown(None), *alone]
