"""Preparation of a decoded record: clock, deployment period, depth, exclusions, covariates.

Only samples outside the deployment, repeated or without a valid time are removed; unusable values are flagged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError
from compasslib.preparation.clocks import check_coverage, find_valid_times, same_samples
from compasslib.preparation.quality import MASKS, Thresholds, flag_quality, flag_velocities
from compasslib.readers import table
from compasslib.records import BAD, MAGNETOMETER, MISSING, Record, take
from compasslib.types import Floats


def apply_deployment(
    record: Record,
    *,
    start_s: float,
    end_s: float,
    water_depth: float,
    latitude: float,
    nominal_depth: float | None,
    depth_named: bool = False,
    direction_reference: str = "magnetic",
    pressure_offset: float = 0.0,
    clock_offset_seconds: float = 0.0,
    clock_drift_seconds: float = 0.0,
    declination_applied: float | Mapping[str, float] = 0.0,
    exclude: Sequence[tuple[float, float]] = (),
    flags_by_hand: Sequence[Mapping[str, Any]] = (),
    affected: bool = False,
    quality: Mapping[str, Any] | None = None,
) -> Record:
    """Cut the record to the deployment, convert times to UTC, determine the depth, and flag unusable values.

    Args:
        nominal_depth: depth of the transducer by the metadata, metres.
        depth_named: whether the metadata name a column of depths, which counts even if it is constant.
        direction_reference: ``magnetic`` or ``true``, what the export's directions refer to.
        clock_offset_seconds: instrument clock minus UTC at start.
        declination_applied: degrees, contained in all directions of the export or in ``heading`` and ``velocity``.
        exclude: periods (from, to) known to be bad, UTC seconds.
        flags_by_hand: a person's flags, which replace all others: ``from_s``, ``to_s``, ``depths`` [from, to] or None
            for all, m, and ``flag``.
        quality: fields of ``quality.Thresholds`` that differ from the defaults.
    """
    time_s = to_utc(record.time_s, (start_s, end_s), clock_offset_seconds, clock_drift_seconds)
    pressure = record.pressure_dbar - pressure_offset
    followed = f"clock_offset_seconds: {clock_offset_seconds:g} moves it there"
    warnings = tuple(text for text in record.warnings if followed not in text)
    record = replace(
        record, time_s=time_s, direction_reference=direction_reference, pressure_dbar=pressure, warnings=warnings
    )
    record = _inside(record, start_s, end_s)
    profiles = {name: profile[:] for name, profile in record.profiles.items()}
    measured = {
        name: x
        for name, x in profiles.items()
        if (np.isfinite(x).any() if x.dtype.kind == "f" else x.max(initial=0) > 0)
    }
    inside = parse_applied_declination(declination_applied) or AppliedDeclination(0.0, 0.0)
    east, north, heading = record.east, record.north, record.heading_deg
    if inside.velocity:
        east, north = angles.turn(east, north, -inside.velocity)
    if inside.heading:
        heading = np.where(np.isfinite(heading), angles.wrap360(heading - inside.heading), np.nan)
    depth, source = _depth(record, nominal_depth, latitude, depth_named)
    notes = _depth_warnings(record.depth_m, depth, source, nominal_depth, water_depth)
    record = replace(
        record,
        profiles=measured,
        east=east,
        north=north,
        heading_deg=heading,
        depth_m=depth,
        warnings=(*record.warnings, *notes),
        quality=np.where(np.isfinite(east) & np.isfinite(north), record.quality, MISSING).astype(np.int8),
    )
    record = flag_quality(record, water_depth, affected=affected, thresholds=Thresholds(**(quality or {})))
    bad = np.zeros(len(record.time_s), dtype=bool)
    for begin, end in exclude:
        bad |= (record.time_s >= begin) & (record.time_s <= end)
    record = flag_velocities(record, bad[:, None], "excluded")
    record = replace(record, heading_quality=np.where(bad, BAD, record.heading_quality).astype(np.int8))
    if not flags_by_hand:
        return replace(record, counts=record.counts | {"flagged_by_hand": 0})
    flags, tests, missed = record.quality.copy(), np.array(record.tests), []
    for by_hand in flags_by_hand:
        within = (record.time_s >= by_hand["from_s"]) & (record.time_s <= by_hand["to_s"])
        low, high = by_hand["depths"] or (-np.inf, np.inf)
        here = within[:, None] & (record.bin_depth_m() >= low) & (record.bin_depth_m() <= high) & (flags != MISSING)
        if not here.any():
            ends = " to ".join(np.array([by_hand["from_s"], by_hand["to_s"]]).astype("datetime64[s]").astype(str))
            missed.append(f"flags_by_hand of {ends}: no velocity is within these times and depths")
        flags[here], tests[here] = by_hand["flag"], tests[here] | MASKS["flagged_by_hand"]
    counts = record.counts | {"flagged_by_hand": int(np.sum(tests & MASKS["flagged_by_hand"] > 0))}
    return replace(record, quality=flags, tests=tests, counts=counts, warnings=(*record.warnings, *missed))


def follow_neighbour(
    record: Record, time_s: Floats, depth_m: Floats, *, depths_m: Sequence[float], water_depth: float, name: str
) -> Record:
    """Set the depth of an instrument without pressure from that of a neighbour on the same wire.

    On a straight wire that leans, each point dips in proportion to its length above the anchor. Samples outside the
    neighbour's record have the depth at its nearer end, which is told.

    Args:
        depths_m: nominal depths of the instrument and of the neighbour.

    Raises:
        InputError: the neighbour has no depth that varies.
    """
    nominal_m, neighbour_m = depths_m
    known = np.isfinite(depth_m)
    if not _varies(depth_m):
        advice = "name another instrument, or delete depth_from"
        raise InputError(f"depth_from: {name}", expected="a pressure that varies", found="none", advice=advice)
    dip = np.interp(record.time_s, time_s[known], depth_m[known]) - neighbour_m
    outside = np.sum((record.time_s < time_s[known][0]) | (record.time_s > time_s[known][-1]))
    along_m = neighbour_m - nominal_m
    note = f"depth by the pressure of {name}, {along_m:+.4g} m along the wire; {outside} samples outside its record"
    depth_m = nominal_m + dip * (water_depth - nominal_m) / (water_depth - neighbour_m)
    return replace(record, depth_m=depth_m, warnings=(*record.warnings, note))


def to_utc(time_s: Floats, deployed: tuple[float, float], offset_s: float, drift_s: float) -> Floats:
    """Convert times by a clock that is ``offset_s`` ahead of UTC at the start and ``drift_s`` more at the end."""
    start_s, end_s = deployed
    return time_s - offset_s - drift_s * np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0)


def describe_record(name: str, role: str, record: Record) -> str:
    """Compose the log line of the job that reads the instrument in ``role``."""
    counted = ", ".join(f"{key} {number}" for key, number in record.counts.items() if number)
    line = f"{name} {role}: {record.east.shape[0]} samples of {record.east.shape[1]} bins ({counted})"
    return "\n".join([line, *(f"{name} {role}: warning: {warning}" for warning in record.warnings)])


def _inside(record: Record, start_s: float, end_s: float) -> Record:
    """Cut to the deployment: valid times only, in order, one sample per time."""
    valid, invalid_counts, notes = find_valid_times(record)
    inside = valid & (record.time_s >= start_s) & (record.time_s <= end_s)
    there = place = np.flatnonzero(inside)
    order = there[np.argsort(record.time_s[there], kind="stable")]
    again = np.flatnonzero(np.diff(record.time_s[order]) == 0.0)
    if again.size:  # samples with the same time and values as another, as where two downloads overlap
        later, before = order[again + 1], order[again]
        place = there[~np.isin(there, later[same_samples(record, later, before)])]
    back_s = record.time_s[place][:-1][np.diff(record.time_s[place]) < 0]
    backwards = len(back_s)
    place = place[np.argsort(record.time_s[place], kind="stable")]
    first = np.append(True, np.diff(record.time_s[place]) > 0)[: len(place)]
    repeated = int(np.sum(~first))
    outside = {"outside_deployment": int(np.sum(valid & ~inside))}
    counts = record.counts | outside | invalid_counts | {"time_backwards": backwards}
    counts["time_repeated"] = len(there) - int(first.sum())
    notes += check_coverage(record.time_s[valid], inside[valid], start_s, end_s)
    if backwards:
        first_at = str(back_s[:1].astype("datetime64[s]")[0])
        notes.append(f"the clock goes backwards {backwards} times, first after {first_at}: samples were put in order")
    if repeated:
        notes.append(f"{repeated} samples repeat a time and were left out")
    place = place[first]
    unbroken = len(place) > 0 and place[-1] - place[0] == len(place) - 1
    which = slice(int(place[0]), int(place[-1]) + 1) if unbroken and (np.diff(place) == 1).all() else place
    # A slice avoids copying years of samples.
    return replace(take(record, which), counts=counts, warnings=(*record.warnings, *notes))


def _depth(record: Record, nominal: float | None, latitude: float, named: bool) -> tuple[Floats, str]:
    """Compute depth from pressure if that varies, else from the depth field if that varies, else from the metadata.

    A column of depths that the metadata name counts where it is constant too, if below the surface. A table of profiles
    gives the depth of its first bin (no profiler measures at its own transducer); the nominal depth would shift all
    bins. Missing depths are interpolated, as a sphere moves slowly.
    """
    several = record.bin_range_m.shape[1] > 1 and bool((record.bin_range_m[:, 0] == 0.0).all())
    by_pressure, of_bins = _varies(record.pressure_dbar), several and bool(np.isfinite(record.depth_m).all())
    by_field, stated = _varies(record.depth_m) or of_bins, named and _usual(record.depth_m) > 0.0
    if not by_pressure and not by_field and not stated and nominal is not None:
        return np.full(record.time_s.shape, float(nominal)), "metadata"
    depth = depth_of_pressure(record.pressure_dbar, latitude) if by_pressure else record.depth_m
    known, position = np.isfinite(depth), np.arange(depth.size)
    filled = np.interp(position, position[known], depth[known]) if known.any() else depth.copy()
    return filled, "pressure" if by_pressure else "depth field" if by_field else "column of depths"


def depth_of_pressure(pressure_dbar: Floats, latitude: float) -> Floats:
    """Convert pressure to depth, m, by TEOS-10; NaN where it is missing."""
    import gsw  # takes 0.1 s, needed only with a pressure sensor

    return np.asarray(-gsw.z_from_p(pressure_dbar, latitude))


def _varies(x: Floats) -> bool:
    """Check whether a depth varies (5th to 95th percentile) by more than a setting rounded in different ways."""
    finite = x[np.isfinite(x)]
    return finite.size > 1 and float(np.ptp(np.percentile(finite, [5, 95]))) > 0.2


def _depth_warnings(given: Floats, depth: Floats, source: str, nominal: float | None, water_depth: float) -> list[str]:
    """Compose warnings about an implausible depth, and about a depth in the file that was not used."""
    notes = []
    slack = np.inf if nominal is None else max(10.0, 0.2 * nominal)
    if np.isfinite(depth).any():
        shallow, deepest = float(np.nanpercentile(depth, 5)), float(np.nanmax(depth))
        if source != "metadata" and nominal is not None and abs(shallow - nominal) > slack:
            notes.append(f"depth by the {source} starts at {shallow:.0f} m, the metadata say {nominal:.0f} m")
        if deepest > 1.05 * water_depth:
            notes.append(f"depth by the {source} reaches {deepest:.0f} m, below the bottom at {water_depth:.0f} m")
    usual, advice = _usual(given), "correct whichever is wrong"
    if source == "metadata" and nominal is not None and usual > 0.0 and abs(usual - nominal) > slack:
        unused = f"the file's depth of {usual:.0f} m never varies and was not used"
        notes.append(f"{unused}; the metadata say {nominal:.0f} m: {advice}")
    if source == "column of depths" and nominal is not None and 1.0 < abs(usual - nominal) <= slack:
        notes.append(f"depth by the {source} is {usual:.1f} m throughout, the metadata say {nominal:.1f} m: {advice}")
    return notes


def _usual(depth_m: Floats) -> float:
    known = depth_m[np.isfinite(depth_m)]
    return float(np.median(known)) if known.size else 0.0


def add_covariates(record: Record, series: Mapping[str, Mapping[str, Any]]) -> Record:
    """Interpolate covariates from tables to the record's times, NaN outside their coverage.

    Raises:
        InputError: a table cannot be read, or has no value at the record's times.
    """
    channels, units, warnings = {**record.channels}, {**record.channel_units}, [*record.warnings]
    for name, settings in series.items():
        time_s, value, notes = table.read_series(settings)
        at = np.full(len(record.time_s), np.nan)
        if len(time_s) > 1:  # NaN outside its coverage and in gaps longer than three median steps
            steps, after = np.diff(time_s), np.clip(np.searchsorted(time_s, record.time_s), 1, len(time_s) - 1)
            inside = (record.time_s >= time_s[0]) & (record.time_s <= time_s[-1])
            inside &= steps[after - 1] <= 3.0 * np.median(steps)
            at[inside] = np.interp(record.time_s[inside], time_s, value)
        if len(at) and not np.isfinite(at).any():
            span = " to ".join(str(np.datetime64(int(t), "s")) for t in time_s[[0, -1]])
            expected = f"values of {name} while the mooring was deployed"
            advice = "check times and columns, or delete the covariate"
            raise InputError(", ".join(settings["files"]), expected=expected, found=span, advice=advice)
        channels[name], units[name] = at, str(settings["unit"] or "1")
        warnings += [f"{name}: {note}" for note in notes]
    return replace(record, channels=channels, channel_units=units, warnings=tuple(warnings))


def add_field_strength(record: Record) -> Record:
    """Add the change of the total field strength, percent, if the instrument logged its magnetometer.

    The part that varies with heading, twice the heading or tilt is removed: it is due to iron and scale errors, which
    the fit of the headings includes. The three components are not used by themselves, as they repeat the heading.
    """
    if not set(MAGNETOMETER) <= set(record.channels):
        return record
    size = np.linalg.norm([record.channels[axis] for axis in MAGNETOMETER], axis=0)
    waves = [wave for k in (1.0, 2.0) for wave in angles.sin_cos(k * record.heading_deg)]
    columns = np.column_stack([np.ones(len(size)), *waves, record.pitch_deg, record.roll_deg])
    known = np.isfinite(size + columns.sum(axis=1))
    if known.sum() < 100 or not np.any(size[known]):
        return record
    percent = 100.0 * size / np.median(size[known])
    fitted = columns @ np.linalg.lstsq(columns[known], percent[known], rcond=None)[0]
    percent = np.where(known, percent - fitted, np.nan)
    note = (
        f"Beyond what follows heading and tilt, its own magnetometer saw the field's strength change by "
        f"{np.nanstd(percent):.2f} % rms; the search looks along it for effects."
    )
    return replace(
        record,
        channels={**record.channels, "field_strength": percent},
        channel_units={**record.channel_units, "field_strength": "percent"},
        warnings=(*record.warnings, note),
    )
