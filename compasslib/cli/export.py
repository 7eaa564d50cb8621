"""``compass export``: write a product in the forms that other programs read, or a cruise as a crate."""

from __future__ import annotations

import io
import json
import shutil
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.archive import provenance, variables
from compasslib.archive.attributes import SENSOR_KEYS
from compasslib.archive.deposit import OPTIONAL, deposit
from compasslib.archive.files import CHUNK, atomic_write, open_netcdf, read_attribute, read_series, write_json
from compasslib.archive.netcdf import days_since_1950, seconds_since_1970
from compasslib.cli import results
from compasslib.config import cruise as config
from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.preparation.deployment import to_utc
from compasslib.readers.pd0.fields import Ensembles, Rewritten, rewrite
from compasslib.readers.times import DATENUM_1970
from compasslib.records import PROBABLY_BAD
from compasslib.stages.settings import Moorings
from compasslib.types import Floats

HEADINGS = (
    "Magnetic, as in the original: HEADING_CORRECTED, with the heading bias EB and the alignment EA that the original "
    "holds. Read with the mooring's YAML file, or with any reader that knows EB, they are HEADING_CORRECTED."
)
VELOCITIES = (
    "In earth coordinates turned clockwise by DEVIATION as the heading, bottom track included; along beams, in the "
    "instrument's axes and in the ship's as they were. No velocity is flagged but by its heading."
)
WITHOUT = "Ensembles outside the deployment or without a corrected heading: velocities -32768, heading 655.35 degrees."


def export(asked: Namespace) -> int:
    """Write the files of one format and print their names.

    Raises:
        InputError: there are no results, a file already exists, or the raw files are not those of the results.
    """
    if asked.to == "rocrate":
        return _export_cruise(asked)
    if asked.mooring is None:
        advice = "write for example compass export EG4 --to csv"
        raise InputError("MOORING", expected=f"the name of a mooring with --to {asked.to}", found="none", advice=advice)
    product = "gridded.nc" if asked.to == "erddap" else "corrected.nc"
    source = results.mooring_folder(asked.cruise, asked.mooring) / product
    into = Path(asked.into or Path(asked.cruise) / "export")
    if asked.to == "pd0":
        files = _export_pd0(asked, source, into)
    else:
        stem = source.parent.resolve().name
        names = {
            "oceansites": f"{read_attribute(source, 'id')}.nc",
            "erddap": f"{stem}_gridded.nc",
            "zarr": f"{stem}.zarr.zip",
        }
        files = _available_files(into, names.get(asked.to, f"{stem}.{asked.to}"))
        files += [_note_path(files[0])] if asked.to == "csv" else []
        forms: dict[str, Callable[..., None]] = {"csv": write_csv, "mat": write_mat, "oceansites": write_oceansites}
        forms |= {"erddap": write_erddap, "parquet": write_parquet, "zarr": write_zarr}
        forms[asked.to](source, *files)
    print(*files, sep="\n")
    return 0


def _export_cruise(asked: Namespace) -> int:
    """Pack the whole cruise as a crate for deposit."""
    if asked.mooring is not None:
        expected, advice = "no mooring, as the crate is of the whole cruise", f"leave {asked.mooring} out"
        raise InputError("--to rocrate", expected=expected, found=asked.mooring, advice=advice)
    root = Path(asked.cruise).resolve()
    (file,) = _available_files(Path(asked.into or Path(asked.cruise) / "export"), f"{root.name}.crate.zip")
    loaded = config.load_cruise(root)
    count, attributes = deposit(loaded, file), loaded.options.attributes
    print(file)
    absent = [f"  {key}: {what}" for key, what in OPTIONAL.items() if key not in attributes]
    products = {name: root / "results" / name / "corrected.nc" for name in loaded.moorings}
    for name in (name for name, product in products.items() if product.is_file()):
        with open_netcdf(products[name]) as nc:
            keys = [key for key in SENSOR_KEYS if f"sensor_{key}" not in nc["HEADING"].ncattrs()]
        absent += [f"  {', '.join(keys)}: of {name}'s instrument {loaded.moorings[name].compromised}"] if keys else []
    print(
        f"{count} files",
        *(["attributes that only the owner can give, not given:"] if absent else []),
        *absent,
        sep="\n",
        file=sys.stderr,
    )
    return 0


def _available_files(into: Path, *names: str) -> list[Path]:
    """Return the paths of files to write.

    Raises:
        InputError: one of the files exists.
    """
    files = [into / name for name in names]
    if taken := next((item for item in files if item.exists()), None):
        advice = "name another folder with --into, or move that file away"
        raise InputError(str(taken), expected="a file that is not there yet", found="it there", advice=advice)
    return files


def _note_path(file: Path) -> Path:
    return file.with_name(f"{file.name}.json")


