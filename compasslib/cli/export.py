"""``compass export``: write a product in the forms that other programs read, or a cruise as a crate."""

import io
import json
import shutil
import sys
import zipfile
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.archive import provenance, variables
from compasslib.archive.deposit import deposit
from compasslib.archive.files import CHUNK, atomic_write, open_netcdf, read_attribute, read_series, write_json
from compasslib.archive.netcdf import days_since_1950, seconds_since_1970
from compasslib.cli import results
from compasslib.config import cruise as config
from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.preparation.deployment import to_utc
from compasslib.readers.pd0.fields import Ensembles, rewrite
from compasslib.readers.times import DATENUM_1970
from compasslib.stages.settings import Moorings
from compasslib.types import Floats

ABOUT = (
    "Magnetic headings as in the original, with its heading bias EB and alignment EA, corrected. Velocities in earth "
    "coordinates, and bottom track, are turned alike; others are as they were. Ensembles outside the deployment or "
    "without a corrected heading: velocities -32768, heading 655.35 degrees."
)


def export(asked: Namespace) -> int:
    """Write the files of one format and print their names."""
    into = Path(asked.into or Path(asked.cruise) / "export")
    if asked.to == "rocrate":
        return _export_cruise(asked, into)
    if asked.mooring is None:
        advice = "write for example compass export EG4 --to csv"
        raise InputError("MOORING", expected=f"the name of a mooring with --to {asked.to}", found="none", advice=advice)
    product = "gridded.nc" if asked.to == "erddap" else "corrected.nc"
    folder = results.mooring_folder(asked.cruise, asked.mooring)
    source = folder / product
    if not source.is_file():
        parts = [f"{asked.mooring}/{path.parent.name}" for path in sorted(folder.glob(f"*/{product}"))]
        advice = f"write {' or '.join(parts)}" if parts else f"look why: compass explain {asked.mooring}"
        raise InputError(asked.mooring, expected=f"{product} among its results", found="none", advice=advice)
    if asked.to == "pd0":
        files = _export_pd0(asked, source, into)
    else:
        write, name = FORMATS[asked.to]
        place, root = folder.resolve(), (Path(asked.cruise) / "results").resolve()
        stem = "_".join(place.relative_to(root).parts) if place.is_relative_to(root) else place.name
        name = name.format(stem=stem, id=read_attribute(source, "id"))
        files = _available_files(into, *([name, f"{name}.json"] if asked.to == "csv" else [name]))
        write(source, *files)
    print(*files, sep="\n")
    return 0


def _export_cruise(asked: Namespace, into: Path) -> int:
    """Pack the whole cruise as a crate for deposit."""
    if asked.mooring is not None:
        expected, advice = "no mooring, as the crate is of the whole cruise", f"leave {asked.mooring} out"
        raise InputError("--to rocrate", expected=expected, found=asked.mooring, advice=advice)
    root = Path(asked.cruise).resolve()
    (file,) = _available_files(into, f"{root.name}.crate.zip")
    count = deposit(config.load_cruise(root), file)
    print(file)
    print(f"{count} files", file=sys.stderr)
    return 0


def _available_files(into: Path, *names: str) -> list[Path]:
    """Return the paths of files to write."""
    files = [into / name for name in names]
    if taken := next((item for item in files if item.exists()), None):
        advice = "name another folder with --into, or move that file away"
        raise InputError(str(taken), expected="a file that is not there yet", found="it there", advice=advice)
    return files


