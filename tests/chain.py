"""Run the stages of a cruise without Snakemake, in this process, into the workflow's results folder."""

from __future__ import annotations

from contextlib import chdir
from pathlib import Path
from typing import Any

from compasslib.archive import netcdf, summary
from compasslib.archive.files import read_json
from compasslib.config import cruise
from compasslib.errors import InputError
from compasslib.pipeline.process import run_stages


def run(folder: Path, name: str = "M1") -> dict[str, Any]:
    """Run a mooring's stages and return its summary row and results, or ``error`` with the one-line message.

    Unlike ``process_mooring``, it writes into the workflow's folder, replaces files and keeps incomplete results.

    Args:
        folder: cruise folder.
        name: name of the mooring.
    """
    results = folder.absolute() / "results" / name
    results.mkdir(parents=True, exist_ok=True)
    try:
        with chdir(folder):
            run_stages(cruise.load_cruise(Path()), name, results)
        return _told(results) | {"error": None}
    except InputError as error:
        return {"error": f"error: {error}"}


def make(folder: Path, name: str, into: Path, *files: str) -> Path:
    """Run the stages needed for some results of a mooring, by default corrected.nc, and return their folder.

    Unlike ``process_mooring``, it compares no forms of the deviation curve and grids no velocities unless required.
    """
    into.mkdir(parents=True, exist_ok=True)
    with chdir(folder):
        run_stages(cruise.load_cruise(Path()), name, into, last=files or ("corrected.nc",))
    return into


def _told(results: Path) -> dict[str, Any]:
    records = {path.stem: netcdf.read_record(path) for path in sorted((results / "work").glob("*.nc"))}
    return {
        **summary.summary_row(results.name, results),
        "records": records,
        "counts": {role: record.counts for role, record in records.items()},
        "product": netcdf.read_corrected(results / "corrected.nc"),
        "fit": read_json(results / "deviation.json"),
        "diagnosis": read_json(results / "diagnosis.json"),
    }
