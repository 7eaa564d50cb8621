"""Figures of the results inside the page: palette pictures at their own size, in only so many sections."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from compasslib.errors import InputError
from compasslib.report.section import Figure

MOST_SECTIONS = 50  # whose figures stand in the page: about 20 MB; those of a thousand moorings would be 400 MB
COLOURS = 256  # of the palette: a third of the bytes, and nothing that a reader would see
TITLES = {
    "deviation": "Deviation of the compass",
    "histograms": "Headings and directions before and after",
    "scatter": "Upper against lower current direction",
    "timeline": "The record along time",
    "diagnosis": "Search for left-out physics",
    "residuals": "What the curve leaves",
    "certificate": "Certificate",
    "magnetometer": "Magnetometer readings before and after",
    "swing": "The swing",
    "difference": "Difference of the two compasses",
    "tilt_check": "Tilts of the two instruments",
    "along_time": "Both compasses along time",
    "series": "Declination of the observatory",
    "disturbance": "Disturbances of the field",
}


def of_folder(
    folder: Path, root: Path, alternatives: Mapping[str, Callable[[], str]], *, embed: bool
) -> tuple[Figure, ...]:
    """Return the figures of one mooring or calibration in the order of ``TITLES``, others after them.

    Args:
        folder: its results; the figures are the PNG files of its folder ``figures``.
        root: folder of the page.
        alternatives: what each figure shows, by its name.
        embed: whether the pictures come into the page.
    """
    order = {name: k for k, name in enumerate(TITLES)}
    paths = sorted(folder.glob("figures/*.png"), key=lambda p: (order.get(p.stem, len(order)), p.stem))
    return tuple(_figure(path, root, alternatives.get(path.stem), embed) for path in paths)


def chosen(verdicts: Sequence[str]) -> list[bool]:
    """Return which sections show their figures in the page: all, or the first that are not merely consistent.

    Args:
        verdicts: of the sections in the order of the page; empty for a section that has none.
    """
    urgent = sorted(range(len(verdicts)), key=lambda k: (verdicts[k] == "consistent", k))
    kept = set(urgent[:MOST_SECTIONS])
    return [k in kept for k in range(len(verdicts))]


def relative(path: Path, root: Path) -> str:
    """Return the address of a file of the results from the page.

    Args:
        path: the file.
        root: folder of the page.
    """
    return quote(path.relative_to(root).as_posix())


def _figure(path: Path, root: Path, alternative: Callable[[], str] | None, embed: bool) -> Figure:
    title = TITLES.get(path.stem, path.stem.replace("_", " ").capitalize())
    said = alternative() if alternative else f"{title}; its numbers stand beside it in this section."
    picture, size = _embedded(path) if embed else ("", (0, 0))
    return Figure(title, said, relative(path, root), picture, *size)


def _embedded(path: Path) -> tuple[str, tuple[int, int]]:
    """Return a PNG with a palette as a data URI, and its size; the same file gives the same text."""
    from PIL import Image  # only where a picture is embedded

    try:
        with Image.open(path) as image:
            small = image.convert("RGB").quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    except (OSError, SyntaxError, ValueError) as error:
        advice = "delete it, and the next run makes it again"
        raise InputError(str(path), expected="a whole PNG", found=error, advice=advice) from error
    held = io.BytesIO()
    small.save(held, "PNG", compress_level=6)
    return f"data:image/png;base64,{base64.b64encode(held.getvalue()).decode()}", small.size
