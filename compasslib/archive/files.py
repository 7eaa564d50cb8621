"""Input and output of JSON, CSV and netCDF files, each complete or absent, with the same bytes for the same data.

Reading raises InputError where a file is missing, damaged or of another kind, and Unusable where it has the reason why
there are no data; writing raises TransientError where a file cannot be written.
"""

import base64
import contextlib
import csv
import io
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from compasslib.archive.variables import BEAM, BIN, FILL, Variable, quality_variable
from compasslib.errors import InputError, TransientError, Unusable
from compasslib.records import pieces

RERUN = "run the cruise again, or restore it from a copy"  # advice on a result that cannot be read
HALF_WRITTEN = ".compasslib-part"  # suffix of a file being written, which no other program uses
STOPPED = "stopped"  # attribute or key of a file that holds a reason in place of data
SIGNIFICANT_DIGITS = 10  # of floats in JSON
CHUNK = 4096  # samples per chunk of a netCDF variable
CACHE_BYTES = 4 * 2**20  # chunk cache of each variable; the library's default of 64 MB adds up over variables


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, which replaces the file once the block has succeeded."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}{HALF_WRITTEN}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # netCDF raises RuntimeError on a full disk
        reason = getattr(error, "strerror", None) or str(error)
        advice = "free some space or correct the permissions, and run again"
        expected = "room and the right to write it"
        raise TransientError(str(path), expected=expected, found=reason, advice=advice) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_json(path: str | Path, data: object) -> None:
    """Write JSON with keys in the given order, floats to ten significant digits and non-finite numbers as null."""
    text = json.dumps(_jsonable(data), indent=1, ensure_ascii=False, allow_nan=False)
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Read a JSON file."""
    try:
        page = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise _damaged(path, "a JSON file", error) from error
    if isinstance(page, dict) and page.get(STOPPED):  # null in the job records of earlier versions
        raise Unusable(page[STOPPED])
    return page


def _jsonable(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.bool_, np.integer)):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_jsonable(item) for item in value]
    if isinstance(value, (float, np.floating)):
        rounded = float(f"{float(value):.{SIGNIFICANT_DIGITS}g}")
        return rounded if math.isfinite(rounded) else None
    return str(value) if isinstance(value, Path) else value


def _damaged(path: str | Path, expected: str, error: Exception) -> InputError:
    return TransientError(str(path), expected=expected, found=f"{type(error).__name__}: {error}", advice=RERUN)


def write_csv(
    path: str | Path, names: Sequence[str], columns: Sequence[Sequence[Any] | NDArray[Any]], forms: Sequence[str]
) -> None:
    """Write columns of texts, or of numbers by formats such as ``{:.3f}``, as CSV; non-finite numbers become empty."""
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        for row in zip(*columns, strict=True):
            cells = zip(row, forms, strict=True)
            writer.writerow([x if isinstance(x, str) else f.format(x) if np.isfinite(x) else "" for x, f in cells])


def read_csv(path: str | Path, texts: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """Read the columns of a table written by ``write_csv``, NaN where a number is missing."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as stream:
            names, *rows = list(csv.reader(stream)) or [[]]
        cells = {name: [row[k] for row in rows] for k, name in enumerate(names)}
        return {
            name: np.array(column if name in texts else [float(cell or "nan") for cell in column])
            for name, column in cells.items()
        }
    except (OSError, ValueError, IndexError) as error:
        raise _damaged(path, "a table that this program wrote", error) from error


@contextmanager
def create_netcdf(
    path: str | Path, form: Literal["NETCDF4", "NETCDF4_CLASSIC"] = "NETCDF4"
) -> Iterator[netCDF4.Dataset]:
    """Yield a new netCDF dataset, which becomes the file at the path once the block has succeeded."""
    with atomic_write(path) as temporary, netCDF4.Dataset(temporary, "w", format=form) as nc:
        yield nc


@contextmanager
def open_netcdf(path: str | Path) -> Iterator[netCDF4.Dataset]:
    """Open a netCDF file of the results; InputError also covers what the block reads and the file lacks."""
    try:
        with netCDF4.Dataset(path) as nc:
            nc.set_auto_mask(False)
            if STOPPED in nc.ncattrs():
                raise Unusable(json.loads(nc.getncattr(STOPPED)))
            yield nc
    except (OSError, RuntimeError, LookupError, AttributeError, ValueError) as error:
        # An error of the file, not of the code that reads it; a missing variable or attribute is known by its words.
        of_file = isinstance(error, (OSError, RuntimeError, UnicodeDecodeError, json.JSONDecodeError))
        of_file |= isinstance(error, IndexError) and " not found in " in str(error)
        of_file |= isinstance(error, AttributeError) and str(error).startswith("NetCDF: ")
        if not of_file:
            raise
        raise _damaged(path, "a whole netCDF file that this program wrote", error) from error


def write_reason(path: str | Path, reason: Mapping[str, Any]) -> None:
    """Write the reason why there are no data, in place of them: to netCDF or JSON; another file stays empty."""
    if str(path).endswith(".nc"):
        with create_netcdf(path) as nc:
            nc.setncattr(STOPPED, json.dumps(dict(reason)))
    elif str(path).endswith(".json"):
        write_json(path, {STOPPED: dict(reason)})
    else:
        with atomic_write(path) as temporary:
            temporary.touch()


def read_reason(path: str | Path) -> dict[str, Any] | None:
    """Read the reason why a JSON file has no data, None where it has them; raises InputError as ``read_json``."""
    try:
        read_json(path)
    except Unusable as error:
        return error.reason
    return None