def _export_pd0(asked: Namespace, source: Path, into: Path) -> list[Path]:
    """Write each raw file with corrected headings, and a note on its origin and the changes made."""
    loaded = config.load_cruise(Path(asked.cruise))
    product = _Product(asked.mooring, source, Moorings(loaded))
    paths = [Path(file) for file in product.files]
    alike = len({path.name for path in paths}) < len(paths)  # numbered where two raw files have the same name
    numbered = [(f"{k}_" if alike else "", path) for k, path in enumerate(paths, 1)]
    files = _available_files(into, *(f"{asked.mooring}_{k}{x.stem}_corrected{x.suffix}" for k, x in numbered))
    targets = [*files, *map(_note_path, files)]
    flagged: list[str] = []
    with ExitStack() as whole:
        halves = [whole.enter_context(atomic_write(file)) for file in targets]
        for file, half, note_file in zip(product.files, halves, halves[len(files) :], strict=False):
            became = rewrite(loaded.root / file, half, product.turn)
            write_json(note_file, product.note(file, became, half))
            if became.flagged:
                flagged.append(f"{file}: {became.flagged} ensembles have no corrected heading and were flagged")
        product.refuse_missing()
    results.print_warnings(flagged)
    return targets


class _Product:
    """The corrected headings of one mooring, looked up for the ensembles of its raw files."""

    def __init__(self, mooring: str, source: Path, rules: Moorings) -> None:
        """Read the headings.

        Raises:
            InputError: the mooring is not in the cruise, or its raw files are not PD0 or not those of the results.
        """
        if mooring not in rules.cruise.moorings:
            expected = f"a mooring of the cruise ({', '.join(rules.cruise.moorings) or 'it has none'})"
            raise InputError(mooring, expected=expected, found="another name", advice="write its name, and --cruise")
        role = rules.mooring(mooring).compromised
        settings = rules.read(mooring, role)
        if (form := settings["form"]) != "pd0":
            where, advice = f"{mooring}: {role}", "export it to csv, mat or oceansites"
            raise InputError(where, expected="raw files in PD0", found=form, advice=advice)
        self.mooring, self.source, self.files = mooring, source, rules.raw_files(mooring, role)
        self._reader, self._deployment = settings["reader"], settings["deployment"]
        names = ("TIME", "HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_QC")
        time, self._recorded, self._corrected, self._flag = read_series(source, *names)
        self._time_s = seconds_since_1970(time)
        self._found = np.zeros(len(time), dtype=bool)
        self._hashes = {file: provenance.sha256(rules.cruise.root / file) for file in self.files}
        history = read_attribute(source, "history")
        if other := next((file for file, known in self._hashes.items() if known not in history), None):
            actual, advice = "one that the results were not made from", "run the cruise again"
            raise InputError(other, expected=f"the raw file behind {source}", found=actual, advice=advice)

    def turn(self, leaders: Ensembles, *, same_s: float = 0.001, same_deg: float = 0.006) -> Floats:
        """Compute corrected minus recorded heading of each ensemble, NaN where there is none, (k,) degrees.

        An ensemble has the heading of the sample whose time and recorded heading are the same but for rounding.
        """
        if not len(self._time_s):
            return np.full(len(leaders.time_s), np.nan)
        settled, stated = self._deployment, parse_applied_declination(self._reader["declination_applied"])
        deployed = settled["start_s"], settled["end_s"]
        utc = to_utc(leaders.time_s, deployed, settled["clock_offset_seconds"], settled["clock_drift_seconds"])
        at = np.minimum(np.searchsorted(self._time_s, utc - same_s), len(self._time_s) - 1)
        bias = leaders.heading_bias_deg if stated is None else stated.heading
        magnetic = leaders.heading_deg - bias + (self._reader["heading_alignment"] or 0.0)
        with np.errstate(invalid="ignore"):
            same = np.abs(self._time_s[at] - utc) <= same_s
            same &= np.abs(angles.difference(self._recorded[at], magnetic)) <= same_deg
        self._found[at[same]] = True
        return np.where(same, angles.difference(self._corrected[at], self._recorded[at]), np.nan)

    def refuse_missing(self) -> None:
        """Raise InputError if some corrected headings match no ensemble."""
        if lost := int(np.sum(np.isfinite(self._corrected) & ~self._found)):
            expected = f"an ensemble for each corrected heading of {self.source}"
            actual, advice = f"none for {lost}", "clock or reader settings have changed since: run the cruise again"
            raise InputError(", ".join(self.files), expected=expected, found=actual, advice=advice)

    def note(self, file: str, became: Rewritten, written: Path) -> dict[str, Any]:
        """Compose the note on a file written from a raw file."""
        left_out = [{"from": s.offset, "to": s.offset + s.length - 1, "why": s.reason} for s in became.skipped]
        doubtful = int(np.sum(np.isfinite(self._corrected) & (self._flag == PROBABLY_BAD)))
        return {
            "mooring": self.mooring,
            "sha256": provenance.sha256(written),
            "original": {"file": file, "sha256": self._hashes[file]},
            "product": {"file": self.source.name, "sha256": provenance.sha256(self.source)},
            "software": provenance.software(),
            "date_created": provenance.date_created(),
            "headings": HEADINGS,
            "velocities": VELOCITIES,
            "without_heading": WITHOUT,
            "ensembles": {"corrected": became.corrected, "without_heading": became.flagged},
            "doubtful_headings_of_the_mooring": doubtful,
            "bytes_of_the_original_left_out": left_out,
        }


