"""Decode the velocity records of a Signature (ad2cp): averages, or bursts if there are no averages.

Only data format 3 is supported. Bottom track, fifth beam, altimeter and echo sounder are ignored and counted. Byte
offsets are relative to the contents of a record. The text records of the file hold the transformation matrices and the
configured declination. Source: Nortek, Integrators Guide AD2CP (2017), 6.1 and 6.6.
"""

from __future__ import annotations

import re
from enum import IntFlag
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers.files import MISSING_COUNT, block_type
from compasslib.readers.nortek import packets as records
from compasslib.readers.nortek.packets import SLANT_DEG, Coordinates, Packets, Places, Samples
from compasslib.readers.times import civil_seconds
from compasslib.records import BAD, GOOD, LEAST_PERCENT_GOOD, MISSING
from compasslib.types import Floats

BURST, AVERAGE, TEXT = 0x15, 0x16, 0xA0  # identifiers of the records


class Has(IntFlag):
    """Bits of the configuration: valid sensors, and blocks that follow the head."""

    PRESSURE = 1
    TEMPERATURE = 2
    COMPASS = 4
    TILT = 8
    VELOCITY = 32
    AMPLITUDE = 64
    CORRELATION = 128
    PERCENT_GOOD = 0x2000


ADVICE = "export its velocities, or give them as a table"
# Blocks between the profiles and percent good: bit and size in bytes (None: any; not in averages).
BLOCKS: tuple[tuple[int, int | None], ...] = ((0x0100, 8), (0x0400, 20), (0x0200, None), (0x0800, None), (0x1000, 64))
_HEAD = block_type(
    format=(0, "u1"), offset=(1, "u1"), configuration=(2, "<u2"), serial=(4, "<u4"), clock=(8, "6u1"),
    fraction=(14, "<u2"), temperature=(18, "<i2"), pressure=(20, "<u4"), heading=(24, "<u2"), pitch=(26, "<i2"),
    roll=(28, "<i2"), layout=(30, "<u2"), cell=(32, "<u2"), blanking=(34, "<u2"), battery=(38, "<u2"),
    magnetometer=(40, "3<i2"), scale=(58, "i1"), status=(68, "<u4"), ensemble=(72, "<u4"),
)  # fmt: skip
_SAME = (0, 1, 2, 3, 30, 31, 32, 33, 34, 35)  # offsets of bytes that are equal within one configuration


