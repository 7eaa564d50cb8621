"""Log of a magnetometer: columns, checks before any fit, and orientation of the axes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass, records
from compasslib.calibrations import read_columns
from compasslib.errors import InputError
from compasslib.readers.mmp import is_aliased
from compasslib.readers.mmp import scans as mmp_scans
from compasslib.types import Bools, Floats

TILTS = ("pitch_deg", "roll_deg")
MEASURED = ("z", *TILTS, "heading_deg")  # without which a row is incomplete, if they are there
MIN_READINGS = 50  # different ones
# Modulus of accelerometer columns in g, m/s^2 and counts of a 16-bit 2 g sensor. Direction cosines have 1 too.
GRAVITIES = {1.0: "1", 9.80665: "9.81", 16384.0: "16384"}
MAX_SCATTER_DEG = 40.0  # of logged minus computed headings, beyond which they do not follow the axes
COSINES = "The axes are direction cosines: the strength of the field, which reveals iron, is lost."
DIRECTIONS = ("forward", "starboard", "down"), ("aft", "port", "up")
HEADERS = {"x": "HX", "y": "HY", "z": "HZ", "pitch_deg": "TX", "roll_deg": "TY", "heading_deg": "HDNG"}  # of an ACM


@dataclass(frozen=True)
class Log:
    """Readings in file order, without incomplete rows; tilts and heading are None where absent."""

    raw: Floats  # (n, 3) in the file's unit and axes; the third is 0 where there is none
    has_z: bool
    pitch_deg: Floats | None
    roll_deg: Floats | None
    heading_deg: Floats | None
    time_s: Floats | None
    left_out: int
    warnings: tuple[str, ...] = ()
    temperature_c: Floats | None = None
    axis_by_axis: bool = False  # each tilt levels only its own axis, as the logger itself does

    @property
    def tilted(self) -> bool:
        """Whether tilts were logged."""
        return self.pitch_deg is not None

    def take(self, index: Bools, *warnings: str) -> Log:
        """Select readings by a mask (n,) and append warnings that state the reason."""
        left_out = self.left_out + int((~index).sum())
        return replace(records.take(self, index), left_out=left_out, warnings=(*self.warnings, *warnings))

    def levelling(self) -> Floats:
        """Compute the matrices from the body frame to the level frame, (n, 3, 3); the identity without tilts."""
        if self.pitch_deg is None or self.roll_deg is None:
            return np.broadcast_to(np.eye(3), (len(self.raw), 3, 3))
        level = compass.levelling(self.pitch_deg, self.roll_deg)
        if self.axis_by_axis:
            sine, cosine = angles.sin_cos(self.pitch_deg)
            level[:, 0] = np.column_stack([cosine, np.zeros_like(sine), sine])
        return level


@dataclass(frozen=True)
class Axes:
    """Orientation of the file's axes in the body frame (forward, starboard, down)."""

    matrix: Floats  # (3, 3) body = matrix @ file
    text: str
    turned: bool = False  # whether the logged heading determines the turn about the vertical


