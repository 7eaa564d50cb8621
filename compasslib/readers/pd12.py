"""Read RDI PD12, the short ensembles that an ADCP transmits through a modem, with any framing of the modem.

An ensemble begins with 6E 7F and ends with the sum of its bytes; bytes between ensembles (modem frames, data of other
instruments, a controller's log) are skipped. A controller of inductive modems escapes 2B as 18 6B and 18 as 18 58: an
ensemble with an invalid checksum is tried again without these escapes. Coordinates, heading bias, orientation and bin
distances are not in the file. Source: RDI, WorkHorse Commands and Output Data Format, PD12; the escapes were found in
a genuine file, where their removal makes two of three checksums valid.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.files import refuse_large_arrays, refuse_mostly_damaged
from compasslib.readers.pd0.currents import true_pitch
from compasslib.readers.pd0.fields import LAST_YEAR, from_hundredths
from compasslib.readers.times import civil_seconds
from compasslib.records import Record, new_record

MARK = b"\x6e\x7f"
HEADER = np.dtype(
    [
        *(("id", "<u2"), ("bytes", "<u2"), ("number", "<u4"), ("unit", "u1"), ("version", "u1"), ("revision", "u1")),
        *(("year", "<u2"), ("month", "u1"), ("day", "u1"), ("hour", "u1"), ("minute", "u1"), ("second", "u1")),
        *(("hundredths", "u1"), ("heading", "<u2"), ("pitch", "<i2"), ("roll", "<i2"), ("temperature", "<i2")),
        *(("pressure", "<i4"), ("components", "u1"), ("first", "u1"), ("bins", "u1")),
    ]
)
FOUR = 0x0F  # components: one bit each for east, north, up and error; the high half is the interval of bins sent
LONGEST = HEADER.itemsize + 2 * 4 * 255 + 2  # bytes including the checksum
BEAM_ANGLE_DEG = 20.0  # of every WorkHorse and Long Ranger
COORDINATES = (
    "PD12 tells neither coordinates nor heading bias: velocities were taken as east and north by the recorded heading, "
    "without a bias but for declination_applied."
)


def read(paths: Sequence[Path], *, orientation: str, bin_size: float, first_bin: float) -> Record:
    """Read the ensembles of one instrument from files sorted by their first ensemble, without repetitions.

    Args:
        bin_size: distance between adjacent transmitted bins, metres.
        first_bin: distance from the transducer to the middle of the first transmitted bin, metres.

    Raises:
        InputError: a file cannot be read, no intact ensemble is found, or ensembles lack some of the four components.
    """
    where = ", ".join(map(str, paths))
    frames, counts = _frames(paths)
    heads = np.frombuffer(b"".join(frame[: HEADER.itemsize] for frame in frames), HEADER)
    if not len(heads):
        shown = f"{counts['damaged']} that are damaged" if counts["damaged"] else ""
        raise files.foreign(paths[0], "PD12 ensembles (6E 7F) with their checksum", "pd12", shown)
    if (partial := (heads["components"] & FOUR) != FOUR).any():
        shown = f"components {int(heads['components'][partial][0] & FOUR):04b} in {int(partial.sum())} ensembles"
        advice = "take the instrument's own recording, format: pd0"
        raise InputError(where, expected="all four velocities (command PO 1111)", found=shown, advice=advice)
    names = ("year", "month", "day", "hour", "minute", "second", "hundredths")
    time_s = civil_seconds(*(heads[name].astype(np.int64) for name in names), last_year=LAST_YEAR)
    dated = np.isfinite(time_s)
    frames, heads, time_s = [f for f, d in zip(frames, dated, strict=True) if d], heads[dated], time_s[dated]
    widest = int(heads["bins"].max(initial=1))
    refuse_large_arrays(where, 4 * 8 * len(heads) * widest, counts["bytes_total"], widest)
    # Velocities by component, (4, n, m) m/s, with missing bins padded by NaN.
    flow = np.full((4, len(heads), widest), np.nan)
    for bins in np.unique(heads["bins"]):
        mine = heads["bins"] == bins
        sent = b"".join(frames[k][HEADER.itemsize :] for k in np.flatnonzero(mine))
        components = np.moveaxis(np.frombuffer(sent, "<i2").reshape(-1, 4, bins), 1, 0)
        flow[:, mine, :bins] = np.where(components == files.MISSING_COUNT, np.nan, components / 1000.0)
    east, north, up, error = flow
    steps = np.diff(np.unique(heads["number"].astype(np.int64)))
    missing = int((np.maximum(steps // (int(np.median(steps)) if len(steps) else 1), 1) - 1).sum())
    counts |= {"bad_dates": int(np.sum(~dated)), "ensembles": len(heads), "lost": missing}
    whole = counts["ensembles"] + counts["repeated"] + counts["bad_dates"]
    losses = {
        "escaped": f"of {whole} ensembles came with the modem's escapes, which were undone.",
        "damaged": "places begin like a PD12 ensemble and fail its checksum; they were left out.",
        "lost": "ensembles are missing by their numbers.",
        "repeated": "ensembles were sent more than once; each counts once.",
        "bad_dates": "ensembles have an impossible date and were left out.",
    }
    lost = [f"{counts[key]} {text}" for key, text in losses.items() if counts[key]]
    heading = np.where(heads["heading"] < 36000, heads["heading"] / 100.0, np.nan)
    pitch, roll = from_hundredths(heads["pitch"]), from_hundredths(heads["roll"])
    # Shift the bin distances of ensembles that start at a later bin.
    bins = east.shape[1]
    stride = np.maximum(heads["components"] >> 4, 1)
    later = (heads["first"] - heads["first"].min(initial=255).astype(int)) / stride
    return new_record(
        time_s,
        east,
        north,
        bin_range_m=(first_bin + bin_size * (later[:, None] + np.arange(bins))),
        heading_deg=heading,
        pitch_deg=true_pitch(pitch, roll),
        roll_deg=roll,
        pressure_dbar=heads["pressure"] / 1000.0,
        temperature_c=from_hundredths(heads["temperature"]),
        looks_up=orientation == "up",
        beam_angle_deg=BEAM_ANGLE_DEG,
        profiles={"up": up.astype(np.float32), "error_velocity": error.astype(np.float32)},
        counts=counts,
        warnings=(COORDINATES, *lost),
    )


def _frames(paths: Sequence[Path]) -> tuple[list[bytes], dict[str, int]]:
    """Find the intact ensembles, with files in order of their first number, and count all other content."""
    by_file = []
    counts = dict.fromkeys(("bytes_total", "bytes_skipped", "damaged", "escaped"), 0)
    for path in paths:
        data, whole, damaged, failed, end = files.read_bytes(path), list[bytes](), 0, 0, 0
        for mark in re.finditer(MARK, data):
            start = mark.start()
            if start < end:
                continue
            frame = plain = _whole(data[start : start + LONGEST])
            if not frame:
                frame = _whole(files.unescape(data[start : start + 2 * LONGEST]))
                counts["escaped"] += bool(frame)
            if frame:
                whole.append(frame)
                end = start + len(frame)
            damaged += not frame
            failed += not frame and (plain, frame) != (None, None)  # otherwise the mark occurs by chance
        counts["bytes_total"] += len(data)
        counts["bytes_skipped"] += len(data) - sum(len(frame) + 2 for frame in whole)
        counts["damaged"] += damaged
        refuse_mostly_damaged(path, "PD12 ensembles", damaged=failed, whole=len(whole))
        by_file.append(whole)
    by_file.sort(key=lambda frames: int.from_bytes(frames[0][4:8], "little") if frames else 0)
    frames = [frame for whole in by_file for frame in whole]
    once = list(dict.fromkeys(frames))  # a controller resends on request
    return once, counts | {"repeated": len(frames) - len(once)}


def _whole(data: bytes) -> bytes | None:
    """Extract the ensemble at the beginning without its checksum; empty if that is invalid, None without a header.

    The length in a header agrees with its bins and components.
    """
    size = int.from_bytes(data[2:4], "little")
    if not HEADER.itemsize <= size <= len(data) - 2:
        return None
    *_, components, _, bins = np.frombuffer(data, HEADER, 1)[0].item()
    if size != HEADER.itemsize + 2 * bins * (components & FOUR).bit_count():
        return None
    return data[:size] if sum(data[:size]) & 0xFFFF == int.from_bytes(data[size : size + 2], "little") else b""
