"""Run cruises through Snakemake as users do, and inspect the results."""

import atexit
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.world.sea import SHARED

PROJECT = Path(__file__).resolve().parents[2]
CONTRACT = SHARED.parent / "tools/check_contract.py"
UNDRAWN = """
from dataclasses import replace
from compasslib.archive.files import atomic_write
from compasslib.stages import figures
from PIL import Image
def draw(file, data):
    with atomic_write(file) as temporary:
        Image.new("RGB", (9, 9)).save(temporary, "PNG")
figures.FIGURES = {of: [replace(row, draw=draw) for row in rows] for of, rows in figures.FIGURES.items()}
"""


def command(folder: Path, project: Path = PROJECT) -> list[str]:
    """Compose Snakemake's command; -P: like ``snakemake`` itself, import no modules from the working directory."""
    where = ("--snakefile", f"{project / 'Snakefile'}", "--directory", f"{folder}")
    return [sys.executable, "-P", "-m", "snakemake", *where]


def environment(*beside: Path) -> dict[str, str]:
    """Copy the environment with PYTHONPATH set to the given folders, by default the project."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(map(str, beside or (PROJECT,)))}


def snakemake(
    folder: Path,
    *options: str,
    project: Path = PROJECT,
    anew: bool = False,
    server: int = 0,
    drawn: bool = True,
    first: str = "",
) -> subprocess.CompletedProcess:
    """Run ``compass run`` with options of Snakemake, including target files.

    Args:
        project: root of the project, possibly a copy.
        anew: start new Python processes for the command and its jobs, as for a copy.
        server: number of the process that is forked; each has its own hash seed.
        drawn: whether figures are drawn, which takes more than half of a small run; else each is an empty picture.
        first: code to execute first, in the process of the command, of which those of its jobs are forks.
    """
    words = ["run", f"{folder}", "--cores", "2", "--", *options]
    if anew or project != PROJECT:
        code = "import sys; from compasslib.cli import main; sys.exit(main())"
        whole, into = [sys.executable, "-P", "-c", code, *words], environment(project)
        return subprocess.run(whole, capture_output=True, text=True, check=False, env=into, cwd=folder)
    return compass(folder, *words, server=server, first=first if drawn else UNDRAWN + first)


def compass(
    folder: Path, *words: str, server: int = 0, first: str = "", merged: bool = False
) -> subprocess.CompletedProcess:
    """Run a command in a folder, in a fork of a process that has imported all modules; arguments: see ``snakemake``.

    Args:
        merged: whether standard error goes to standard output.
    """
    with tempfile.TemporaryDirectory() as there:
        files = [Path(there, name) for name in ("out", "out" if merged else "err")]
        asked = {"words": words, "folder": f"{folder}", "environment": environment(), "first": first}
        warm = _server(server)
        print(json.dumps(asked | {"files": [*map(str, files)]}), file=warm.stdin, flush=True)
        status = int(warm.stdout.readline())
        said = [file.read_text() for file in files]
        return subprocess.CompletedProcess(words, status, said[0], "" if merged else said[1])


def completed(folder: Path, *options: str, **how: Any) -> Path:
    """Run a cruise as ``snakemake`` does, check that it succeeds, and return its folder."""
    ran = snakemake(folder, *options, **how)
    assert ran.returncode == 0, ran.stderr[-4000:]
    return folder


@cache
def _server(number: int) -> subprocess.Popen:
    """Start the process of ``warm.py`` of a number, which ends with the tests."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    server = subprocess.Popen(
        [sys.executable, "-P", PROJECT / "tests/world/warm.py"], text=True, env=environment(), **pipes
    )
    atexit.register(server.communicate)
    return server


def planned(folder: Path, project: Path = PROJECT) -> set[tuple[str, str]]:
    """List (rule, mooring or calibration) of the jobs that would run now."""
    return jobs_in(snakemake(folder, "--dry-run", "--quiet", "progress", project=project).stdout)


def jobs_in(said: str) -> set[tuple[str, str]]:
    """List (rule, mooring, calibration or compass) of the jobs in Snakemake's messages, except the end of the run."""
    jobs = re.findall(r"^( *)(?:local)?(?:rule|checkpoint) (\w+):\n((?:\1    .*\n)+)", said, re.MULTILINE)
    of = {(rule, (re.search(r"(?:mooring|calibration|compass)=(\w+)", text) or ["", ""])[1]) for _, rule, text in jobs}
    return {job for job in of if job[0] not in ("all", "complete")}


def keeps_contract(folder: Path, *options: str) -> None:
    """Check the results of a cruise with the contract's own checker; skip the test if it is absent."""
    if not CONTRACT.exists():
        pytest.skip("no ../shared/tools")
    checked = subprocess.run([sys.executable, CONTRACT, folder, *options], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout


def change(path: Path, **keys: object) -> None:
    """Set keys of a YAML file; None deletes a key."""
    content = {key: value for key, value in (yaml.safe_load(path.read_text()) | keys).items() if value is not None}
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def copied_project(into: Path, *parts: str) -> Path:
    """Copy parts of the project, to be edited while other tests use the project itself."""
    for part in parts:
        if (PROJECT / part).is_dir():
            shutil.copytree(PROJECT / part, into / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (into / part).parent.mkdir(exist_ok=True)
            shutil.copy(PROJECT / part, into / part)
    return into


def hashes(folder: Path, *left_out: str) -> dict[str, str]:
    """Compute the SHA-256 of every file, except those below folders with one of the given names."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and not set(path.parts) & set(left_out)]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
