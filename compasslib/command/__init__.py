"""The command ``compass``: what a user asks of a cruise on a terminal, without Snakemake.

A room is imported only by the command that needs it, so that help and mistakes come at once.

A mistake is one line on stderr, and exit status 1:

>>> import subprocess, sys
>>> asked = "import sys; from compasslib.command import main; sys.exit(main(['check', 'nowhere']))"
>>> ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True)
>>> ran.returncode, ran.stderr.count("\\n")
(1, 1)
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module

from compasslib import __version__
from compasslib.core.errors import InputError

FAILED, INTERRUPTED = 1, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status: 0 done, 1 input that cannot be used, 2 a wrong command line.

    Args:
        arguments: words of the command line; those of this process where absent.
    """
    asked = _parser().parse_args(arguments)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupted)  # as by Ctrl-C, so that nothing half made is left
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]  # a terminal without the sign of degree
    try:
        status: int = import_module(f"compasslib.command.{asked.command}").run(asked)
        sys.stdout.flush()
    except InputError as error:
        return _failed(f"error: {error}", FAILED)
    except OSError as error:
        return _closed() if isinstance(error, BrokenPipeError) else _failed(f"error: {error}", FAILED)
    except KeyboardInterrupt:
        return _failed("error: interrupted; nothing was written", INTERRUPTED)
    return status


def _interrupted(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _failed(line: str, status: int) -> int:
    print(line, file=sys.stderr)
    return status


def _closed() -> int:
    """End quietly where the reader of a pipe has gone, as ``compass explain M1 | head`` does."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("compass", description="Compass deviation of moored current records.")
    parser.add_argument("--version", action="version", version=f"compass {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    check = commands.add_parser("check", help="are config and raw files usable? Nothing is run")
    check.add_argument("cruise", metavar="CRUISE", nargs="?", default=".", help="cruise folder (default: this one)")

    init = commands.add_parser("init", help="draft config and YAML files from what exports hold")
    init.add_argument("files", metavar="FILE", nargs="+", help="exports, or folders of them; one folder a mooring")
    init.add_argument("--into", default=".", metavar="CRUISE", help="cruise folder (default: this one)")
    init.add_argument("--name", help="all instruments are of this mooring (default: one mooring a folder)")
    init.add_argument("--latitude", type=float, help="degrees north")
    init.add_argument("--longitude", type=float, help="degrees east, west negative")
    init.add_argument("--water-depth", type=float, help="m")

    correct = commands.add_parser("correct", help="correct one mooring in this process, without Snakemake")
    correct.add_argument("mooring", metavar="MOORING", help="its name")
    correct.add_argument("--cruise", default=".", help="cruise folder (default: this one)")
    correct.add_argument(
        "--into", metavar="FOLDER", help="new folder of its results (default: CRUISE/corrected/MOORING)"
    )

    explain = commands.add_parser("explain", help="the diagnosis of one mooring in words")
    explain.add_argument("mooring", metavar="MOORING", help="its name, or the folder of its results")
    explain.add_argument("--cruise", default=".", help="cruise folder (default: this one)")

    export = commands.add_parser("export", help="a corrected record in the form that others read")
    export.add_argument("mooring", metavar="MOORING", help="its name")
    export.add_argument("--cruise", default=".", help="cruise folder (default: this one)")
    export.add_argument("--to", required=True, choices=("csv", "mat", "pd0", "oceansites"), help="the form")
    export.add_argument("--into", metavar="FOLDER", help="folder of the files (default: CRUISE/export)")

    diff = commands.add_parser("diff", help="what changed between two runs, mooring by mooring")
    for place in ("old", "new"):
        diff.add_argument(place, metavar=place.upper(), help="cruise folder, folder of results, or of one mooring's")
    return parser
