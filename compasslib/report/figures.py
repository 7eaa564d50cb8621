"""Figures of the results inside the page: with a palette, and on a page of many sections small and few."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from urllib.parse import quote

from compasslib.archive import pictures
from compasslib.archive.pictures import Picture
from compasslib.report.section import Figure

MOST_SECTIONS = 50  # whose figures stand in the page whole; those of a thousand moorings would be 400 MB
NOTHING: Picture = ("", (0, 0))
TITLES = {
    "sticks": "Currents along time",
    "progressive": "Progressive vectors",
    "roses": "Directions before and after",
    "diagnosis": "What the residual shows",
    "deviation": "Deviation of the compass",
    "scatter": "Direction against the reference",
    "timeline": "Headings along time",
    "residuals": "Residuals of the curve",
    "certificate": "Certificate",
    "magnetometer": "Magnetometer readings before and after",
    "swing": "The swing",
    "difference": "Difference of the two compasses",
    "tilt_check": "Tilts of the two instruments",
    "along_time": "Both compasses along time",
    "series": "Declination of the observatory",
    "disturbance": "Disturbances of the field",
}
LINKED = ("certificate",)  # a page to keep with the instrument, whose numbers stand in the tables


def of_folder(folder: Path, root: Path, captions: Mapping[str, Callable[[], str]], *, small: bool) -> dict[str, Figure]:
    """Return the figures of one mooring or calibration by name, in the order of ``TITLES``, others after them.

    Args:
        folder: its results; the figures are the PNG files of its folder ``figures``.
        captions: what each figure shows, by its name.
        small: whether the page has too many sections for whole pictures.
    """
    order = {name: k for k, name in enumerate(TITLES)}
    paths = sorted(folder.glob("figures/*.png"), key=lambda p: (order.get(p.stem, len(order)), p.stem))
    made = pictures.read(folder, small=small)
    return {path.stem: _figure(path, root, captions.get(path.stem), _picture(path, made, small)) for path in paths}


def relative(path: Path, root: Path) -> str:
    """Return the address of a file of the results from the page."""
    return quote(path.relative_to(root).as_posix())


def _picture(path: Path, made: Mapping[str, Picture], small: bool) -> Picture:
    if path.stem in made:
        return made[path.stem]
    if path.stem in LINKED or small:
        return NOTHING
    return pictures.embedded(path)


def _figure(path: Path, root: Path, caption: Callable[[], str] | None, shown: Picture) -> Figure:
    title = TITLES.get(path.stem, path.stem.replace("_", " ").capitalize())
    picture, size = shown
    return Figure(title, caption() if caption else "", relative(path, root), picture, *size)
