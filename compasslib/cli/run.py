"""``compass run``: run Snakemake on a cruise, including jobs whose files no longer match their recorded hashes."""

from __future__ import annotations

import os
import re
import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping
from contextlib import chdir
from importlib.util import find_spec
from pathlib import Path

from compasslib.archive import provenance
from compasslib.config import cruise
from compasslib.errors import InputError
from compasslib.pipeline import guard, plan, records

METADATA = f"{guard.SNAKEMAKES}/metadata"  # where Snakemake stores parameters and code of each job


def run(asked: Namespace) -> int:
    """Replace this process by Snakemake.

    Raises:
        InputError: Snakemake or the cruise folder is missing, or an input of the cruise is dated in the future.
    """
    if find_spec("snakemake") is None:
        advice = "pip install 'compasslib[workflow]', or make install in a checkout"
        raise InputError("compass run", expected="Snakemake", found="none in this environment", advice=advice)
    if not Path(asked.cruise).is_dir():
        advice = "name the folder of a cruise"
        raise InputError(asked.cruise, expected="a cruise folder", found="no such folder", advice=advice)
    stale, options = _stale(Path(asked.cruise), asked.options)
    profile, snakefile = provenance.WORKFLOW / "profiles" / asked.profile, provenance.WORKFLOW / "Snakefile"
    cores = asked.cores or ("all" if asked.profile == "default" else None)
    command = [sys.executable, "-P", "-m", "snakemake", "--snakefile", str(snakefile), "--directory", asked.cruise]
    command += ["--workflow-profile", str(profile), *(["--cores", cores] if cores else [])]
    if asked.profile == "default" and "--config" not in options:  # a process for each stage takes a fifth more CPU
        command += ["--config", f"{guard.CORES}=1"]
    command += ["--forcerun", *stale] if stale else []
    sys.stdout.flush()
    os.execv(sys.executable, [*command, *(["--", *options] if options and options[0][:1] != "-" else options)])


def _stale(folder: Path, options: list[str]) -> tuple[list[str], list[str]]:
    """Return the outdated records, and the options with result files replaced by the records that Snakemake knows."""
    looks_only = any(re.fullmatch(r"--dry-?run|-[a-zA-Z]*n[a-zA-Z]*", option) for option in options)
    with chdir(folder):
        try:
            planned = plan.plan(cruise.load_cruise(Path()))
        except InputError:  # the Snakefile will refuse it, in Snakemake's log too
            return [], options
        guard.refuse_links(planned.folders())
        known, now = records.read_hashes(), guard.file_clock()
        if not looks_only:
            if restored := records.restore_times(planned.jobs, known, now):
                more = f" and {len(restored) - 1} more" if restored[1:] else ""
                print(f"{restored[0]}{more}: dated in the future and as recorded: redated", file=sys.stderr)
            guard.refuse_future(planned.moorings.given(planned.scripts), now)
        options = [planned.writers.get(option, option) for option in options]
        wanted = () if "verify" in options else (*planned.everything(), *planned.jobs.keys() & {*options})
        stale = records.stale(wanted, known)
        if not (os.path.isdir(METADATA) and any(os.scandir(METADATA))):  # their settings and code are unknown
            again = f"no {METADATA}: by what settings it was made is unknown"
            stale = {record: again for record in wanted if os.path.lexists(record)}
        if not looks_only:
            known.keep()
        _print_reasons(planned, wanted, stale)
        return list(stale), options


def _print_reasons(planned: plan.Plan, wanted: Iterable[str], stale: Mapping[str, str]) -> None:
    """Print why earlier jobs run again (files, settings or code), but not the jobs that depend on these."""
    lines = []
    for record in wanted:
        if before := records.read_any(Path(record)):
            rule, wildcards = planned.jobs[record]
            stage = planned.stages[rule]
            settings = {name: given(wildcards) for name, given in stage.settings.items()}
            why = [stale[record]] if record in stale else []
            why += provenance.changed_settings(before.get("parameters", {}), settings)
            why += ["its modules changed"] if before.get("code") != stage.code(wildcards) else []
            lines += [f"  {record}: {'; '.join(why)}"] if why else []
    if lines:
        print("Jobs that run again, and those that need their results:", *lines, sep="\n", file=sys.stderr)
