"""Nortek's current meters and profilers: Aquadopp, Aquadopp profiler, AWAC (aqd, prf, wpr) and Signature (ad2cp).

Damage is left out and counted, never guessed: a flipped byte costs one sample. Velocities along beams or axes are
turned to the earth by the recorded heading, pitch and roll: x is where the heading points, y is port and z up on an
up-looker; y and z point the other way on a down-looker. Source: Nortek, transformation of coordinates (Xform.m).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers.files import ESCAPES_UNDONE
from compasslib.readers.nortek import aquadopp, signature
from compasslib.readers.nortek.packets import BEAM, EARTH, Packets, Samples, find_packets
from compasslib.readers.pd0.checks import ADVICE, FEW_DISAGREE, RANGES_SHOWN, match_serial_number, refuse_rotation
from compasslib.readers.times import describe_averages
from compasslib.records import MAGNETOMETER, MISSING, Record, take
from compasslib.types import Bools, Floats


def read(
    paths: Sequence[Path],
    *,
    orientation: str | None = None,
    declination_applied: float | Mapping[str, float] | None = None,
    serial_number: str | None = None,
) -> Record:
    """Read one record from files in order of their first times, currents turned by the recorded magnetic heading.

    Args:
        orientation: up or down; counts where samples disagree. Each sample's own word where None.
        declination_applied: degrees inside the recorded headings and earth velocities, instead of what the file tells.
        serial_number: the instrument's by the metadata, perhaps with letters around its digits.

    Raises:
        InputError: a file that cannot be read or holds no velocities, files that do not belong together, an instrument
            that lay on its side, or a serial number of another.
    """
    if not paths:
        expected, advice = "at least one Nortek file", "name the instrument's files"
        raise InputError("files", expected=expected, found="none", advice=advice)
    files = sorted((_read_file(path) for path in paths), key=lambda each: float(each[1].time_s[0]))
    where = ", ".join(str(path) for path in paths)
    whole = _concatenate(where, [samples for _, samples in files])
    serial = match_serial_number(where, whole.serial, serial_number)
    lying = int(whole.sideways.sum())
    if orientation is None and lying > FEW_DISAGREE * len(whole.sideways):
        shown = f"an instrument on its side by its own word in {lying} of {len(whole.sideways)} samples"
        expected, advice = "one that looks up or down", "give orientation: up or down"
        raise InputError(where, expected=expected, found=shown, advice=advice)
    stated = parse_applied_declination(declination_applied)
    inside = AppliedDeclination(whole.declination_deg, whole.declination_deg) if stated is None else stated
    refuse_rotation(where, inside, is_earth=whole.up is not None)
    looks_up = whole.looks_up if orientation is None else np.full(len(whole.time_s), orientation == "up")
    heading = angles.wrap360(whole.heading_deg - inside.heading)
    east, north, upward = _turn_to_earth(whole, heading, looks_up, inside.velocity)
    up = bool(np.mean(looks_up) > 0.5)
    counts = whole.counts | {
        "samples": len(heading),
        "records": sum(len(packets.kind) for packets, _ in files),
        "damaged": sum(packets.damaged for packets, _ in files),
        "bytes_skipped": sum(packets.bytes_skipped for packets, _ in files),
        "bytes_total": sum(packets.data.size for packets, _ in files),
        "orientation_disagrees": int(np.sum(whole.looks_up != up)),
        "heading_missing": int(np.isnan(heading).sum()),
    }
    field = {} if whole.magnetometer is None else dict(zip(MAGNETOMETER, whole.magnetometer.T, strict=True))
    return Record(
        time_s=whole.time_s,
        east=east,
        north=north,
        bin_range_m=np.broadcast_to(np.array(whole.bin_range_m), east.shape),
        heading_deg=heading,
        pitch_deg=whole.pitch_deg,
        roll_deg=whole.roll_deg,
        pressure_dbar=whole.pressure_dbar,
        depth_m=np.full(len(heading), np.nan),
        temperature_c=whole.temperature_c,
        supply_voltage=whole.supply_voltage,
        quality=np.where(np.isnan(east + north), MISSING, whole.quality).astype(np.int8),
        heading_quality=np.where(np.isnan(heading), MISSING, whole.heading_quality).astype(np.int8),
        looks_up=up,
        beam_angle_deg=whole.beam_angle_deg,
        heading_bias_deg=inside.heading,
        velocity_bias_deg=inside.heading if whole.up is None else inside.velocity,
        serial_number=serial,
        profiles={"up": upward.astype(np.float32), **whole.profiles},
        recorded_in={EARTH: "earth", BEAM: "beam"}.get(whole.recorded, "instrument"),
        channels=field,
        channel_units=dict.fromkeys(field, "count"),
        counts=counts,
        warnings=(*_describe_files(files), *_describe_settings(whole, counts, stated, up)),
    )


def _read_file(path: Path) -> tuple[Packets, Samples]:
    packets = find_packets(path)
    samples = signature.decode(packets) if packets.signature else aquadopp.decode(packets)
    dated = np.isfinite(samples.time_s)
    if not dated.any():
        advice = "check that format: nortek and the file belong together"
        shown = f"{len(dated)} with impossible dates"
        raise InputError(str(path), expected="samples with velocities", found=shown, advice=advice)
    good = samples if dated.all() else take(samples, dated)
    # Samples that are missing where bytes were skipped, by the steps of time across.
    steps = np.diff(good.time_s)
    after = np.searchsorted(good.offset, [first for first, _ in packets.skipped])
    across = steps[np.unique(after[(after > 0) & (after < len(good.offset))]) - 1]
    usual = float(np.median(steps)) if len(steps) else 0.0
    lost = int(np.maximum(np.rint(across / usual) - 1, 0).sum()) if usual > 0.0 else 0
    return packets, replace(good, counts=samples.counts | {"bad_dates": int(np.sum(~dated)), "lost": lost})


def _concatenate(where: str, parts: Sequence[Samples]) -> Samples:
    first = parts[0]
    for other in parts[1:]:
        for name in ("serial", "recorded", "bin_range_m", "beam_angle_deg", "declination_deg"):
            if getattr(other, name) != getattr(first, name):
                expected, shown = "files of one instrument in one configuration", f"files that differ in {name}"
                raise InputError(where, expected=expected, found=shown, advice=ADVICE)
    columns = [name for name, value in vars(first).items() if isinstance(value, np.ndarray)]
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in columns}
    alike = [name for name in first.profiles if all(name in part.profiles for part in parts)]
    joined["profiles"] = {name: np.concatenate([part.profiles[name] for part in parts]) for name in alike}
    notes = tuple(note for part in parts for note in part.notes)
    counts = {name: sum(part.counts[name] for part in parts) for name in first.counts}
    return replace(first, **joined, notes=notes, counts=counts) if len(parts) > 1 else first


def _turn_to_earth(
    whole: Samples, heading_deg: Floats, looks_up: Bools, applied_deg: float
) -> tuple[Floats, Floats, Floats]:
    """Turn velocities to (east, north, up), (n, m) m/s to magnetic north; those of the earth by the applied degrees."""
    if whole.up is not None:
        east, north = whole.velocity[..., 0], whole.velocity[..., 1]
        return *(angles.turn(east, north, -applied_deg) if applied_deg else (east, north)), whole.up
    side = np.where(looks_up, -1.0, 1.0)[:, None]
    x, y, z = np.moveaxis(whole.velocity, -1, 0)
    level = compass.levelling(whole.pitch_deg, whole.roll_deg)  # of forward, starboard and down
    forward, starboard, down = np.moveaxis(level @ np.stack([x, side * y, side * z], axis=1), 1, 0)
    return *angles.turn(starboard, forward, heading_deg[:, None]), -down


def _describe_files(files: Sequence[tuple[Packets, Samples]]) -> Iterator[str]:
    for packets, samples in files:
        name, counts = packets.path.name, samples.counts
        if packets.escaped:
            yield f"{name} {ESCAPES_UNDONE}; places are those of the bytes after that."
        if packets.skipped:
            yield (
                f"{name}: {packets.bytes_skipped} of {packets.data.size} bytes belong to no good record and were "
                f"skipped; {packets.damaged} places in them begin like a record and fail its checksum, and by their "
                f"times {counts['lost']} samples are lost."
            )
            shown = [f"{first} to {last}" for first, last in packets.skipped[:RANGES_SHOWN]]
            more = len(packets.skipped) - len(shown)
            yield f"{name}: skipped bytes {', '.join(shown)}{f' and {more} more ranges' if more else ''}."
        if counts["bad_dates"]:
            yield f"{name}: {counts['bad_dates']} good samples have an impossible date and were left out."
        yield from samples.notes


def _describe_settings(
    whole: Samples, counts: dict[str, int], stated: AppliedDeclination | None, up: bool
) -> Iterator[str]:
    n = len(whole.time_s)
    if stated is None and whole.declination_deg:
        yield f"The declination of {whole.declination_deg:g} degrees that was set was taken out of the headings."
    elif stated is not None and {*stated} != {whole.declination_deg}:
        says = f"the file tells {whole.declination_deg:g}" if whole.declination_deg else "the file tells none"
        yield f"declination_applied of {stated} degrees was taken out of the headings; {says}."
    if counts["orientation_disagrees"] > FEW_DISAGREE * n:
        word, other = ("up", "down") if up else ("down", "up")
        effect = " though its velocities are turned already" if whole.recorded == EARTH else ""
        yield f"{counts['orientation_disagrees']} of {n} samples say that it looked {other}; {word} counts{effect}."
    if counts["heading_missing"]:
        yield f"{counts['heading_missing']} of {n} samples have no valid heading."
    yield from describe_averages(whole.average_s, whole.time_s)
