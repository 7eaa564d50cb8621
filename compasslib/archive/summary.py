"""One row a mooring: what was corrected, how well, and what a person should know."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.archive import netcdf
from compasslib.archive.files import read_series
from compasslib.core import angles

COLUMNS = (
    "name",
    "method",
    "n_pairs",
    "share_corrected",
    "rms_before_deg",
    "rms_after_deg",
    "max_deviation_deg",
    "folded",
    "verdict",
    "effects",
    "warnings",
)

STOPPED = "stopped"  # the verdict of a mooring without results, as its files cannot be used
LARGE_CONSTANT_DEG, SURE_SIGMAS = 10.0, 2.0
NEAR_DEG = 4.0  # mounts and mean veers make as much
# By how many declinations the reference's directions lie too far clockwise, or the affected headings are too small.
MISTAKES = {
    1: "about once the declination ({:+.0f}): the directions of the reference have it twice, being true already "
    "(direction_reference, declination_applied), or it was taken off the affected headings, which had none "
    "(declination_applied)",
    -1: "about once the declination ({:+.0f}) with the other sign: the directions of the reference lack it, being "
    "magnetic (direction_reference, declination_applied), or the affected headings have it already "
    "(declination_applied)",
    2: "about twice the declination ({:+.0f}): it was applied with the wrong sign (declination_applied, longitude)",
    -2: "about twice the declination ({:+.0f}) with the other sign: it was applied with the wrong sign "
    "(declination_applied, longitude)",
}


def row(name: str, folder: str | Path, roles: Iterable[str] | None = None) -> dict[str, Any]:
    """Return a mooring's row; shares from 0 to 1, angles in degrees, rms on pairs held out from the fit.

    Args:
        roles: its instruments; None where no configuration says so, then every record that is there.
    """
    folder = Path(folder)
    files = ("deviation.json", "assessment.json", "diagnosis.json")
    fit, verdict, found = (netcdf.read_json(folder / file) for file in files)
    heading, deviation = read_series(folder / "corrected.nc", "HEADING_CORRECTED", "DEVIATION")
    corrected = np.isfinite(heading)
    return {
        "name": name,
        "method": fit["method"],
        "n_pairs": fit["n_pairs"],
        "share_corrected": _rounded(corrected.mean() if corrected.size else 0.0, 4),
        "rms_before_deg": _rounded(verdict["before"]["rms_deg"], 2),
        "rms_after_deg": _rounded(verdict["after"]["rms_deg"], 2),
        "max_deviation_deg": _rounded(np.nanmax(np.abs(deviation)) if corrected.any() else None, 1),
        "folded": fit["folded"],
        "verdict": found["verdict"],
        "effects": " ".join(finding["effect"] for finding in found["findings"]),
        "warnings": " | ".join([*_warnings(folder, roles, fit, found, verdict), *_of_records(records(folder, roles))]),
    }


def constant(folder: Path, roles: Iterable[str] | None) -> list[str]:
    """Return what a large constant between a mooring's instruments may be; nothing where it is none."""
    fit, field = (netcdf.read_json(folder / file) for file in ("deviation.json", "work/field.json"))
    return _constant(fit, field, _taken_out(records(folder, roles)))


def row_of_stopped(name: str, why: str) -> dict[str, Any]:
    """Return the row of a mooring that was stopped: no numbers, the verdict ``stopped`` and the reason as a warning."""
    return dict.fromkeys(COLUMNS, None) | {"name": name, "verdict": STOPPED, "warnings": why}


def records(folder: Path, roles: Iterable[str] | None) -> list[Path]:
    """Return the records of a mooring's instruments, in the order of their names.

    Args:
        roles: its instruments; None where no configuration says so, then every record that is there.
    """
    if roles is None:
        return sorted((folder / "work").glob("*.nc"))
    return [folder / f"work/{role}.nc" for role in sorted(roles)]