def _export_pd0(asked: Namespace, source: Path, into: Path) -> list[Path]:
    """Write each raw file with corrected headings, and a note on its origin and the changes made."""
    loaded, mooring = config.load_cruise(Path(asked.cruise)), asked.mooring
    if mooring not in loaded.moorings:
        expected = f"a mooring of the cruise ({', '.join(loaded.moorings) or 'it has none'})"
        raise InputError(mooring, expected=expected, found="another name", advice="write its name, and --cruise")
    rules, role = Moorings(loaded), loaded.moorings[mooring].compromised
    settings = rules.read(mooring, role)
    if (form := settings["form"]) != "pd0":
        raise InputError(f"{mooring}: {role}", "raw files in PD0", form, "export it to csv, mat or oceansites")
    raw, history = rules.raw_files(mooring, role), read_attribute(source, "history")
    hashes = {file: provenance.sha256(loaded.root / file) for file in raw}
    if other := next((file for file, known in hashes.items() if known not in history), None):
        actual, advice = "one that the results were not made from", "run the cruise again"
        raise InputError(other, expected=f"the raw file behind {source}", found=actual, advice=advice)
    alike = len({Path(file).name for file in raw}) < len(raw)  # numbered where two raw files have the same name
    names = [f"{f'{k}_' * alike}{Path(file).stem}_corrected{Path(file).suffix}" for k, file in enumerate(raw, 1)]
    stems = [f"{mooring}_{name}" for name in names]
    files = _available_files(into, *stems, *(f"{stem}.json" for stem in stems))
    headings, flagged = _Headings(source, settings), list[str]()
    with ExitStack() as whole:
        halves = [whole.enter_context(atomic_write(file)) for file in files]
        for file, half, note in zip(raw, halves, halves[len(raw) :], strict=False):
            became = rewrite(loaded.root / file, half, headings.turn)
            left_out = [{"from": s.offset, "to": s.offset + s.length - 1, "why": s.reason} for s in became.skipped]
            described = {
                "sha256": provenance.sha256(half),
                "original": {"file": file, "sha256": hashes[file]},
                "product": {"file": source.name, "sha256": provenance.sha256(source)},
                "software": provenance.software(),
                "date_created": provenance.date_created(),
                "about": ABOUT,
                "ensembles": {"corrected": became.corrected, "without_heading": became.flagged},
                "bytes_of_the_original_left_out": left_out,
            }
            write_json(note, described)
            if became.flagged:
                flagged.append(f"{file}: {became.flagged} ensembles have no corrected heading and were flagged")
        if lost := int(np.sum(np.isfinite(headings.corrected) & ~headings.found)):
            expected = f"an ensemble for each corrected heading of {source}"
            actual, advice = f"none for {lost}", "clock or reader settings have changed since: run the cruise again"
            raise InputError(", ".join(raw), expected=expected, found=actual, advice=advice)
    results.print_warnings(flagged)
    return files


class _Headings:
    """The headings of a product, looked up for the ensembles of its raw files."""

    def __init__(self, source: Path, settings: Mapping[str, Any]) -> None:
        """Read the headings; ``settings`` are those with which the raw files were read."""
        time, self.recorded, self.corrected = read_series(source, "TIME", "HEADING", "HEADING_CORRECTED")
        self.time_s, self.settings = seconds_since_1970(time), settings
        self.found = np.zeros(len(time), dtype=bool)  # whether a heading matches an ensemble

    def turn(self, leaders: Ensembles, *, same_s: float = 0.001, same_deg: float = 0.006) -> Floats:
        """Compute corrected minus recorded heading, degrees, (k,), of the sample with its time and heading."""
        if not len(self.time_s):
            return np.full(len(leaders.time_s), np.nan)
        reader, settled = self.settings["reader"], self.settings["deployment"]
        stated = parse_applied_declination(reader["declination_applied"])
        deployed = settled["start_s"], settled["end_s"]
        utc = to_utc(leaders.time_s, deployed, settled["clock_offset_seconds"], settled["clock_drift_seconds"])
        at = np.minimum(np.searchsorted(self.time_s, utc - same_s), len(self.time_s) - 1)
        bias = leaders.heading_bias_deg if stated is None else stated.heading
        magnetic = leaders.heading_deg - bias + (reader["heading_alignment"] or 0.0)
        with np.errstate(invalid="ignore"):
            same = np.abs(self.time_s[at] - utc) <= same_s
            same &= np.abs(angles.difference(self.recorded[at], magnetic)) <= same_deg
        self.found[at[same]] = True
        return np.where(same, angles.difference(self.corrected[at], self.recorded[at]), np.nan)


PREAMBLE = b"MATLAB 5.0 MAT-file, by compass export".ljust(116)  # scipy's contains the time of writing
CONSTANT_VARIABLES = ("LATITUDE", "LONGITUDE", "STATION")