def decode(packets: Packets) -> Samples:
    """Decode the samples of a Signature.

    Raises:
        InputError: no velocities of data format 3, beam velocities without a matrix, or other than 3 or 4 beams.
    """
    at = np.flatnonzero(packets.kind == TEXT)
    texts = (packets.data[packets.begin[k] + 1 : packets.end[k]].tobytes().decode("latin-1") for k in at)
    text = "\n".join(texts)
    kind = next((kind for kind in (AVERAGE, BURST) if (packets.kind == kind).any()), None)
    if kind is None:
        there = ", ".join(f"{k:02X}" for k in np.unique(packets.kind).tolist())
        raise InputError(str(packets.path), expected="averages or bursts", found=f"records {there}", advice=ADVICE)
    mine = _most_frequent_configuration(packets, of_kind := np.flatnonzero(packets.kind == kind))
    rows = packets.rows(mine)
    head = np.ascontiguousarray(rows[:, : _HEAD.itemsize]).view(_HEAD)[:, 0]
    bits, holds, start = (int(head[name][0]) for name in ("layout", "configuration", "offset"))
    cells, coordinates, beams = bits & 1023, bits >> 10 & 3, bits >> 12
    counts_of = [name for name, bit in (("echo", Has.AMPLITUDE), ("correlation", Has.CORRELATION)) if holds & bit]
    places = [start + (2 + k) * beams * cells for k in range(len(counts_of) + 1)]  # behind the velocities
    fits = start >= _HEAD.itemsize and places[-1] <= rows.shape[1] and bool(holds & Has.VELOCITY)
    if head["format"][0] != 3 or beams not in (3, 4) or coordinates > 2 or not cells or not fits:
        expected = "velocities in data format 3 of three or four beams"
        shown = f"data format {head['format'][0]}, {beams} beams, {cells} cells"
        raise InputError(str(packets.path), expected=expected, found=shown, advice=ADVICE)
    counts = np.ascontiguousarray(rows[:, start : places[0]]).view("<i2").reshape(len(rows), beams, cells)
    raw = counts / 10.0 ** -head["scale"].astype(float)[:, None, None]
    raw[counts == MISSING_COUNT] = np.nan
    raw = np.moveaxis(raw, 1, 2)
    profiles = {name: records.by_beam(rows, at, beams, cells) for name, at in zip(counts_of, places, strict=False)}
    between = [size for bit, size in BLOCKS if holds & bit]
    if holds & Has.PERCENT_GOOD and None not in between:
        place = places[-1] + sum(size or 0 for size in between)
        profiles |= {"percent_good": rows[:, place : place + cells].copy()} if place + cells <= rows.shape[1] else {}
    axes = (
        np.eye(beams) if beams == 3 else np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.5, 0.5]])
    )  # two estimates of z
    name, matrix = "average" if kind == AVERAGE else "burst", None
    if coordinates == Coordinates.BEAM:
        section = "AVG" if kind == AVERAGE else "BURST"
        line = re.search(rf"^GETXF{section},ROWS={beams},COLS={beams},(.*)$", text, re.MULTILINE)
        elements = re.findall(r"M\d\d=(-?\d+\.\d+)", line[1] if line else "")
        if len(elements) != beams**2:
            expected = f"the matrix of its {beams} beams among the text records (GETXF{section})"
            advice = "take the instrument's own file from its first byte on"
            raise InputError(str(packets.path), expected=expected, found="none", advice=advice)
        matrix = (axes @ np.array(elements, dtype=float).reshape(beams, beams)).tolist()
    velocity = raw[..., :2] if coordinates == Coordinates.EARTH else raw
    if coordinates == Coordinates.INSTRUMENT:
        velocity = raw @ axes.T
    others = int(np.sum((packets.kind != kind) & (packets.kind != TEXT)))
    bad = np.zeros(velocity.shape[:2], dtype=bool)
    if "correlation" in profiles:
        bad |= profiles["correlation"].min(axis=2) < 50  # percent, recommended by Nortek
    if "percent_good" in profiles:
        bad |= profiles["percent_good"] < LEAST_PERCENT_GOOD
    flags = np.where(np.isnan(velocity).any(axis=-1), MISSING, np.where(bad, BAD, GOOD)).astype(np.int8)
    left_out = {"other_configurations": len(of_kind) - len(mine), "other_kinds": others}
    notes, file = list[str](), packets.path.name
    if "GETUSER," not in text:
        notes.append(f"{file}: its text does not tell whether a declination was set; declination_applied settles it.")
    if others:
        bursts = int(np.sum(packets.kind == BURST)) if kind == AVERAGE else 0
        of_bursts = f", {bursts} of them bursts," if bursts else ""
        notes.append(f"{file}: the {name}s were read; {others} records of other kinds{of_bursts} were passed over.")
    if left_out["other_configurations"]:
        count = left_out["other_configurations"]
        notes.append(f"{file}: {count} {name}s of another configuration than most were left out.")
    # Centimetres or millimetres.
    blanking = float(head["blanking"][0]) / (100.0 if head["status"][0] & 2 else 1000.0)
    return Samples(
        offset=packets.start[mine],
        **_sensors(head),
        velocity=velocity,
        quality=flags,
        bin_range_m=(blanking + float(head["cell"][0]) / 1000.0 * (1.0 + np.arange(cells))).tolist(),
        recorded=coordinates,
        beam_angle_deg=_setting(text, "BEAMCFGLIST", "THETA", SLANT_DEG),
        serial=str(head["serial"][0] or ""),
        model=next(iter(re.findall(r'^ID,.*?\bSTR="([^"]+)"', text, re.MULTILINE)), ""),
        declination_deg=_setting(text, "GETUSER", "DECL", 0.0),
        beams_to_axes=matrix,
        average_s=_setting(text, "GETAVG", "AI", 0.0) if kind == AVERAGE else 0.0,
        magnetometer=head["magnetometer"] * 1.0,
        up=raw[..., 2:].mean(axis=-1) if coordinates == Coordinates.EARTH else None,
        profiles=profiles,
        counts=left_out,
        notes=tuple(notes),
    )


def _setting(text: str, section: str, name: str, usual: float) -> float:
    match = re.search(rf"^{section},.*?\b{name}=(-?\d+\.?\d*)", text, re.MULTILINE)
    return float(match[1]) if match else usual


def _most_frequent_configuration(packets: Packets, at: Places) -> Places:
    size = packets.end[at] - packets.begin[at]
    long = at[size >= _HEAD.itemsize]
    if not len(long):
        raise InputError(str(packets.path), expected="velocity records", found="shorter ones", advice=ADVICE)
    same = packets.data[packets.begin[long][:, None] + np.array(_SAME)]
    key = np.column_stack([same, (packets.end[long] - packets.begin[long])[:, None].view(np.uint8)])
    _, which, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    return long[which.ravel() == count.argmax()]


def _sensors(head: Any) -> dict[str, Any]:
    valid = head["configuration"]
    year, month, day, *clock = head["clock"].astype(np.int64).T
    orientation = head["status"] >> 25 & 7  # 0 X up, 1 X down, 2 Y up, 3 Y down, 4 Z up, 5 Z down

    def known(bit: int, values: Any) -> Floats:
        return np.where((valid & bit) > 0, values, np.nan)

    heading = known(Has.COMPASS, head["heading"] / 100.0)
    heading = np.where(heading < 360.0, heading, np.nan)
    return {
        "time_s": civil_seconds(year + 1900, month + 1, day, *clock) + head["fraction"] / 10000.0,
        "heading_deg": heading,
        "heading_quality": np.where(np.isnan(heading), MISSING, GOOD).astype(np.int8),
        "pitch_deg": known(Has.TILT, head["pitch"] / 100.0),
        "roll_deg": known(Has.TILT, head["roll"] / 100.0),
        "pressure_dbar": known(Has.PRESSURE, head["pressure"] / 1000.0),
        "temperature_c": known(Has.TEMPERATURE, head["temperature"] / 100.0),
        "supply_voltage": head["battery"] / 10.0,
        "looks_up": orientation != 5,
        "sideways": orientation < 4,
    }
