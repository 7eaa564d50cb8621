"""The command line interface ``compass``.

Each command imports only the modules that it needs, so that help and error messages appear at once.

A command raises InputError for input that it cannot use, which is reported in one line on stderr, with exit status 1:

>>> import subprocess, sys
>>> asked = "import sys; from compasslib.cli import main; sys.exit(main(['check', 'nowhere']))"
>>> ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True)
>>> ran.returncode, ran.stderr.count("\\n")
(1, 1)
"""

import argparse
import os
import re
import signal
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from compasslib import __version__
from compasslib.errors import InputError

FORMS = ("csv", "mat", "parquet", "zarr", "pd0", "oceansites", "erddap", "rocrate")  # formats of compass export
MODULES = {  # of commands that share a module
    **{"correct": "compasslib.cli.check", "run": "compasslib.cli"},
    **{"explain": "compasslib.cli.results", "verify": "compasslib.cli.results"},
}
WITHOUT_LOCK = re.compile(r"--unlock|--nolock|--dry-?run|-[a-zA-Z]*n[a-zA-Z]*")  # options of Snakemake


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status: 0 success, 1 unusable input, 2 invalid usage, 130 interrupted."""
    parser = _parser()
    words = list(sys.argv[1:] if arguments is None else arguments)
    end = words.index("--") if words[:1] == ["run"] and "--" in words else len(words)
    asked = parser.parse_args(words[:end])
    asked.options = words[end + 1 :]  # Snakemake's own
    if asked.command == "verify" and asked.yes and not asked.clear:
        parser.error("--yes goes with --clear")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        if signal.getsignal(number) != signal.SIG_IGN:  # as nohup has SIGHUP ignored
            signal.signal(number, _interrupt)  # all like Ctrl-C, so that no incomplete file is left
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]  # for terminals without a degree sign
    try:
        module = import_module(MODULES.get(asked.command, f"compasslib.cli.{asked.command}"))
        status: int = getattr(module, asked.command)(asked)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of a pipe has exited, as in ``compass explain M1 | head``
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (InputError, OSError) as error:
        return _failed(f"error: {error}")
    except MemoryError:
        return _failed("error: out of memory; close other programs, or use a machine with more")
    except SystemExit as error:  # raised by a plug-in, perhaps with status 0
        return _failed(f"error: a plug-in ended the program by SystemExit: {error}; correct or remove it")
    except KeyboardInterrupt:
        return _failed("error: interrupted; no file is left half written", 128 + signal.SIGINT)
    return status


def run(asked: argparse.Namespace) -> int:
    """Start Snakemake on a cruise, in place of this process."""
    from compasslib.archive import provenance

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
    records = [*Path(asked.cruise).glob("results/**/logs/*.json")]
    if records and not any(Path(asked.cruise).glob(".snakemake/metadata/*")):
        print("The folder .snakemake with the settings of earlier jobs is missing: all jobs run again.", flush=True)
        command.append("--forceall")
    an_hour_on = time.time() + 3600.0  # file servers' clocks may be minutes ahead
    ahead = max((path.stat().st_mtime for path in records), default=0.0) > an_hour_on
    if ahead and "--forceall" not in options:
        advice = f"set the clock, and make all anew: compass run {asked.cruise} -- --forceall"
        raise InputError(asked.cruise, expected="results of the past", found="some of a later date", advice=advice)
    os.execv(sys.executable, [*command, *(["--", *options] if options and options[0][:1] != "-" else options)])


def require_folder(cruise: str) -> None:
    """Raise InputError if the folder of a cruise does not exist."""
    if not os.path.isdir(cruise):
        raise InputError(cruise, "a cruise folder", "no such folder", "name the folder of a cruise")


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; within netCDF4, which can lose an exception that a signal raises, a little later."""
    if frame is not None and frame.f_code.co_filename.endswith("_netCDF4.pyx"):
        signal.setitimer(signal.ITIMER_REAL, 0.01)
    else:
        raise KeyboardInterrupt


