"""Read a Falmouth 3D-ACM on a McLane moored profiler: one sample per scan, at the depth of the profiler's pressure.

Heading, tilts and acoustic paths come from its A files, unpacked or binary; pressure, and the time for scans of early
instruments, from its engineering (E) or CTD (C) files, or from a table. The first scan of every profile is aliased and
dropped. Velocities are corrected for the swing of the meter about the wire; like the manufacturer's processing, they
are not corrected for the small mean tilts. Headings that were not logged are computed from magnetometer and tilts.

Paths VPAB, VPCD, VPEF, VPGH lie along +X, +Y, -X, -Y of the sting: two level, two inclined. x points along the
heading, y to port, z up. Sources: McLane, MMP User Manual, appendix G; Toole et al. 1999; signs are tested against
known solutions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.errors import InputError, applicable
from compasslib.readers.delimited import DEFAULT_LAYOUT, Layout, find_head, read_table, table_notes
from compasslib.readers.detect import detect_kind, match_roles
from compasslib.readers.files import read_bytes, refuse_mostly_damaged
from compasslib.readers.mmp.scans import UNKNOWN, ProfileBlock, Scans, interpolate_clock, is_text, parse, read_scans
from compasslib.records import GOOD, PROBABLY_BAD, Record, new_record
from compasslib.types import Bools, Floats

USUAL_HZ = 2.0  # sample rate if neither the file nor the switching times determine it
PARKED_S = 180.0  # a profiler rests at either end of a profile before and after the rows of its engineering file
EXPECTED = (
    "an unpacked engineering (E) or CTD (C) file of the profiler, or a CSV table with a header line and the columns"
    " time and pressure (time_utc or time, ISO; pressure_dbar or pressure, dbar)"
)
DBAR = 2  # index of the pressure column after the time stamp, in E and C files


@dataclass(frozen=True, eq=False)
class Companion:
    """Time series of pressure and start times of profiles, of one file or of all files together."""

    time_s: Floats  # (c,) UTC seconds since 1970, increasing if merged from all files
    pressure_dbar: Floats  # (c,)
    starts: tuple[ProfileBlock, ...]  # sorted by time if merged from all files; their rows are not used
    damaged: int = 0  # number of rows dropped
    notes: tuple[str, ...] = ()  # notes on the format of tables
    clocked: bool = True  # whether the samples of a file carry a clock

    def at(self, time_s: Floats) -> Floats:
        """Interpolate the pressure to other times, (r,) dbar; NaN outside the series and in long gaps."""
        if len(self.time_s) < 2:
            return np.full(len(time_s), np.nan)
        step = np.diff(self.time_s)
        bridged = step <= _bridge(step)
        gap = np.searchsorted(self.time_s, time_s, side="right") - 1
        inside = (gap >= 0) & (gap < len(step))
        inside[inside] = bridged[gap[inside]]
        inside |= np.isin(time_s, self.time_s)
        return np.where(inside, np.interp(time_s, self.time_s, self.pressure_dbar), np.nan)

    def distance_s(self, time_s: Floats) -> Floats:
        """Compute the time from each of the given times to the nearest sample, (r,) seconds; infinite without any."""
        if not len(self.time_s):
            return np.full(len(time_s), np.inf)
        after = np.searchsorted(self.time_s, time_s).clip(0, len(self.time_s) - 1)
        before = (after - 1).clip(0)
        return np.minimum(np.abs(self.time_s[after] - time_s), np.abs(time_s - self.time_s[before]))


def read(
    paths: Sequence[Path], *, pressure_files: Sequence[str | Path], start_offset_seconds: float | None, **layout: Any
) -> Record:
    """Read one record from files in the order given, with currents rotated by the recorded magnetic heading.

    Pitch is TX (forward up) and roll is TY (port up), as in the logger's own computation of the heading.

    Without ``pressure_files`` (E or C files, or tables, whose format ``layout`` gives) the depth is unknown.
    ``start_offset_seconds`` is the time of the first scan minus profile start, for scans without a clock: a profile
    starts at the switch-on time in its A or E file, or else with the first row of its E file or table.

    Raises:
        InputError: a file is unreadable or of another kind, or none of the scans without a clock can be dated.
    """
    scans = read_scans(paths)
    companion = read_companions([Path(file) for file in pressure_files or ()], Layout.from_settings(layout))
    time_s, rate_hz, notes = _scan_times(scans, companion, start_offset_seconds or 0.0)
    pressure = companion.at(time_s)
    by_rule = logged_heading(scans.values[:, 3:6], scans.values[:, 1], scans.values[:, 2])
    without_heading = np.isnan(scans.values[:, 0])
    heading = np.where(without_heading, by_rule, angles.wrap360(scans.values[:, 0]))
    x, y = instrument_axes(scans.values[:, 6:] / 100.0)
    aliased, timed, rate = is_aliased(scans), np.isfinite(time_s), rate_hz[scans.profile]
    # The heading of an aliased scan is invalid, and so is the rotation from it to the next scan.
    step = np.diff(scans.clock_s)
    with np.errstate(invalid="ignore", divide="ignore"):  # whole seconds may conceal a difference of up to one second
        waited = (step < 0) | (step > 1.0 + 1.0 / rate[1:])
    joined = (np.diff(scans.profile) == 0) & (np.diff(scans.place) == 1) & ~waited & ~aliased[:-1]
    y = remove_swing(y, swing_rate(heading, rate, joined))
    keep = timed & ~aliased
    east, north = to_earth(x[keep], y[keep], heading[keep])
    remote = bool(pressure_files) & (companion.distance_s(time_s[keep]) > PARKED_S)
    counts = {  # scans, aliased, damaged and untimed ones add up to the files' content
        "scans": keep.sum(),
        "profiles": len(scans.blocks),
        "damaged_rows": scans.damaged,
        "strange_bytes": scans.strange,
        "aliased_dropped": np.sum(timed & ~keep),
        "without_time": np.sum(~timed),
        "without_pressure": np.sum(np.isnan(pressure[keep])),
        "headings_by_rule": np.sum(without_heading[keep]),
        "damaged_pressure_rows": companion.damaged,
    }
    untimed, by_rule, remotes = counts["without_time"], counts["headings_by_rule"], remote.sum()
    lines = {
        f"{scans.damaged} damaged rows were left out ({_listed(scans.damaged_files)})": scans.damaged,
        f"{scans.strange} bytes are no text and were passed over": scans.strange,
        f"{len(scans.empty_files)} files hold no scan ({_listed(scans.empty_files)})": scans.empty_files,
        f"{untimed} scans were left out: no profile start among pressure_files is theirs": untimed,
        f"{by_rule} headings were computed from HX HY HZ TX TY by the logger's rule": by_rule,
        "no pressure_files: the profiler's depth is unknown, the nominal depth has to stand for it": not pressure_files,
        f"no pressure within {PARKED_S:.0f} s of {remotes} scans: flagged, as their depth is unknown": remotes,
    }
    return new_record(
        time_s[keep],
        east[:, None],
        north[:, None],
        heading_deg=heading[keep],
        pitch_deg=scans.values[keep, 1],
        roll_deg=scans.values[keep, 2],
        pressure_dbar=pressure[keep],
        quality=np.where(remote, PROBABLY_BAD, GOOD)[:, None],
        looks_up=False,
        counts={key: int(number) for key, number in counts.items()},
        warnings=(*notes, *scans.notes, *applicable(lines), *companion.notes),
    )


def logged_heading(field: Floats, tilt_x_deg: ArrayLike, tilt_y_deg: ArrayLike) -> Floats:
    """Compute the magnetic heading by the logger's algorithm, degrees in [0, 360); NaN without a horizontal field.

    x = HX cos TX - HZ sin TX, y = HY cos TY - HZ sin TY, heading = arg(x + iy): TX raises the x axis (forward), TY the
    y axis (port), z is upward.
    """
    (sin_x, cos_x), (sin_y, cos_y) = angles.sin_cos(tilt_x_deg), angles.sin_cos(tilt_y_deg)
    level = field[..., 0] * cos_x - field[..., 2] * sin_x + 1j * (field[..., 1] * cos_y - field[..., 2] * sin_y)
    return np.where(level == 0, np.nan, np.where(np.isfinite(level), angles.argument(level), np.nan))


def instrument_axes(paths: Floats) -> tuple[Floats, Floats]:
    """Convert velocities along the paths VPAB, VPCD, VPEF, VPGH, (n, 4), to (x, y) in instrument axes, same unit."""
    ab, ef = paths[..., 0], paths[..., 2]
    return -(ab + ef) / math.sqrt(2.0), (ab - ef) / math.sqrt(2.0)


def swing_rate(heading_deg: Floats, rate_hz: Floats, joined: Bools, half_s: float = 2.0) -> Floats:
    """Estimate the meter's rotation rate, (n,) degrees/s clockwise, from the headings two seconds before and after.

    The window is truncated at the ends of gapless segments; the rate is zero for isolated scans and for sample rates
    too low to resolve a swing. Between adjacent scans the noise of the heading would exceed the swing: in a genuine
    profile at 2 Hz that raised the scatter of y from 2.1 to 2.7 cm/s, while this window lowers it to 1.9 cm/s.

    Args:
        joined: (n - 1,) whether each scan follows the previous one without a gap.
        half_s: half the width of the window; a swing lasts ten seconds or more.
    """
    turned = angles.difference(heading_deg[1:], heading_deg[:-1])
    usable = joined & np.isfinite(turned) & (rate_hz[1:] * half_s >= 1.0)
    turned = np.append(0.0, np.cumsum(np.where(usable, turned, 0.0)))[: len(heading_deg)]
    here = np.arange(len(heading_deg))
    parted = np.append(True, ~usable)[: len(here)]
    begins = np.flatnonzero(parted)
    stretch = np.cumsum(parted) - 1
    reach = np.maximum(1, np.rint(half_s * np.nan_to_num(rate_hz))).astype(np.int64)
    before = np.maximum(here - reach, begins[stretch])
    after = np.minimum(here + reach, np.append(begins[1:], len(here))[stretch] - 1)
    return (turned[after] - turned[before]) / np.maximum(after - before, 1) * np.nan_to_num(rate_hz)


def remove_swing(y: Floats, turning_deg_s: Floats, lever_m: float = 0.43) -> Floats:
    """Remove the swing from the velocity to port, m/s: the clockwise rate times the distance of paths from the wire."""
    return y - lever_m * angles.DEGREE * turning_deg_s


def to_earth(x: Floats, y: Floats, heading_deg: Floats) -> tuple[Floats, Floats]:
    """Rotate (x forward, y to port) to (east, north): east + i north = (x + iy) e^{i(90 - heading)}."""
    level = (x + 1j * y) * angles.phasor(90.0 - heading_deg)
    return level.real, level.imag


def is_aliased(scans: Scans) -> Bools:
    """Flag the first scan of each profile, which is aliased, (r,)."""
    return np.append(True, np.diff(scans.profile) > 0)[: len(scans.profile)]


def _scan_times(scans: Scans, companion: Companion, offset: float) -> tuple[Floats, Floats, list[str]]:
    """Determine the times of all scans, NaN where unknown, and the sample rate of each profile; compose warnings."""
    nominal = np.array([block.rate_hz for block in scans.blocks])
    rate, unclocked, notes = _sample_rates(scans, nominal), np.isnan(scans.clock_s), []
    if (other := np.isfinite(nominal) & (nominal != rate)).any():
        notes.append(
            f"the clock of {int(other.sum())} profiles shows {np.median(rate[other]):.3g} scans a second where the "
            f"file says {np.median(nominal[other]):.3g}; the rate of the clock is used"
        )
    time_s = interpolate_clock(scans.clock_s, scans.profile, nominal[scans.profile])
    if unclocked.any():
        start, rate, rate_notes = _starts(scans, companion, offset, rate)
        time_s = np.where(unclocked, start[scans.profile] + scans.place / rate[scans.profile], time_s)
        notes += rate_notes
    elif offset:
        notes.append("start_offset_seconds has no effect: the scans carry a clock")
    return time_s, rate, notes


def _sample_rates(scans: Scans, nominal_hz: Floats, few: int = 10, close: float = 0.2) -> Floats:
    """Choose the sample rate of each profile, (p,) Hz: the nominal one, unless the clock contradicts it.

    Args:
        nominal_hz: (p,) NaN where the file states none.
        few: number of scans up to which a clock of whole seconds does not determine the rate.
        close: largest relative difference of the two rates.
    """
    every = np.arange(len(nominal_hz))
    first, last = (np.searchsorted(scans.profile, every, side=side) for side in ("left", "right"))
    known = np.flatnonzero(last - first > few)
    begin, end = first[known], last[known] - 1
    shown = np.full(len(every), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        shown[known] = (scans.place[end] - scans.place[begin]) / (scans.clock_s[end] - scans.clock_s[begin])
        contradicts = np.isfinite(shown) & ~(np.abs(shown / nominal_hz - 1.0) < close)
    return np.where(contradicts, shown, nominal_hz)


def _starts(scans: Scans, companion: Companion, offset: float, rate: Floats) -> tuple[Floats, Floats, list[str]]:
    """Determine the time of the first scan and the sample rate, (p,) each, of profiles whose scans carry no clock."""
    # Match by number, or by order if no numbers match.
    by_number = {start.number: start for start in companion.starts if start.number != UNKNOWN}
    matched = [by_number.get(block.number, ProfileBlock(0, 0)) for block in scans.blocks]
    if len(companion.starts) == len(matched) and not any(np.isfinite(each.on_s) for each in matched):
        matched = list(companion.starts)
    starts = [a if np.isfinite(a.on_s) else b for a, b in zip(scans.blocks, matched, strict=True)]
    begin = np.array([start.on_s for start in starts]) + offset
    if not np.isfinite(begin).any():
        raise InputError(
            "pressure_files",
            expected="the profiler's engineering (E) files with the starts of the profiles, as scans carry no clock",
            found=f"{len(companion.starts)} profile starts for {len(starts)} profiles without a common number",
            advice="give the E files of the same profiles",
        )
    count = scans.place[np.cumsum(np.bincount(scans.profile, minlength=len(starts))) - 1] + 1
    with np.errstate(invalid="ignore", divide="ignore"):
        shown = count / (np.array([start.off_s for start in starts]) - begin)
        shown = np.where(np.isfinite(shown) & (shown > 0.0), shown, np.nan)
    rate = np.where(np.isfinite(rate), rate, shown)
    assumed = int(np.sum(np.isnan(rate) & np.isfinite(begin)))
    notes = ["scans carry no clock: times are the profiles' starts, start_offset_seconds and the sample rate"]
    if any(a.number != b.number for a, b in zip(scans.blocks, starts, strict=True) if np.isfinite(b.on_s)):
        notes.append("profiles and their starts in pressure_files have no common numbers and were matched in order")
    if assumed:
        notes.append(f"no file states the sample rate of {assumed} profiles: {USUAL_HZ:g} Hz was assumed")
    return begin, np.where(np.isfinite(rate), rate, USUAL_HZ), notes


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


# Pressure. E rows hold a time stamp, milliamperes, volts, decibars and more. C rows hold conductivity, temperature and
# decibars without a clock; they are spread evenly between switch-on and switch-off times, and used only far from
# samples with a clock. A table is CSV with a header line.


def read_companions(paths: Sequence[Path], layout: Layout = DEFAULT_LAYOUT) -> Companion:
    """Read the pressure of all files together.

    Raises:
        InputError: a file cannot be read or is of another kind.
    """
    series = [_read_file(path, layout) for path in paths]
    clocked = _merge([each for each in series if each.clocked])
    known = {start.number for start in clocked.starts} - {UNKNOWN}
    for k, each in enumerate(series):
        if not each.clocked:  # samples without a clock only fill gaps between those with one
            alone = clocked.distance_s(each.time_s) > 60.0
            starts = () if not alone.all() else tuple(start for start in each.starts if start.number not in known)
            series[k] = replace(each, time_s=each.time_s[alone], pressure_dbar=each.pressure_dbar[alone], starts=starts)
    return _merge(series)


def _merge(series: Sequence[Companion]) -> Companion:
    nothing = np.zeros(0)
    time = np.concatenate([nothing, *(each.time_s for each in series)])
    pressure = np.concatenate([nothing, *(each.pressure_dbar for each in series)])
    known = np.isfinite(time) & np.isfinite(pressure)
    time, first = np.unique(time[known], return_index=True)
    starts = sorted((start for each in series for start in each.starts), key=lambda start: start.on_s)
    notes = tuple(dict.fromkeys(note for each in series for note in each.notes))
    return Companion(time, pressure[known][first], tuple(starts), sum(each.damaged for each in series), notes)


def _read_file(path: Path, layout: Layout) -> Companion:
    data = read_bytes(path)
    try:
        head = find_head(path, lambda names: bool(_columns(names)), layout, delimiters=",;\t", must=True)
    except InputError:  # a binary file
        head = None
    if head:
        table = read_table(path, _columns(head.names), "correct the header", layout)
        time_s, pressure = table.columns["time"], table.columns["pressure"]
        number = np.full(table.rows, float(UNKNOWN))
        step = np.diff(time_s)
        new = np.append(True, step > _bridge(step))[: len(time_s)]  # start after a gap
        if "profile" in table.columns:
            number = table.columns["profile"]
            new = np.append(True, np.diff(number) != 0)[: len(number)]
        begins = np.flatnonzero(new & np.isfinite(number))
        starts = tuple(ProfileBlock(k, k, int(number[k]), on_s=float(time_s[k])) for k in begins.tolist())
        return Companion(time_s, pressure, starts, damaged=table.cut, notes=table_notes([table]))
    if not is_text(data):
        advice, known = "unpack the profiler's binary files with the maker's unpacker", detect_kind(path)
        raise InputError(str(path), expected=EXPECTED, found=known.name if known else "a binary file", advice=advice)
    text = parse(data, lambda form: form[1] > DBAR, path)
    if text.form is None:
        first = data.strip().split(b"\n")[0][:60].decode("latin-1").strip()
        shown = f"a first line {first!r}" if first else "an empty file"
        raise InputError(str(path), expected=EXPECTED, found=shown, advice="correct pressure_files")
    time_s, clocked = text.time_s, text.form[0]
    refuse_mostly_damaged(path, "rows of pressure", damaged=text.damaged - text.foreign, whole=len(time_s))
    if not clocked:
        if any(not block.off_s > block.on_s for block in text.blocks):
            expected, shown = "'turned on at' and 'turned off at' lines", "rows without a clock and no such lines"
            advice = "unpack with header lines, or give the engineering (E) files"
            raise InputError(str(path), expected=expected, found=shown, advice=advice)
        halves = [(block, np.arange(block.end - block.begin) + 0.5) for block in text.blocks]
        spread = [block.on_s + half * (block.off_s - block.on_s) / len(half) for block, half in halves]
        time_s = np.concatenate(spread)
    starts = tuple(
        block if np.isfinite(block.on_s) else replace(block, on_s=float(time_s[block.begin])) for block in text.blocks
    )
    # The profiler writes zeros before its first reading.
    pressure = np.where(text.values[:, DBAR] == 0, np.nan, text.values[:, DBAR])
    return Companion(time_s, pressure, starts, text.damaged, clocked=clocked)


def _columns(names: Sequence[str]) -> dict[str, str]:
    """Match the headers of a table to roles; empty if time or pressure is missing."""
    roles = match_roles(names) | match_roles(names, {"profile": "profile(?:_number)?"})
    if "time" not in roles and "clock" not in roles and "date" in roles:
        roles["time"] = roles["date"]
    wanted = ("time", "pressure", "profile") if "time" in roles else ("date", "clock", "pressure", "profile")
    columns = {role: roles[role] for role in wanted if role in roles}
    return columns if "pressure" in columns and {"time", "clock"} & {*columns} else {}


def _bridge(step: Floats, least_s: float = 60.0, steps: float = 5.0, most_s: float = 600.0) -> float:
    """Find the longest gap across which pressure is interpolated: some median steps within two bounds, seconds."""
    usual = float(np.median(step)) if len(step) else 0.0
    return min(max(least_s, steps * usual), most_s)
