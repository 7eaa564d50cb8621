"""Files of the archive, JSON and netCDF: each appears whole or not at all, and the same data give the same bytes."""

from __future__ import annotations

import base64
import contextlib
import csv
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib.archive.variables import BEAM, BIN, FILL, Variable
from compasslib.errors import InputError, TransientError

RERUN = "run the cruise again, or restore it from a copy"  # a result that cannot be read
HALF_WRITTEN = ".compasslib-part"  # ends the name of a file that is being written; nobody else names one so
SIGNIFICANT_DIGITS = 10  # of floats in JSON
CHUNK = 4096  # samples
CACHE_BYTES = 4 * 2**20  # of chunks a variable that wait to be compressed; the library's own 64 MB add up


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary name beside a file that takes the file's place once the block has ended well.

    Args:
        path: the file to write; its folder is made where absent. A block that fails leaves an older file as it was.

    Raises:
        Passing: it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}{HALF_WRITTEN}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # RuntimeError: netCDF's word for a full disk
        reason = getattr(error, "strerror", None) or str(error)
        advice = "free some space or correct the permissions, and run again"
        raise TransientError(
            str(path), expected="room and the right to write it", found=reason, advice=advice
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_json(path: str | Path, data: object) -> None:
    """Write JSON: keys in the order given, numbers to ten significant digits, what is not finite as null.

    Args:
        data: mappings, sequences, arrays, numbers, text, paths, None.

    Raises:
        TypeError: something else is among the data.
    """
    text = json.dumps(_jsonable(data), indent=1, ensure_ascii=False, allow_nan=False)
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises:
        InputError: the file is absent or is not JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise _damaged(path, "a JSON file", error) from error


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
    advice = RERUN
    return TransientError(str(path), expected=expected, found=f"{type(error).__name__}: {error}", advice=advice)


# Tables of numbers.


def write_csv(
    path: str | Path, names: Sequence[str], columns: Sequence[Sequence[Any] | NDArray[Any]], forms: Sequence[str]
) -> None:
    """Write columns of numbers or texts; what is not finite is left empty.

    Args:
        forms: format of each column's numbers, such as ``{:.3f}``.
    """
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        for row in zip(*columns, strict=True):
            cells = zip(row, forms, strict=True)
            writer.writerow([x if isinstance(x, str) else f.format(x) if np.isfinite(x) else "" for x, f in cells])


def read_csv(path: str | Path, texts: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """Read the columns of a table that this program wrote, NaN where a number is missing.

    Args:
        texts: names of columns that are no numbers.

    Raises:
        InputError: the file is absent or damaged.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8") as stream:
            names, *rows = list(csv.reader(stream)) or [[]]
        cells = {name: [row[k] for row in rows] for k, name in enumerate(names)}
        return {
            name: np.array(column if name in texts else [float(cell or "nan") for cell in column])
            for name, column in cells.items()
        }
    except (OSError, ValueError, IndexError) as error:
        raise InputError(
            str(path),
            expected="a table that this program wrote",
            found=f"{type(error).__name__}: {error}",
            advice=RERUN,
        ) from error


@contextmanager
def create_netcdf(
    path: str | Path, form: Literal["NETCDF4", "NETCDF4_CLASSIC"] = "NETCDF4"
) -> Iterator[netCDF4.Dataset]:
    """Give an empty netCDF file to fill, which takes its place once the block has ended well.

    Args:
        form: netCDF-4, or its classic model.
    """
    with atomic_write(path) as temporary, netCDF4.Dataset(temporary, "w", format=form) as nc:
        yield nc


@contextmanager
def open_netcdf(path: str | Path) -> Iterator[netCDF4.Dataset]:
    """Open a netCDF file of the results for reading.

    Raises:
        InputError: the file is absent or damaged, or lacks a variable or an attribute that the block reads.
    """
    try:
        with netCDF4.Dataset(path) as nc:
            nc.set_auto_mask(False)
            yield nc
    except (OSError, RuntimeError, LookupError, AttributeError, ValueError) as error:
        if not _from_netcdf(error):
            raise
        raise _damaged(path, "a whole netCDF file that this program wrote", error) from error


def _from_netcdf(error: Exception) -> bool:
    """Distinguish an error of the file from one of the code that reads it."""
    if isinstance(error, IndexError):  # of a missing variable
        return " not found in " in str(error)
    if isinstance(error, AttributeError):  # of a missing attribute
        return str(error).startswith("NetCDF: ")
    return isinstance(error, (OSError, RuntimeError, UnicodeDecodeError, json.JSONDecodeError))


def write_variable(
    nc: netCDF4.Dataset,
    variable: Variable,
    values: ArrayLike,
    *,
    level: Literal[0, 1, 4] = 1,
    rows: slice | None = None,
) -> None:
    """Write one variable or a piece of it, what is not finite as its fill value.

    Args:
        nc: the open file, which has the variable's dimensions.
        variable: its entry in the table.
        values: its values, in the shape of its dimensions or of the piece.
        level: of the compression; none at 0.
        rows: the piece along TIME; all where absent.
    """
    values = np.asarray(values)
    if variable.fill is not None and values.dtype.kind == "f":  # integers are finite, and an unsigned one holds no -1
        dtype = np.dtype(variable.dtype)  # float32 is half as large as what is written
        values = values.astype(dtype if dtype.kind == "f" else values.dtype)
        values[~np.isfinite(values)] = variable.fill
    made = nc[variable.name] if variable.name in nc.variables else _create_variable(nc, variable, level)
    made[... if rows is None else tuple(rows if name == "TIME" else slice(None) for name in variable.dimensions)] = (
        values
    )


def _create_variable(nc: netCDF4.Dataset, variable: Variable, level: Literal[0, 1, 4]) -> netCDF4.Variable:
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
    made.setncatts(variable.attributes())
    return made


def write_bins(nc: netCDF4.Dataset, bins: int, looks_up: bool) -> None:
    """Write the numbers of the bins.

    Args:
        nc: the open file, which has the dimension BIN.
        looks_up: whether they go upwards.
    """
    away = {"positive": "up" if looks_up else "down"}
    write_variable(nc, replace(BIN, also={**BIN.also, **away}), np.arange(1, bins + 1))


def write_beams(nc: netCDF4.Dataset, beams: int) -> None:
    """Write the numbers of the beams, where there are any."""
    if beams:
        nc.createDimension(BEAM.name, beams)
        write_variable(nc, BEAM, np.arange(1, beams + 1))


@dataclass(frozen=True)
class StoredVariable:
    """A variable of a file, whose rows are read when they are asked for."""

    path: str
    name: str

    def __getitem__(self, which: slice | NDArray[Any], /) -> NDArray[Any]:
        """Read some rows, beams along the last axis, NaN where a number with a fraction is missing.

        Raises:
            InputError: the file is absent or damaged.
        """
        with open_netcdf(self.path) as nc:
            values = np.asarray(nc[self.name][which] if nc[self.name].ndim < 3 else nc[self.name][:, which])
        values = np.moveaxis(values, 0, 2) if values.ndim == 3 else values
        if values.dtype.kind == "f":
            values[values == FILL] = np.nan
        return values


def read_variable(nc: netCDF4.Dataset, name: str, bins: int | None = None) -> NDArray[Any]:
    """Read a variable: numbers as float64 with NaN where they are missing, flags as they are.

    Args:
        bins: how many are wanted where it has bins; all where absent.
    """
    values = np.asarray(nc[name][:, :bins] if bins is not None and nc[name].ndim == 2 else nc[name][...])
    if values.dtype.kind != "f":
        return values
    values = values.astype(float)
    values[values == FILL] = np.nan
    return values


def read_series(path: str | Path, *names: str) -> list[NDArray[Any]]:
    """Read variables of a file, NaN where a value is missing.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with open_netcdf(path) as nc:
        return [read_variable(nc, name) for name in names]


def read_attribute(path: str | Path, name: str) -> str:
    """Read one global attribute of a file.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with open_netcdf(path) as nc:
        return str(nc.getncattr(name))


# Figures as data URIs with a palette, for a page; made beside the figures by the job that draws.

PICTURES = "work/pictures.json"  # in the folder of a mooring's results
COLOURS = 256  # of the palette: a third of the bytes, and nothing that a reader would see
SMALL_PIXELS, SMALL_COLOURS = 350, 16  # width and palette of what stands for a figure on a page of many
SMALL_FIGURES = ("sticks", "progressive", "roses")  # that have such a picture
Picture = tuple[str, tuple[int, int]]  # data URI; width and height, pixels


def embed_png(path: str | Path, *, small: bool = False) -> Picture:
    """Encode a PNG with a palette as a data URI, with its size; the same file gives the same text.

    Raises:
        InputError: it is not a whole one.
    """
    from PIL import Image  # only where a picture is made

    try:
        with Image.open(path) as image:
            whole = image.convert("RGB")
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(str(path), expected="a whole PNG", found=error, advice=RERUN) from error
    if small:
        whole = whole.resize((SMALL_PIXELS, round(SMALL_PIXELS * whole.height / whole.width)), Image.Resampling.BOX)
    colours, method = (SMALL_COLOURS, Image.Quantize.MEDIANCUT) if small else (COLOURS, Image.Quantize.FASTOCTREE)
    reduced = whole.quantize(colours, method, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    reduced.save(buffer, "PNG", compress_level=6)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}", reduced.size


def write_pictures(path: str | Path, figures: Iterable[str]) -> None:
    """Write the pictures of figures, by the names of their files; small ones beside them.

    Raises:
        InputError: one of them is not a whole PNG.
    """
    named = {Path(figure).stem: figure for figure in figures}
    made = {"whole": {name: embed_png(figure) for name, figure in named.items()}}
    made["small"] = {name: embed_png(named[name], small=True) for name in SMALL_FIGURES if name in named}
    write_json(path, made)


def read_pictures(folder: Path, *, small: bool = False) -> dict[str, Picture]:
    """Read the pictures made with the figures of a mooring; none where none were made."""
    path = folder / PICTURES
    made = read_json(path)["small" if small else "whole"] if path.exists() else {}
    return {name: (uri, (width, height)) for name, (uri, (width, height)) in made.items()}
