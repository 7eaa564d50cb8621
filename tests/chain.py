"""The chain of a cruise without Snakemake: the library's own stages in this process, into the workflow's folder."""

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
    """Return what the chain says of a mooring: its row of the summary, its files, or ``error``, the one line.

    Unlike ``process_mooring`` it writes where the workflow does, over what stands there, and leaves what it wrote.

    Args:
        folder: the cruise.
        name: the mooring.
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
    """Make files of a mooring's results, corrected.nc if none is named, with what they need, and return their folder.

    Neither the forms of the curve are compared nor velocities gridded, which ``process_mooring`` does besides.
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
