"""``compass run``: start Snakemake on a cruise."""

from __future__ import annotations

import os
import re
import sys
from argparse import Namespace
from importlib.util import find_spec
from pathlib import Path

from compasslib.archive import provenance
from compasslib.cli import require_folder
from compasslib.errors import InputError

WITHOUT_LOCK = re.compile(r"--unlock|--nolock|--dry-?run|-[a-zA-Z]*n[a-zA-Z]*")


def run(asked: Namespace) -> int:
    """Replace this process by Snakemake."""
    if find_spec("snakemake") is None:
        advice = "pip install 'compasslib[workflow]', or make install in a checkout"
        raise InputError("compass run", expected="Snakemake", found="none in this environment", advice=advice)
    require_folder(asked.cruise)
    options, locked = list(asked.options), any(Path(asked.cruise).glob(".snakemake/locks/*.lock"))
    if locked and not any(map(WITHOUT_LOCK.fullmatch, options)):
        advice = f"wait until it has ended; if it was killed: compass run {asked.cruise} -- --unlock"
        raise InputError(asked.cruise, expected="one run at a time", found="the lock of another", advice=advice)
    profile, snakefile = provenance.WORKFLOW / "profiles" / asked.profile, provenance.WORKFLOW / "Snakefile"
    cores = asked.cores or ("all" if asked.profile == "default" else None)
    command = [sys.executable, "-P", "-m", "snakemake", "--snakefile", str(snakefile), "--directory", asked.cruise]
    command += ["--workflow-profile", str(profile), *(["--cores", cores] if cores else [])]
    os.execv(sys.executable, [*command, *(["--", *options] if options and options[0][:1] != "-" else options)])