def write_oceansites(source: Path, target: Path) -> None:
    """Copy corrected.nc, whose attribute ``id`` is its OceanSITES name."""
    with atomic_write(target) as temporary:
        shutil.copyfile(source, temporary)


def write_csv(source: Path, table: Path, sidecar: Path) -> None:
    """Write one row per sample and bin, with empty cells for missing values; units and meanings go to a JSON file."""
    with open_netcdf(source) as nc, atomic_write(table) as temporary:
        with temporary.open("w", encoding="utf-8", newline="") as stream:
            for k, rows in enumerate(_tables(nc)):
                rows.to_csv(stream, index=False, header=k == 0, float_format="%.7g", lineterminator="\n")
        write_json(sidecar, _csv_metadata(nc))


def write_parquet(source: Path, table: Path) -> None:
    """Write the rows of the CSV table as Parquet, times as UTC, and its description as metadata ``compasslib``."""
    arrow, parquet = _needed("pyarrow"), _needed("pyarrow.parquet")
    with open_netcdf(source) as nc, atomic_write(table) as temporary, ExitStack() as open_files:
        described = json.dumps(_csv_metadata(nc), default=lambda value: np.asarray(value).tolist())
        writer = None
        for rows in _tables(nc):
            times = rows["TIME"].str.rstrip("Z").astype("datetime64[ms]").dt.tz_localize("UTC")
            piece = arrow.Table.from_pandas(rows.assign(TIME=times), preserve_index=False)
            piece = piece.replace_schema_metadata({"compasslib": described})
            writer = writer or open_files.enter_context(parquet.ParquetWriter(temporary, piece.schema))
            writer.write_table(piece)


def write_zarr(source: Path, target: Path) -> None:
    """Write corrected.nc with its own names as Zarr 2, which has texts of fixed length, packed as one ZIP."""
    # Packed at the end: in a store that is a ZIP, each later version of the metadata is a further entry.
    data, storage = _needed("xarray").load_dataset(source), _needed("zarr.storage")
    written: dict[str, Any] = {}
    data.to_zarr(storage.MemoryStore(written), zarr_format=2)
    with atomic_write(target) as temporary, zipfile.ZipFile(temporary, "w") as packed:
        for name in sorted(written):
            packed.writestr(zipfile.ZipInfo(name), written[name].to_bytes())


def write_erddap(source: Path, target: Path) -> None:
    """Write the variables of gridded.nc by time and depth alone: one set of axes, as ERDDAP's grids have."""
    data = _needed("xarray").load_dataset(source, decode_times=False)
    grid = data.drop_dims(["MODE", "SOURCES", "AFFECTED"], errors="ignore")
    other = [name for name, values in grid.data_vars.items() if values.dims not in ((), ("TIME", "DEPTH"))]
    grid = grid.drop_vars([*(name for name in other if not str(name).endswith("_bnds")), "STATION"])
    for name in ("featureType", "cdm_timeseries_variables", "cdm_profile_variables"):  # of the stations left out
        grid.attrs.pop(name, None)
    grid.attrs["cdm_data_type"] = "Grid"
    for name, values in grid.variables.items():
        if kept := [other for other in str(values.attrs.pop("ancillary_variables", "")).split() if other in grid]:
            values.attrs["ancillary_variables"] = " ".join(kept)
        values.encoding.setdefault("_FillValue", None)  # none on coordinates
        if str(name).endswith("_bnds"):
            values.encoding["coordinates"] = None
    with atomic_write(target) as temporary:
        grid.to_netcdf(temporary, format="NETCDF4_CLASSIC")