# The formats.

CSV_FORMAT = "%.7g"  # the precision of float32
PREAMBLE = b"MATLAB 5.0 MAT-file, by compass export".ljust(116)  # scipy's contains the time of writing
CONSTANT_VARIABLES = ("LATITUDE", "LONGITUDE", variables.STATION.name, variables.BIN.name, variables.BEAM.name)


def write_oceansites(source: Path, target: Path) -> None:
    """Copy corrected.nc, whose attribute ``id`` is its OceanSITES name."""
    with atomic_write(target) as temporary:
        shutil.copyfile(source, temporary)


def write_csv(source: Path, table: Path, sidecar: Path) -> None:
    """Write one row per sample and bin, with empty cells for missing values; units and meanings go to a JSON file.

    Raises:
        InputError: the file is missing or damaged.
    """
    with open_netcdf(source) as nc, atomic_write(table) as temporary:
        with temporary.open("w", encoding="utf-8", newline="") as stream:
            for k, rows in enumerate(_tables(nc)):
                rows.to_csv(stream, index=False, header=k == 0, float_format=CSV_FORMAT, lineterminator="\n")
        write_json(sidecar, _csv_metadata(nc))


def write_parquet(source: Path, table: Path) -> None:
    """Write the rows of the CSV table as Parquet, times as UTC, and its description as metadata ``compasslib``.

    Raises:
        InputError: the file is missing or damaged, or pyarrow is not installed.
    """
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
    """Write corrected.nc with its own names as Zarr, packed as one ZIP.

    Raises:
        InputError: the file is missing or damaged, or xarray or zarr is not installed.
    """
    data, storage = _needed("xarray").load_dataset(source), _needed("zarr.storage")
    with atomic_write(target) as temporary, storage.ZipStore(temporary, mode="w") as store:
        data.to_zarr(store)


def write_erddap(source: Path, target: Path) -> None:
    """Write the variables of gridded.nc by time and depth alone: one set of axes, as ERDDAP's grids have.

    Raises:
        InputError: the file is missing or damaged, or xarray is not installed.
    """
    data = _needed("xarray").load_dataset(source, decode_times=False)
    grid = data.drop_dims(["MODE", "SOURCES", "AFFECTED"], errors="ignore")
    other = [name for name, values in grid.data_vars.items() if values.dims not in ((), ("TIME", "DEPTH"))]
    grid = grid.drop_vars([*(name for name in other if not str(name).endswith("_bnds")), "STATION"])
    for values in grid.data_vars.values():
        named = str(values.attrs.get("ancillary_variables", "")).split()
        values.attrs["ancillary_variables"] = " ".join(name for name in named if name in grid)
    with atomic_write(target) as temporary:
        grid.to_netcdf(temporary, format="NETCDF4_CLASSIC")


def _needed(module: str) -> Any:
    """Import a module of an optional package; raise InputError with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        advice = f"pip install {package}"
        raise InputError(
            "--to", expected=f"the package {package}", found="it is not installed", advice=advice
        ) from error


def _tables(nc: netCDF4.Dataset) -> Iterator[Any]:
    """Yield the rows of the table, one per sample and bin, in pieces."""
    import pandas as pd  # takes 0.4 s

    for begin in range(0, max(len(nc.dimensions["TIME"]), 1), CHUNK):
        yield pd.DataFrame(dict(_csv_columns(nc, slice(begin, begin + CHUNK))))


def write_mat(source: Path, target: Path) -> None:
    """Write MATLAB structures: data, units, long_name and global attributes; missing values are NaN.

    Raises:
        InputError: the file is missing or damaged.
    """
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
    columns = {
        name: variable for name, variable in nc.variables.items() if name not in CONSTANT_VARIABLES or name == "BIN"
    }
    meanings = {name: {key: getattr(v, key) for key in v.ncattrs() if key[0] != "_"} for name, v in columns.items()}
    meanings["TIME"] |= {"units": "ISO 8601, UTC"}
    return {
        "rows": "a row a sample and bin; empty: missing; NAME_1, NAME_2 ...: by beam",
        "columns": meanings,
        "for_all_rows": {name: _filled_values(nc, name) for name in CONSTANT_VARIABLES[:3]},
        "attributes": {name: nc.getncattr(name) for name in nc.ncattrs()},
    }