def read(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Log:
    """Read the log from files, with the settings ``format``, ``columns`` and ``withhold``."""
    if settings.get("format") == "mmp_acm":
        return _read_acm([Path(file) for file in files], set(settings.get("withhold") or ()))
    read, notes = read_columns(files, settings, ("x", "y"), (*MEASURED, "time_utc", "temperature_c"))
    measured = ["x", "y", *(role for role in MEASURED if role in read and np.isfinite(read[role]).any())]
    good, warnings = np.all([np.isfinite(read[role]) for role in measured], axis=0), list(notes)
    if not good.all():
        warnings.append(f"{int((~good).sum())} of {good.size} rows lack a number and are excluded.")
    columns = {role: x[good] for role, x in read.items() if role in measured or role not in MEASURED}
    if "z" in columns and columns["z"].size and np.ptp(columns["z"]) == 0.0:
        z = columns.pop("z")[0]
        warnings.append(f"Column z is {z:g} throughout: the sensor is stuck and the column is not used.")
    tilts = [columns[role] for role in TILTS if role in columns]
    if len(tilts) == 1:
        warnings.append("Only one of pitch and roll is there: tilts are not used.")
    elif tilts and not np.any(tilts):
        columns = {role: x for role, x in columns.items() if role not in TILTS}
        warnings.append("All tilts are zero: they are taken as not logged, and the readings as level.")
    elif tilts and "z" not in columns:
        warnings.append("Without z the tilts cannot be compensated: the readings are taken as level.")
    log = _compose(columns, int((~good).sum()), warnings)
    if not len(log.raw):
        return log
    low, high = np.percentile(log.raw, (1.0, 99.0), axis=0)  # range of the central 98 % of an axis
    middle, reach = (low + high) / 2.0, 1.5 * (high - low)
    spike = np.any((np.abs(log.raw - middle) > reach) & (reach > 0.0), axis=1)
    return log.take(~spike, f"{spike.sum()} of {spike.size} readings are spikes and excluded.") if spike.any() else log


def _compose(columns: Mapping[str, Floats], left_out: int, warnings: Sequence[str]) -> Log:
    z, tilted = columns.get("z"), {"z", *TILTS} <= {*columns}
    return Log(
        raw=np.column_stack([columns["x"], columns["y"], np.zeros(len(columns["x"])) if z is None else z]),
        has_z=z is not None,
        pitch_deg=columns["pitch_deg"] if tilted else None,
        roll_deg=columns["roll_deg"] if tilted else None,
        heading_deg=columns.get("heading_deg"),
        time_s=columns.get("time_utc"),
        left_out=left_out,
        warnings=tuple(warnings),
        temperature_c=columns.get("temperature_c"),
    )


def _read_acm(paths: Sequence[Path], withhold: Collection[str]) -> Log:
    """Read direction cosines (forward, port, up), tilts and heading of a Falmouth 3D-ACM.

    The first scan of a profile is aliased and left out. The logger levels each axis separately.
    """
    known = {*HEADERS, *HEADERS.values(), "time_utc"}
    needed = {"x", "y", HEADERS["x"], HEADERS["y"]}
    if wrong := sorted(set(withhold) - (known - needed)):
        expected = f"columns other than x and y ({', '.join(sorted(known - needed))})"
        raise InputError("withhold", expected=expected, found=wrong[0], advice="take it off the list")
    scans = mmp_scans.read_scans(paths)
    values, aliased = scans.values, is_aliased(scans)
    keep = ~aliased & np.isfinite(values[:, 3:6]).all(axis=1)
    columns = {
        role: values[keep, mmp_scans.COLUMNS.index(header)]
        for role, header in HEADERS.items()
        if not {role, header} & set(withhold)
    }
    warnings = [f"{int(aliased.sum())} first scans of a profile are aliased and excluded."]
    if {*TILTS} <= {*columns} and scans.damaged:
        warnings.append(f"{scans.damaged} damaged rows are excluded.")
    if np.isnan(columns.get("heading_deg", 0.0)).any():
        del columns["heading_deg"]
        warnings.append("The scans carry no heading.")
    if "time_utc" not in withhold:
        nominal = np.array([block.rate_hz for block in scans.blocks])
        columns["time_utc"] = mmp_scans.interpolate_clock(scans.clock_s, scans.profile, nominal[scans.profile])[keep]
    return replace(_compose(columns, int((~keep).sum()), warnings), axis_by_axis=True)


def are_direction_cosines(log: Log) -> bool:
    """Return whether the readings are direction cosines: their modulus is 1 in every orientation but for rounding."""
    return log.has_z and bool(np.all(np.abs(np.linalg.norm(log.raw, axis=1) - 1.0) < 2e-3))


def unusable_reason(log: Log) -> str:
    """Explain why the readings cannot be a magnetometer's log of a turning instrument; empty if they can."""
    raw = log.raw
    for k, name in enumerate("xy"):
        if len(raw) and np.ptp(raw[:, k]) == 0.0:
            return f"Column {name} is {raw[0, k]:g} throughout: the sensor is stuck, or the instrument did not turn."
    if (distinct := len(np.unique(raw, axis=0))) < MIN_READINGS:
        return f"{distinct} different readings in {len(raw)} rows, at least {MIN_READINGS} are needed."
    length = np.linalg.norm(raw, axis=1)
    mean = float(length.mean())
    if not log.has_z or float(length.std()) >= 0.02 * mean:
        return ""
    if log.axis_by_axis and are_direction_cosines(log):
        return COSINES
    for value, text in GRAVITIES.items():
        if abs(mean - value) < 0.02 * value:
            also = " (or direction cosines, whose strength is gone)" if value == 1.0 else ""
            return f"The modulus of x, y, z is {text} throughout: this is gravity, from an accelerometer{also}."
    return ""


def level_heading(field: Floats, levelling: Floats) -> Floats:
    """Compute the tilt-compensated heading, (n,) degrees, from the field in the body frame, (n, 3)."""
    north = np.einsum("nij,nj->ni", levelling[:, :2, :], field)
    return angles.argument(north[:, 0] - 1j * north[:, 1])


def determine_axes(log: Log) -> tuple[Axes, list[str]]:
    """Determine the axes from the logged heading if it follows them, else assume x forward, y starboard, z down."""
    usual = _describe_axes(np.eye(3))
    assumed = Axes(np.eye(3), f"{usual} (assumed)")
    if log.heading_deg is None:
        return assumed, ["No heading is logged: x is taken as forward, y as starboard, z as down."]
    if float(angles.resultant_length(log.heading_deg)) > 0.9:
        return assumed, ["The logged heading hardly turns: x is taken as forward, y as starboard, z as down."]
    best, scatter, off = search_axes(log)
    if scatter > MAX_SCATTER_DEG:
        return assumed, [f"The logged heading does not follow the axes (scatter {scatter:.0f}°). {usual}."]
    text = _describe_axes(best) + " (from the logged heading)"
    if scatter > 2.0:
        doubt = f"The logged heading is not that of the raw axes (scatter {scatter:.1f}°): it is levelled or corrected."
        return Axes(best, text), [f"{doubt} Coefficients here are for the heading of the raw axes."]
    return Axes(about_down(off) @ best, text, turned=True), []


def search_axes(log: Log) -> tuple[Floats, float, float]:
    """Find the signed permutation with the least scatter of logged minus computed heading; give scatter and mean."""
    levelling, logged = log.levelling(), np.asarray(log.heading_deg)
    best: Floats = np.eye(3)
    least, mean = np.inf, 0.0
    # Right-handed axes first; others must be clearly better, as tilts need not distinguish up from down.
    for y, z in ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)):
        for quarter in range(4):
            turned = np.round(about_down(90.0 * quarter)) @ np.diag([1.0, y, z])
            off = angles.difference(logged, level_heading(log.raw @ turned.T, levelling))
            centre, scatter = mean_and_scatter(off)
            if abs(centre) <= 45.0 and scatter < 0.9 * least:
                best, least, mean = turned, scatter, centre
    return best, float(least), mean


def mean_and_scatter(off_deg: Floats) -> tuple[float, float]:
    """Compute the mean of differences of headings, and their rms about it, degrees."""
    centre = float(angles.wrap180(angles.mean(off_deg)))
    return centre, angles.rms(angles.difference(off_deg, centre))


def about_down(angle_deg: float) -> Floats:
    """Build the rotation about the vertical that adds an angle to the heading, (3, 3)."""
    s, c = (float(v) for v in angles.sin_cos(angle_deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _describe_axes(matrix: Floats) -> str:
    """Describe the directions of x, y and z in words."""
    largest = np.argmax(np.abs(matrix), axis=0)
    words = [DIRECTIONS[int(matrix[axis, k] < 0)][axis] for k, axis in enumerate(largest)]
    return ", ".join(f"{name} {word}" for name, word in zip("xyz", words, strict=True))
