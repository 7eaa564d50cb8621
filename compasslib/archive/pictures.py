"""Pictures of figures for a page: with a palette, as data URIs, made beside the figures by the job that draws."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path

from compasslib.archive.files import MAKE_ANEW, read_json, write_json
from compasslib.errors import InputError

FILE = "work/pictures.json"  # in the folder of a mooring's results
COLOURS = 256  # of the palette: a third of the bytes, and nothing that a reader would see
SMALL_PIXELS, SMALL_COLOURS = 350, 16  # width and palette of what stands for a figure on a page of many
SMALL = ("sticks", "progressive", "roses")  # that have such a picture
Picture = tuple[str, tuple[int, int]]  # data URI; width and height, pixels


def embedded(path: str | Path, *, small: bool = False) -> Picture:
    """Return a PNG with a palette as a data URI, and its size; the same file gives the same text.

    Raises:
        InputError: it is not a whole one.
    """
    from PIL import Image  # only where a picture is made

    try:
        with Image.open(path) as image:
            whole = image.convert("RGB")
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(str(path), expected="a whole PNG", found=error, advice=MAKE_ANEW) from error
    if small:
        whole = whole.resize((SMALL_PIXELS, round(SMALL_PIXELS * whole.height / whole.width)), Image.Resampling.BOX)
    colours, method = (SMALL_COLOURS, Image.Quantize.MEDIANCUT) if small else (COLOURS, Image.Quantize.FASTOCTREE)
    reduced = whole.quantize(colours, method, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    reduced.save(buffer, "PNG", compress_level=6)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}", reduced.size


def write(path: str | Path, figures: Iterable[str]) -> None:
    """Write the pictures of figures, by the names of their files; small ones beside them.

    Raises:
        InputError: one of them is not a whole PNG.
    """
    named = {Path(figure).stem: figure for figure in figures}
    made = {"whole": {name: embedded(figure) for name, figure in named.items()}}
    made["small"] = {name: embedded(named[name], small=True) for name in SMALL if name in named}
    write_json(path, made)


def read(folder: Path, *, small: bool = False) -> dict[str, Picture]:
    """Return the pictures that stand beside the figures of a mooring; none where none were made."""
    path = folder / FILE
    made = read_json(path)["small" if small else "whole"] if path.exists() else {}
    return {name: (uri, (width, height)) for name, (uri, (width, height)) in made.items()}
