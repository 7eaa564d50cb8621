"""What a person sees of a run: a line for each job that ended with the time left, and at the end what was warned of.

Snakemake's own log file in the cruise's .snakemake/log stays as it is, and so does its screen where another logger or
``--verbose`` was asked for. A job writes into its log alone; the line shown is the last one there that is no warning.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any

from snakemake.logging import logger  # type: ignore[import-untyped]
from snakemake_interface_logger_plugins.common import LogEvent

from compasslib.pipeline import ledger

SCREEN = "DefaultStreamHandler"  # Snakemake's name for it; absent where another logger writes to the screen
WARNING = "warning: "
NO_NEWS = (LogEvent.JOB_STARTED, LogEvent.PROGRESS, LogEvent.RESOURCES_INFO)
# Said in between by Snakemake without a kind of its own. What its next version words otherwise is shown.
CHATTER = (
    *("Building DAG of jobs", "Using shell: ", "Select jobs to execute", "Reasons:\n    (check individual jobs"),
    *("Some jobs were triggered by provenance", "Rules with provenance triggered jobs: "),
)
SAID_BY_THE_JOB = "returned non-zero exit status 1."  # its error is on the screen; one that was killed said nothing
# How long a stage takes beside reading a record, for those that have not run yet: a guess from small runs.
USUAL = {"diagnose": 5.0, "figures": 2.0, "calibrate": 2.0, "diagnose_calibration": 5.0}


def label(job: Any) -> str:
    """Return whose job it is and its stage as ``M1 read top``; the stage alone where it is of the whole cruise."""
    if not ours(job):
        return " ".join([job.rule.name, *map(str, job.wildcards)])
    log = Path(job.log[0])
    folder, stage = log.parent.parent, log.stem.replace("_", " ", 1)
    return stage if folder.name == ledger.RESULTS else f"{folder.name} {stage}"


def ours(job: Any) -> bool:
    """Return whether a job is of this workflow, and not of another that uses it as a module."""
    return bool(job.log) and job.log[0].startswith(f"{ledger.RESULTS}/")


def is_silent(job: Any, begun: float) -> bool:
    """Return whether a job ended without a record of what it made and without a word why, as one that was killed.

    Args:
        begun: when the run began, by the clock that dates its files, seconds since 1970.
    """
    log = Path(job.log[0])
    try:
        ran = log.stat().st_mtime >= begun and not log.with_suffix(".json").exists()
    except FileNotFoundError:
        return False
    return ran and not any(line.startswith("error: ") for line in _log(job))


def jobs(workflow: Any) -> dict[Any, Any]:
    """Return the jobs of a run that do something, by the number that Snakemake gives them."""
    return {job.jobid: job for job in workflow.dag.needrun_jobs(exclude_finished=False) if not job.is_norun}


def show(workflow: Any) -> Lines | None:
    """Put the lines on Snakemake's screen and return them; nothing where another logger writes there."""
    screen = next((handler for handler in logger.handlers if handler.name == SCREEN), None)
    if screen is None or workflow.output_settings.verbose:
        return None
    lines = Lines(workflow, screen.formatter)
    screen.setFormatter(lines)
    return lines


