"""Run ``compass`` in a fork of a process that has imported all modules, and its Python jobs in further forks.

Starting Python, Snakemake and the library takes longer than a small run itself. The code executed is the same: the
command, Snakemake on the project's Snakefile, and the scripts of its jobs, each in a process of its own.
"""

import gc
import json
import os
import runpy
import subprocess
import sys
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import NoReturn

import snakemake.cli
import snakemake.script
from snakemake.benchmark import benchmarked

import compasslib.stages
from compasslib import cli


def serve() -> None:
    """Run commands read as lines of JSON and print their exit status."""
    for stage in Path(compasslib.stages.__file__).parent.glob("[a-z]*.py"):
        import_module(f"compasslib.stages.{stage.stem}")
    gc.freeze()  # else a collection in a fork copies the pages of all modules
    for line in sys.stdin:
        asked = json.loads(line)
        print(_forked(lambda asked=asked: _compass(**asked)), flush=True)


def _forked(act: Callable[[], object]) -> int:
    """Run a function in a fork of this process and return its exit status."""
    if not (child := os.fork()):
        _ended(act)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _ended(act: Callable[[], object]) -> NoReturn:
    """Run a function and end this process as the interpreter would."""
    status: object = 1
    try:
        act()
        status = 0
    except SystemExit as end:
        status = end.code
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status if isinstance(status, int) else int(status is not None))


def _compass(words: list[str], folder: str, environment: dict[str, str], files: list[str], first: str) -> None:
    for descriptor, file in enumerate((os.devnull, *files)):
        os.dup2(os.open(file, os.O_RDWR | os.O_CREAT | os.O_APPEND), descriptor)
    sys.stdout.reconfigure(line_buffering=True)  # in the order of both streams, which may be one file
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    os.execv = _snakemake
    exec(first, {})
    snakemake.script.PythonScript.execute_script = _script
    sys.exit(cli.main(words))


def _snakemake(python: str, command: list[str]) -> NoReturn:
    sys.argv = command[command.index("snakemake") :]
    _ended(lambda: snakemake.cli.main(sys.argv[1:]))


def _script(self: snakemake.script.PythonScript, name: str, edit: bool = False) -> None:
    with benchmarked(benchmark_record=self.bench_record):
        status = _forked(lambda: runpy.run_path(name, run_name="__main__"))
    if status:
        raise subprocess.CalledProcessError(status, [sys.executable, name])


if __name__ == "__main__":
    serve()
