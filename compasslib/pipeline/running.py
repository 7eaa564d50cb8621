"""How Snakemake runs a cruise: recorded hashes beside times, and a second pass without what had to be stopped.

Snakemake answers a file whose content cannot be used by leaving out all that waits for it: summary, report and manifest
too. After such a run the same rules are planned once more without the moorings and calibrations that were stopped.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from snakemake.exceptions import ProtectedOutputException, WorkflowError  # type: ignore[import-untyped]
from snakemake.logging import logger  # type: ignore[import-untyped]

from compasslib.errors import InputError
from compasslib.pipeline import guard, ledger, lines, reasons, stopped
from compasslib.pipeline.plan import MANIFEST, REPORT, SUMMARY, Plan

METADATA = f"{guard.SNAKEMAKES}/metadata"  # what Snakemake remembers of each file: parameters and code
KILLED = (
    "killed before it could say why, most often because memory ran out; run again with fewer --cores, on a cluster "
    "with more memory for each job (--default-resources mem_mb=N)"
)
# Targets that wait for every mooring; the rules of a module are called by its name before theirs.
OF_ALL = {"all", "summary", "report", "provenance", SUMMARY, REPORT, MANIFEST}


@dataclass
class Run:
    """Snakemake's own two steps, and what is done around them."""

    workflow: Any
    plan: Plan
    execute_plainly: Any
    build_plainly: Any
    known: ledger.KnownHashes = field(default_factory=ledger.seen)
    shown: lines.Lines | None = None
    begun: float = 0.0  # by ``guard.file_clock``

    def build(self) -> None:
        """Plan the jobs; what the records deny is made again, whatever its time says."""
        self.known, made = ledger.seen(), frozenset(self.plan.everything())
        names = ["", *stopped.folders(self.plan.cruise)]
        if not self.workflow.dryrun:
            self._date(names)
        if any(os.scandir(METADATA)):
            self.workflow.dag.forcefiles |= ledger.stale(made, names, self.known)
        else:  # deleted or left behind: nobody knows by what settings and code the results were made
            self.workflow.dag.forcefiles |= {file for file in made if os.path.exists(file)}
        with _one_line():
            self._build()
        if not self.workflow.dryrun:
            self.known.keep()

    def _build(self) -> None:
        try:
            self.build_plainly()
        except ProtectedOutputException:  # Snakemake's own look at the files of jobs to run, not at their folders
            guard.refuse_read_only(file for file in self.plan.everything() if os.path.lexists(file))
            raise
        if not self.workflow.dryrun:
            guard.refuse_read_only(file for job in lines.jobs(self.workflow).values() for file in job.output)

    def _date(self, names: Sequence[str]) -> None:
        """See to it that nothing that jobs read is dated in the future."""
        now = guard.file_clock()
        if restored := ledger.restore_times(names, self.known, now):
            more = "dated in the future and as recorded: dated anew"
            logger.warning(f"{restored[0]}{f' and {len(restored) - 1} more' if restored[1:] else ''}: {more}")
        with _one_line():
            guard.refuse_future(self.plan.given(), now)

    def execute(self, **settings: Any) -> None:
        """Run the jobs, and what is left to run of the others where some had to be stopped."""
        kind = settings["executor_plugin"].common_settings
        if kind.dryrun_exec or kind.touch_exec:
            self.execute_plainly(**settings)
            if kind.dryrun_exec:
                self._say_why()
            return
        self._begin()
        try:
            self._pass(settings)
        except WorkflowError:
            self._without_stopped(settings)
            raise
        finally:
            self._say_again()

    def _begin(self) -> None:
        self.workflow.execution_settings.keep_going = True
        self.begun = guard.file_clock()
        with _one_line():
            if guard.alone():
                self.workflow.execution_settings.lock = False
                guard.sweep()
            stopped.forget(self.plan.cruise)

    def _pass(self, settings: dict[str, Any]) -> None:
        try:
            self.execute_plainly(**settings)
        finally:
            if self.shown:
                self.shown.gather()

    def _without_stopped(self, settings: dict[str, Any]) -> None:
        while self._whole_run() and self.plan.stopped.look(self.plan.cruise):
            self._tell()
            try:
                self._pass(settings)
            except WorkflowError as error:
                logger.error(str(error))

    def _say_why(self) -> None:
        stages = {rule.name: k for k, rule in enumerate(self.workflow.rules)}
        ours = [job for job in lines.jobs(self.workflow).values() if lines.ours(job)]
        ours.sort(key=lambda job: (stages[job.rule.name], job.log[0]))
        for line in reasons.lines({lines.label(job): job for job in ours}, self.known):
            logger.info(line)

    def _say_again(self) -> None:
        """Say at the end what was warned of and who was stopped, which has long left the screen."""
        if self.shown:
            self.shown.close()
        self.plan.stopped.look(self.plan.cruise)
        named = {"mooring": self.plan.stopped.moorings, "calibration": self.plan.stopped.calibrations}
        errors = [f"  {kind} {name}: {why}" for kind, whys in named.items() for name, why in whys.items()]
        if errors:
            logger.info("\n".join([f"Stopped: {len(errors)}", *errors]))
        if killed := [] if self._broken_off() else self._killed():
            logger.error("\n".join([f"Killed: {len(killed)}", *(f"  {name}: {KILLED}" for name in killed)]))

    def _killed(self) -> list[str]:
        """Return the jobs that began in this run and ended without a result or a word why."""
        every = [job for job in lines.jobs(self.workflow).values() if lines.ours(job)]
        return [lines.label(job) for job in every if lines.is_silent(job, self.begun)]

    def _whole_run(self) -> bool:
        """Return whether all was tried, rather than the run broken off, and wanted that waits for every mooring."""
        targets = self.workflow.dag_settings.targets
        of_all = any(target in OF_ALL or target.endswith(tuple(f"_{rule}" for rule in OF_ALL)) for target in targets)
        return not self._broken_off() and (not targets or of_all)

    def _broken_off(self) -> bool:
        scheduler = getattr(self.workflow, "scheduler", None)
        return bool(scheduler is None or scheduler._user_kill or scheduler.running or scheduler.open_jobs)

    def _tell(self) -> None:
        reasons = self.plan.stopped
        for name in (*reasons.moorings, *(f"{stopped.CALIBRATIONS}/{name}" for name in reasons.calibrations)):
            cleared = ledger.clear_orphans(name)
            older = f"; {len(cleared)} files deleted that no longer fit" if cleared else ""
            logger.info(f"results/{name}: stopped{older}; the others go on without it")