class Lines(logging.Formatter):
    """Snakemake's records, most of which become nothing and each job that ended one line."""

    def __init__(self, workflow: Any, own: Any) -> None:
        super().__init__()
        self.workflow, self.own, self.clock = workflow, own, Clock()
        self.warnings: list[str] = []
        self.counted = ""

    def format(self, record: logging.LogRecord) -> str:
        """Return what is shown of a record: nothing, a line of ours, or Snakemake's own text."""
        event, text = getattr(record, "event", None), str(record.msg or "")
        if event == LogEvent.JOB_FINISHED:
            return self._ended(record)
        if event == LogEvent.RUN_INFO:
            return self._planned(record.stats)  # type: ignore[attr-defined]
        if event == LogEvent.JOB_STARTED:
            self.clock.start(record)
        chatter = event is None and text.startswith(CHATTER)
        said = event == LogEvent.ERROR and text.rstrip().endswith(SAID_BY_THE_JOB)
        return "" if event in NO_NEWS or chatter or said else str(self.own.format(record))

    def gather(self) -> None:
        """Take up what the jobs that have ended warned of; by ``--quiet`` none was shown."""
        if self.workflow.dag is not None:
            ended = [job for job in jobs(self.workflow).values() if ours(job) and self.workflow.dag.finished(job)]
            self.warnings += [line for job in ended for line in _log(job) if WARNING in line]

    def close(self) -> None:
        """Say once more what the jobs of this run warned of."""
        if self.warnings:
            logger.info("\n".join([f"Warnings: {len(self.warnings)}", *(f"  {line}" for line in self.warnings)]))

    def _planned(self, stats: dict[str, int]) -> str:
        self.clock = Clock(by_rule=self.clock.by_rule)  # of a second pass, whose numbers begin anew
        counts = {rule: n for rule, n in stats.items() if rule not in ("all", "total")}
        line = f"{sum(counts.values())} jobs: {', '.join(f'{rule} {n}' for rule, n in counts.items())}"
        shown, self.counted = "" if line == self.counted else line, line  # a dry run says it twice
        return shown

    def _ended(self, record: logging.LogRecord) -> str:
        every = jobs(self.workflow)
        number = record.job_id  # type: ignore[attr-defined]
        if number not in every:
            return ""  # as ``all``, which does nothing
        self.clock.end(every, record)
        ended = sum(job in self.clock.ended for job in every)
        place = f"{ended:{len(str(len(every)))}}/{len(every)}"
        return f"[{place}{self.clock.left(every, record.created)}] {label(every[number])}: {_told(every[number])}"


@dataclass
class Clock:
    """When jobs began and ended, and by that how long the others will take."""

    began: dict[Any, float] = field(default_factory=dict)
    ended: dict[Any, float] = field(default_factory=dict)  # seconds that each took
    by_rule: dict[str, list[float]] = field(default_factory=dict)

    def start(self, record: Any) -> None:
        """Take up the jobs that begin."""
        self.began |= dict.fromkeys(record.jobs, record.created)

    def end(self, every: dict[Any, Any], record: Any) -> None:
        """Take up a job that ended; of a group on a cluster only that it did."""
        took = record.created - self.began.get(record.job_id, math.inf)
        self.ended[record.job_id] = max(took, 0.0)
        if took > 0:
            self.by_rule.setdefault(every[record.job_id].rule.name, []).append(took)

    def left(self, every: dict[Any, Any], now: float) -> str:
        """Return the time left by what the jobs so far took, side by side as they ran; nothing where none is known."""
        waiting = sum(self._usual(job.rule.name) for number, job in every.items() if number not in self.ended)
        done = sum(took for number, took in self.ended.items() if number in every)
        if not waiting or not done:
            return ""
        return f", {_rounded((now - min(self.began.values())) * waiting / done)} left"

    def _usual(self, rule: str) -> float:
        if rule in self.by_rule:
            return fmean(self.by_rule[rule])
        known = [fmean(took) / USUAL.get(name, 1.0) for name, took in self.by_rule.items()]
        return fmean(known) * USUAL.get(rule, 1.0) if known else 0.0


def _rounded(seconds: float) -> str:
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{math.ceil(seconds / 5) * 5} s"


def _told(job: Any) -> str:
    """Return what a job said last, without the name that stands before it already."""
    told = [line for line in _log(job) if WARNING not in line and not line.startswith(" ")] if ours(job) else []
    if not told:
        return "done"
    name, _, what = told[-1].partition(": ")
    return what if name.split(" ")[0] == label(job).split(" ")[0] else told[-1]


def _log(job: Any) -> Iterator[str]:
    with suppress(OSError):
        yield from Path(job.log[0]).read_text(encoding="utf-8", errors="replace").splitlines()
