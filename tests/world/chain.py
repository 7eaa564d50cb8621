"""Process a mooring of a cruise without Snakemake, in this process, into the workflow's results folder."""

from contextlib import chdir
from pathlib import Path
from typing import Any

from compasslib.archive import netcdf, summary
from compasslib.archive.files import read_json
from compasslib.config.cruise import load_cruise
from compasslib.errors import InputError
from compasslib.pipeline.process import process


def run(folder: Path, name: str = "M1") -> dict[str, Any]:
    """Process a mooring and return its summary row and results, or ``error`` with the one-line message.

    Unlike ``process_mooring``, it writes into the workflow's folder, replaces files and keeps incomplete results.
    """
    results = folder.absolute() / "results" / name
    try:
        with chdir(folder):
            process(load_cruise(Path()), name, results)
        return _results(results) | {"error": None}
    except InputError as error:
        return {"error": f"error: {error}"}


def make(folder: Path, name: str, into: Path, *, gridded: bool = False) -> Path:
    """Process a mooring as far as corrected.nc, or as gridded.nc, and return the folder of its results."""
    into = into.absolute()
    with chdir(folder):
        process(load_cruise(Path()), name, into, gridded=gridded)
    return into


def _results(results: Path) -> dict[str, Any]:
    records = {path.stem: netcdf.read_record(path) for path in sorted((results / "work").glob("*.nc"))}
    return {
        **summary.summary_row(results.name, results),
        "records": records,
        "counts": {role: record.counts for role, record in records.items()},
        "product": netcdf.read_corrected(results / "corrected.nc"),
        "fit": read_json(results / "deviation.json"),
        "diagnosis": read_json(results / "diagnosis.json"),
    }