def write(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write summary.csv."""
    with netcdf.replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows as a person reads them on a terminal."""
    shown = COLUMNS[:8]
    lines = [shown, *(["" if r[c] is None else str(r[c]) for c in shown] for r in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(shown))]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(line, widths, strict=True)) for line in lines)


def _warnings(
    folder: Path,
    roles: Iterable[str] | None,
    fit: Mapping[str, Any],
    found: Mapping[str, Any],
    verdict: Mapping[str, Any],
) -> list[str]:
    field = netcdf.read_json(folder / "work/field.json")
    reasons = dict.fromkeys(why for why in (fit["why"], found["why"] * (found["verdict"] == "insufficient")) if why)
    pairs, taken_out = netcdf.read_pairs(folder / "overlap.nc").warnings, _taken_out(records(folder, roles))
    refuted = [verdict["refuted"]] if verdict["refuted"] else []
    first = [*refuted, *reasons, *found.get("warnings", ()), *_unexplained(found), *pairs]
    return [*first, *fit["warnings"], *_constant(fit, field, taken_out), *field["warnings"]]


def _of_records(paths: Iterable[Path]) -> list[str]:
    return [f"{path.stem}: {warning}" for path in paths for warning in netcdf.read_warnings(path)]


def _unexplained(found: Mapping[str, Any]) -> list[str]:
    """Say what the search saw and nothing predicts: the verdict alone does not tell how large it is."""
    left = found["unexplained"]
    if not left:
        return []
    return [
        f"a mismatch of {left['rms_effect_deg']:.1f}° rms {left['where']['text']} is unexplained and not "
        "corrected; it is included in the uncertainty"
    ]


def _taken_out(paths: Iterable[Path]) -> dict[str, float]:
    """Return by instrument the heading bias that was taken out of its directions, degrees."""
    return {path.stem: netcdf.read_heading_bias(path) for path in paths}


def _constant(fit: Mapping[str, Any], field: Mapping[str, Any], taken_out: Mapping[str, float]) -> list[str]:
    """Point at a constant between the instruments that is larger than what mounts are set to."""
    in_degrees = fit["unit"] == "degrees"
    if not fit["coefficients"] or (in_degrees and fit["folded"]):  # the series' constant is none where it folds
        return []
    a, sigma = fit["coefficients"]["A"], fit["covariance"][0][0] ** 0.5
    constant = a if in_degrees else float(angles.direction(a, 1.0))
    turned = float(angles.wrap180(constant))
    if abs(turned) < LARGE_CONSTANT_DEG or abs(a) < SURE_SIGMAS * sigma:
        return []
    declination = float(np.mean(field["declination_deg"]))
    first = f"the fit holds a constant of {turned:+.0f} degrees, "
    sigma = sigma if in_degrees else sigma / angles.DEGREE
    biases = [
        f"about the heading bias EB of {bias:+.1f} that was taken out of the directions of {name}, which may not hold "
        "it (declination_applied: 0 leaves them as they are)"
        for name, bias in taken_out.items()
        if abs(abs(turned) - abs(bias)) < min(max(NEAR_DEG, SURE_SIGMAS * sigma), abs(bias) / 3.0)
    ]
    if mistake := "; or ".join([*biases, *filter(None, [_mistake(turned, sigma, declination)])]):
        return [first + mistake]
    return [
        f"{first}a mounting offset or a mistake: declination is {declination:+.0f} here; check its sign, that of the "
        "longitude, direction_reference and declination_applied"
    ]


def _mistake(turned_deg: float, sigma_deg: float, declination_deg: float) -> str:
    """Return what a constant looks like, nothing where it is near no multiple of the declination and no half turn."""
    near = max(NEAR_DEG, SURE_SIGMAS * sigma_deg)
    if abs(turned_deg) > 180.0 - near:
        return "half a turn: the instrument hangs backwards, or one of the two has both components of the other sign"
    times = [k for k in MISTAKES if abs(turned_deg - k * declination_deg) < min(near, abs(declination_deg) / 3.0)]
    if not times:
        return ""
    return MISTAKES[times[0]].format(declination_deg)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(float(value), digits)