@contextmanager
def _one_line() -> Iterator[None]:
    """End the run in one line where the block refuses what it was given."""
    try:
        yield
    except InputError as error:
        logger.error(f"error: {error}")
        sys.exit(1)


def prepare(workflow: Any, plan: Plan) -> dict[str, list[str]]:
    """Take Snakemake's steps in hand, and return the raw files that a rule may simulate, by mooring.

    Args:
        plan: what the rules need; in a job of a cluster it learns what was stopped.

    Raises:
        InputError: the run would write through a link, over a raw file, or elsewhere than into the cruise's folder.
    """
    cruise = plan.cruise
    moved = workflow.modifier.path_modifier
    if moved.prefix or moved.modifies_prefixes:
        advice = "start the workflow that uses this one with --directory CRUISE, and leave prefix: out"
        raise InputError("module", expected="results in the folder of the run", found="a prefix", advice=advice)
    if workflow.exec_mode.name != "DEFAULT":  # a job on a cluster: what it may do was looked at where it came from
        plan.stopped.look(cruise)
        return guard.simulated_names(cruise)
    guard.refuse_links(stopped.folders(cruise))
    guard.refuse_read_only([f"{guard.SNAKEMAKES}/log"])  # without which Snakemake does not even plan
    run = Run(workflow, plan, workflow.execute, workflow._build_dag, shown=lines.show(workflow))
    workflow.execute, workflow._build_dag = run.execute, run.build
    files = guard.to_simulate(cruise, ledger.seen())
    for name in cruise.moorings if cruise.options.demonstration else ():
        if name not in files:
            logger.warning(f"{name}: raw files used as they stand: no record says that the simulation wrote them")
    return files
