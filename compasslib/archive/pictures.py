"""Small pictures of figures for a page: with a palette, as data URIs, made beside the figures by the job that draws."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path

from compasslib.archive.files import read_json, write_json
from compasslib.core.errors import InputError

FILE = "work/pictures.json"  # in the folder of a mooring's results
COLOURS = 256  # of the palette: a third of the bytes, and nothing that a reader would see
Picture = tuple[str, tuple[int, int]]  # data URI; width and height, pixels


def embedded(path: str | Path) -> Picture:
    """Return a PNG with a palette as a data URI, and its size; the same file gives the same text.

    Raises:
        InputError: it is not a whole one.
    """
    from PIL import Image  # only where a picture is made

    try:
        with Image.open(path) as image:
            small = image.convert("RGB").quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    except (OSError, SyntaxError, ValueError) as error:
        advice = "delete it, and the next run makes it again"
        raise InputError(str(path), expected="a whole PNG", found=error, advice=advice) from error
    buffer = io.BytesIO()
    small.save(buffer, "PNG", compress_level=6)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}", small.size


def write(path: str | Path, figures: Iterable[str]) -> None:
    """Write the pictures of figures, by the names of their files.

    Raises:
        InputError: one of them is not a whole PNG.
    """
    write_json(path, {Path(figure).stem: embedded(figure) for figure in figures})


def read(folder: Path) -> dict[str, Picture]:
    """Return the pictures that stand beside the figures of a mooring; none where none were made."""
    path = folder / FILE
    made = read_json(path) if path.exists() else {}
    return {name: (uri, (width, height)) for name, (uri, (width, height)) in made.items()}