def _failed(line: str, status: int = 1) -> int:
    print(line, file=sys.stderr)
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("compass", description="Compass deviation of moored current records.")
    parser.add_argument("--version", action="version", version=f"compass {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    folder: dict[str, Any] = {"default": ".", "metavar": "CRUISE", "help": "cruise folder (default: this one)"}

    def command(name: str, what: str, example: str) -> argparse.ArgumentParser:
        epilog = f"example:\n  compass {name} {example}"
        made: argparse.ArgumentParser = commands.add_parser(
            name, help=what, description=what, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        return made

    check = command("check", "validate configuration and input files without processing", "my_cruise")
    check.add_argument("cruise", nargs="?", **folder)

    example = "exports/EG4 --into my_cruise --latitude 65.33 --longitude -32.96 --water-depth 894"
    init = command("init", "draft configuration files from instrument exports", example)
    init.add_argument("files", metavar="FILE", nargs="+", help="exports, or folders of them; one folder a mooring")
    init.add_argument("--into", **folder)
    init.add_argument("--name", help="all instruments are of this mooring (default: one mooring a folder)")
    init.add_argument("--latitude", type=float, help="degrees north")
    init.add_argument("--longitude", type=float, help="degrees east, west negative")
    init.add_argument("--water-depth", type=float, help="m")

    what = "correct one mooring in this process, without Snakemake"
    correct = command("correct", what, "EG4 --cruise my_cruise")
    correct.add_argument("mooring", metavar="MOORING", help="its name")
    correct.add_argument("--cruise", **folder)
    into = "new folder of its results (default: CRUISE/corrected/MOORING)"
    correct.add_argument("--into", metavar="FOLDER", help=into)

    run = command("run", "process a cruise: make results that are missing or outdated", "my_cruise --cores 4")
    run.add_argument("cruise", nargs="?", **folder)
    run.add_argument("--cores", metavar="N", help="number of parallel jobs (default: all cores)")
    profiles = "of workflow/profiles: default, slurm or storage"
    run.add_argument("--profile", default="default", metavar="NAME", help=profiles)
    run.epilog = f"{run.epilog}\n  compass run my_cruise -- --dry-run      after --, options of Snakemake, or files"

    what = "print the diagnosis of a mooring, calibration or shared compass"
    explain = command("explain", what, "EG4 --cruise my_cruise")
    explain.add_argument("mooring", metavar="NAME", help="its name, or the folder of its results")
    explain.add_argument("--cruise", **folder)

    what = "export a product in the form that another program reads, or the cruise as a research object crate"
    export = command("export", what, "EG4 --cruise my_cruise --to pd0 --into to_deposit")
    export.add_argument("mooring", metavar="MOORING", nargs="?", help="its name; none with rocrate")
    export.add_argument("--cruise", **folder)
    forms = (
        "csv, parquet: one row per sample and bin; mat: MATLAB structures; zarr: corrected.nc as Zarr; pd0: the raw "
        "file with corrected headings; oceansites: corrected.nc under its OceanSITES name; erddap: gridded.nc by time "
        "and depth alone; rocrate: the whole cruise as one ZIP to deposit"
    )
    export.add_argument("--to", required=True, choices=FORMS, help=forms)
    export.add_argument("--into", metavar="FOLDER", help="folder of the files (default: CRUISE/export)")

    diff = command("diff", "compare the results of two runs by mooring", "results_before my_cruise")
    place = "cruise, its deposit (ZIP), folder of results, or of one mooring's"
    diff.add_argument("old", metavar="OLD", help=place)
    diff.add_argument("new", metavar="NEW", help=place)

    verify = command("verify", "verify results against their manifest", "my_cruise")
    verify.add_argument("cruise", nargs="?", **folder)
    verify.add_argument("--clear", action="store_true", help="list results that are no longer configured instead")
    verify.add_argument("--yes", action="store_true", help="with --clear: remove them")
    return parser