def write_variable(
    nc: netCDF4.Dataset,
    variable: Variable,
    values: ArrayLike,
    flags: NDArray[np.int8] | None = None,
    *,
    level: Literal[0, 1, 4] = 1,
    rows: slice | None = None,
    also: Mapping[str, object] | None = None,
) -> None:
    """Write a variable or a piece of it, with non-finite values as its fill value, and its quality flags if it has any.

    Args:
        level: zlib compression level; 0 for none.
        rows: the piece along TIME; None for the whole variable.
        also: attributes that the table of variables does not have.
    """
    values = np.asarray(values)
    if variable.fill is not None and values.dtype.kind == "f":  # integers are finite, and unsigned ones cannot hold -1
        dtype = np.dtype(variable.dtype)  # converted before it is filled: a float32 copy takes half the memory
        values = values.astype(dtype if dtype.kind == "f" else values.dtype)
        values[~np.isfinite(values)] = variable.fill
    if variable.name not in nc.variables:
        chunks = tuple(min(max(len(nc.dimensions[name]), 1), CHUNK) for name in variable.dimensions)
        made = nc.createVariable(
            variable.name,
            variable.dtype,
            variable.dimensions,
            zlib=bool(chunks) and level > 0,
            complevel=level,
            chunksizes=chunks or None,
            fill_value=variable.fill,
            chunk_cache=CACHE_BYTES,
        )
        quality = () if flags is None else (f"{variable.name}_QC",)
        made.setncatts({**replace(variable, ancillary=(*quality, *variable.ancillary)).attributes(), **(also or {})})
    place = ... if rows is None else tuple(rows if name == "TIME" else slice(None) for name in variable.dimensions)
    nc[variable.name][place] = values
    if flags is not None:
        write_variable(nc, quality_variable(variable), flags, level=level, rows=rows)


def write_bins(nc: netCDF4.Dataset, bins: int, beams: int, looks_up: bool) -> None:
    """Write the numbers of bins, which count upwards if the instrument looks up, and of beams, if there are any."""
    nc.createDimension("BIN", bins)
    write_variable(nc, BIN, np.arange(1, bins + 1), also={"positive": "up" if looks_up else "down"})
    if beams:
        nc.createDimension("BEAM", beams)
        write_variable(nc, BEAM, np.arange(1, beams + 1))


@dataclass(frozen=True)
class StoredVariable:
    """A variable of a netCDF file whose rows are read on access."""

    path: str
    name: str
    shape: tuple[int, ...]

    @property
    def ndim(self) -> int:
        return len(self.shape)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)

    def __getitem__(self, which: slice | NDArray[np.intp], /) -> NDArray[Any]:
        """Read rows as by ``read_variable``, with beams along the last axis."""
        with open_netcdf(self.path) as nc:
            if self.ndim == 3:
                return np.moveaxis(np.asarray(nc[self.name][:, which]), 0, 2)
            if isinstance(which, slice):
                return read_variable(nc, self.name, which)
            values = np.empty((len(which), *self.shape[1:]), read_variable(nc, self.name, slice(0)).dtype)
            for rows in pieces(self.shape[0]):  # the netCDF library reads single rows one by one
                inside = (which >= rows.start) & (which < rows.stop)
                values[inside] = read_variable(nc, self.name, rows)[which[inside] - rows.start]
            return values


def read_variable(nc: netCDF4.Dataset, name: str, rows: slice | None = None, bins: slice | None = None) -> NDArray[Any]:
    """Read some rows and bins of a variable: floats as float64 with NaN where missing, others unchanged."""
    place = (rows or slice(None), bins) if bins is not None and nc[name].ndim == 2 else rows or ...
    stored = np.asarray(nc[name][place])
    if stored.dtype.kind != "f":
        return stored
    values = stored.astype(float)
    values[stored == FILL] = np.nan
    return values


def read_series(path: str | Path, *names: str) -> list[NDArray[Any]]:
    """Read variables of a netCDF file as by ``read_variable``."""
    with open_netcdf(path) as nc:
        return [read_variable(nc, name) for name in names]


def read_attribute(path: str | Path, name: str) -> str:
    """Read one global attribute of a netCDF file as text."""
    with open_netcdf(path) as nc:
        return str(nc.getncattr(name))


# Figures as data URIs with a palette, for HTML pages; written by the job that draws the figures.

PICTURES = ("work/pictures.json", "work/sections.json")  # in the folder of a mooring's results
Picture = tuple[str, tuple[int, int]]  # data URI; width and height, pixels


def embed_png(path: str | Path) -> Picture:
    """Encode a PNG as a data URI with a reduced palette, reproducibly, and return it with its size."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            whole = image.convert("RGB")
    except (OSError, SyntaxError, ValueError) as error:
        raise _damaged(path, "a whole PNG", error) from error
    # 200 of the 300 dots per inch of a figure are still twice what a screen shows.
    reduced = whole.resize((2 * whole.width // 3, 2 * whole.height // 3), Image.Resampling.BOX)
    # A palette takes a third of the bytes, without a visible difference.
    reduced = reduced.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    reduced.save(buffer, "PNG", compress_level=6)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}", reduced.size


def read_pictures(folder: Path) -> dict[str, Picture]:
    """Read the data URIs of a mooring's figures by name; empty where none were written."""
    made = [read_json(path) for name in PICTURES if (path := folder / name).exists()]
    return {name: (uri, (width, height)) for each in made for name, (uri, (width, height)) in each.items()}