def write_mat(source: Path, target: Path) -> None:
    """Write MATLAB structures: data, units, long_name and global attributes; missing values are NaN."""
    from scipy.io import savemat

    with open_netcdf(source) as nc:
        data = {name: _filled_values(nc, name) for name in nc.variables}
        data["DATENUM"] = np.asarray(data["TIME"]) + (DATENUM_1970 - days_since_1950(np.zeros(1)))
        labels = {
            key: {n: str(getattr(v, key, "1")) for n, v in nc.variables.items()} for key in ("units", "long_name")
        }
        labels["units"]["DATENUM"], labels["long_name"]["DATENUM"] = "days", "TIME as MATLAB's datenum, UTC"
        attributes = {name: nc.getncattr(name) for name in nc.ncattrs()}
    stream = io.BytesIO()
    everything = {"data": data, **labels, "attributes": attributes}
    savemat(stream, everything, long_field_names=True, do_compression=True, oned_as="column")
    with atomic_write(target) as temporary:
        temporary.write_bytes(PREAMBLE + stream.getvalue()[len(PREAMBLE) :])


# Function and file name of each format.
FORMATS: dict[str, tuple[Callable[..., None], str]] = {
    "csv": (write_csv, "{stem}.csv"),
    "mat": (write_mat, "{stem}.mat"),
    "parquet": (write_parquet, "{stem}.parquet"),
    "zarr": (write_zarr, "{stem}.zarr.zip"),
    "oceansites": (write_oceansites, "{id}.nc"),
    "erddap": (write_erddap, "{stem}_gridded.nc"),
}


def _needed(module: str) -> Any:
    """Import a module of an optional package; raise InputError with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        package, actual = module.partition(".")[0], "it is not installed"
        raise InputError("--to", f"the package {package}", actual, f"pip install {package}") from error


def _tables(nc: netCDF4.Dataset) -> Iterator[Any]:
    """Yield the rows of the table, one per sample and bin, in pieces."""
    import pandas as pd  # takes 0.4 s

    for begin in range(0, max(len(nc.dimensions["TIME"]), 1), CHUNK):
        yield pd.DataFrame(dict(_csv_columns(nc, slice(begin, begin + CHUNK))))


def _csv_columns(nc: netCDF4.Dataset, samples: slice) -> Iterator[tuple[str, Any]]:
    """Yield the columns of some samples, with one value per sample and bin."""
    bins = len(nc.dimensions["BIN"])
    time = np.rint(1000.0 * seconds_since_1970(nc["TIME"][samples])).astype("datetime64[ms]")
    yield "TIME", np.repeat(np.char.add(np.datetime_as_string(time, unit="ms"), "Z"), bins)
    yield "BIN", np.tile(nc["BIN"][:], len(time))
    for name, variable in nc.variables.items():
        if variable.dimensions == variables.SERIES and name != "TIME":
            yield name, np.repeat(_filled_values(nc, name, samples), bins)
        elif variable.dimensions == variables.BINS:
            yield name, _filled_values(nc, name, samples).ravel()
        elif variable.dimensions == variables.BEAMS:
            each = _filled_values(nc, name, (slice(None), samples))
            yield from ((f"{name}_{beam}", item.ravel()) for beam, item in zip(nc["BEAM"][:], each, strict=True))


def _filled_values(nc: netCDF4.Dataset, name: str, which: Any = ...) -> Any:
    """Read a variable: numbers with NaN where missing, flags unchanged, characters as text."""
    values: NDArray[Any] = np.asarray(nc[name][which])
    if values.dtype.kind == "S":
        return values.tobytes().decode()
    fill = getattr(nc[name], "_FillValue", None)
    if fill is None:
        return values
    known = values if values.dtype.kind == "f" else values.astype(np.float32)
    return np.where(values == fill, known.dtype.type(np.nan), known)


def _csv_metadata(nc: netCDF4.Dataset) -> dict[str, Any]:
    """Collect the metadata: units and meanings by column, constants and global attributes."""
    meanings = {
        name: {key: variable.getncattr(key) for key in variable.ncattrs() if key[0] != "_"}
        for name, variable in nc.variables.items()
        if name not in (*CONSTANT_VARIABLES, "BEAM")
    }
    meanings["TIME"]["units"] = "ISO 8601, UTC"
    return {
        "rows": "a row a sample and bin; empty: missing; NAME_1, NAME_2 ...: by beam",
        "columns": meanings,
        "for_all_rows": {name: _filled_values(nc, name) for name in CONSTANT_VARIABLES},
        "attributes": {name: nc.getncattr(name) for name in nc.ncattrs()},
    }
