"""Figures of the results inside the page: palette pictures at their own size, in only so many sections."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from compasslib.archive import pictures
from compasslib.archive.pictures import Picture
from compasslib.report.section import Figure

MOST_SECTIONS = 50  # whose figures stand in the page: about 20 MB; those of a thousand moorings would be 400 MB
NOTHING: Picture = ("", (0, 0))
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
        alternatives: what each figure shows, by its name.
        embed: whether the pictures come into the page.
    """
    order = {name: k for k, name in enumerate(TITLES)}
    paths = sorted(folder.glob("figures/*.png"), key=lambda p: (order.get(p.stem, len(order)), p.stem))
    made = pictures.read(folder) if embed else {}
    shown = {path: (made.get(path.stem) or pictures.embedded(path)) if embed else NOTHING for path in paths}
    return tuple(_figure(path, root, alternatives.get(path.stem), shown[path]) for path in paths)


def chosen(verdicts: Sequence[str]) -> list[bool]:
    """Return which sections show their figures in the page: all, or the first that are not merely consistent.

    Args:
        verdicts: of the sections in the order of the page; empty for a section that has none.
    """
    urgent = sorted(range(len(verdicts)), key=lambda k: (verdicts[k] == "consistent", k))
    kept = set(urgent[:MOST_SECTIONS])
    return [k in kept for k in range(len(verdicts))]


def relative(path: Path, root: Path) -> str:
    """Return the address of a file of the results from the page."""
    return quote(path.relative_to(root).as_posix())


def _figure(path: Path, root: Path, alternative: Callable[[], str] | None, shown: Picture) -> Figure:
    title = TITLES.get(path.stem, path.stem.replace("_", " ").capitalize())
    described = alternative() if alternative else f"{title}; its numbers stand beside it in this section."
    picture, size = shown
    return Figure(title, described, relative(path, root), picture, *size)
