"""Run all jobs of a mooring or calibration in one or a few processes, with the same records, logs and results."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from graphlib import TopologicalSorter
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from compasslib.pipeline.job import run_job


def run_jobs(snakemake: Any) -> None:
    """Run the jobs of ``params.jobs``, each with its log and record, in as many processes as threads.

    Raises:
        SystemExit: a job failed.
    """
    jobs = {str(Path(each["log"]).with_suffix(".json")): each for each in snakemake.params.jobs}
    order = TopologicalSorter({record: jobs.keys() & {*each["input"]} for record, each in jobs.items()})
    order.prepare()
    stages = {each["function"]: load_stage(each["function"]) for each in jobs.values()}  # before the fork
    with ProcessPoolExecutor(snakemake.threads, get_context("fork")) as pool:
        running: dict[Any, str] = {}
        while order.is_active():
            for record in sorted(order.get_ready(), key=list(jobs).index):
                alone = SimpleNamespace(**jobs[record] | {"log": [jobs[record]["log"]]})
                running[pool.submit(run_job, alone, stages[alone.function])] = record
            for ended in wait(running, return_when=FIRST_COMPLETED).done:
                ended.result()
                order.done(running.pop(ended))


def load_stage(function: str) -> Callable[..., None]:
    """Import the function of a stage, given as ``module.name`` below ``compasslib.stages``."""
    module, _, name = function.partition(".")
    stage: Callable[..., None] = getattr(import_module(f"compasslib.stages.{module}"), name)
    return stage
