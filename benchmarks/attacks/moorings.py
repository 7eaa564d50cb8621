"""Mistakes in metadata, clocks, tables and PD0 files of a mooring, and harmless changes of them.

Each attack draws its numbers, modifies the cruise, and returns a description; it raises NotApplicableError if it
cannot be applied to a base.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
import pandas as pd
import yaml
from cruises import FIXED, HOUR_S, VARIABLE, Attack, Cruise, NotApplicableError, Pd0, stamps
from local import log_heading

FLOW = ["u_cm_s", "v_cm_s"]
CLOCK_HOURS = (0.5, 1, 2, 3, 6, 10, 12, 14, 18, 24, 30, 36, 48, 72, 168, 720)


def sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def later(settings: dict[str, Any], key: str, days: float) -> None:
    moved = pd.Timestamp(str(settings[key])).tz_convert("UTC") + pd.Timedelta(days=days)
    settings[key] = moved.strftime("%Y-%m-%dT%H:%M:%SZ")


# Metadata


def declination(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.true_north, cruise.undecidable = True, True
    cruise.settings["declination"] = float(rng.choice([-16.0, 17.5, 170.0, -40.0, 8.0, 0.0]))
    return f"declination: {cruise.settings['declination']}"


def years_off(cruise: Cruise, rng: np.random.Generator) -> str:
    days = float(rng.choice([-366, 365, 31, -31, 120]))
    for key in ("start", "end"):
        later(cruise.settings, key, days)
    return f"start and end {days:+.0f} days"


def upside_down(cruise: Cruise, rng: np.random.Generator) -> str:
    role = str(rng.choice(["top", "deep"]))
    instrument = cruise.settings["instruments"][role]
    if "orientation" not in instrument:
        role, instrument = "top", cruise.top
    if "orientation" not in instrument:
        raise NotApplicableError
    instrument["orientation"] = {"up": "down", "down": "up"}[instrument["orientation"]]
    return f"{role}: orientation {instrument['orientation']}"


def wrong_depth(cruise: Cruise, rng: np.random.Generator) -> str:
    role, off = str(rng.choice(["top", "deep"])), float(rng.choice([-40, 30, 90]))
    depth = float(cruise.settings["instruments"][role].get("depth", 100)) + off
    cruise.settings["instruments"][role]["depth"] = min(max(depth, 0.0), float(cruise.settings["water_depth"]))
    return f"{role}: depth {off:+.0f} m"


def wrong_bottom(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.settings["water_depth"] = float(cruise.settings["water_depth"]) * float(rng.choice([0.6, 1.8, 3.28]))
    return f"water_depth: {cruise.settings['water_depth']:.0f}"


def exchanged_roles(cruise: Cruise, rng: np.random.Generator) -> str:
    if cruise.deep["format"] == "table":
        raise NotApplicableError
    top, deep = cruise.top, cruise.deep
    top["files"], deep["files"] = deep["files"], top["files"]
    return "the two PD0 files exchanged"


def told_clock(cruise: Cruise, rng: np.random.Generator) -> str:
    role, hours = str(rng.choice(["top", "deep"])), sign(rng) * float(rng.choice([1, 5, 12, 24, 36]))
    cruise.settings["instruments"][role]["clock_offset_seconds"] = hours * HOUR_S
    if role == "top":
        cruise.time_s = cruise.time_s - hours * HOUR_S
    return f"{role}: clock_offset_seconds of {hours:+.0f} h told of a clock that was right"


def told_drift(cruise: Cruise, rng: np.random.Generator) -> str:
    hours = sign(rng) * float(rng.choice([2, 8, 20, 36]))
    cruise.deep["clock_drift_seconds"] = hours * HOUR_S
    return f"deep: clock_drift_seconds of {hours:+.0f} h told of a clock that was right"


def alignment(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.top["heading_alignment"] = float(rng.choice([45, -45, 90, 180, 10]))
    return f"heading_alignment: {cruise.top['heading_alignment']} beside EA 0"


def pressure_told(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.top["pressure_offset"] = float(rng.choice([-60, 40, 90]))
    return f"pressure_offset: {cruise.top['pressure_offset']}"


# Clocks


def reference_clock(cruise: Cruise, rng: np.random.Generator) -> str:
    hours = sign(rng) * float(rng.choice(CLOCK_HOURS))
    cruise.shift("deep", hours * HOUR_S)
    return f"the reference's clock {hours:+g} h"


def affected_clock(cruise: Cruise, rng: np.random.Generator) -> str:
    hours = sign(rng) * float(rng.choice(CLOCK_HOURS[:14]))
    cruise.shift("top", hours * HOUR_S)
    return f"the affected clock {hours:+g} h"


def reference_clock_drifts(cruise: Cruise, rng: np.random.Generator) -> str:
    hours = sign(rng) * float(rng.choice([1, 3, 8, 16, 40]))
    count = len(cruise.record("deep"))
    cruise.shift("deep", np.linspace(0.0, hours * HOUR_S, count))
    return f"the reference's clock drifts to {hours:+g} h"


def reference_clock_set(cruise: Cruise, rng: np.random.Generator) -> str:
    hours, share = float(rng.choice([1, 2, 6, 12, 25, 36])), rng.uniform(0.2, 0.8)
    count = len(cruise.record("deep"))
    cruise.shift("deep", np.where(np.arange(count) > share * count, hours * HOUR_S, 0.0))
    return f"the reference's clock {hours:+g} h from {share:.0%} of the record on"


def day_and_month(cruise: Cruise, rng: np.random.Generator) -> str:
    time = pd.DatetimeIndex(stamps(cruise.table().time_s))
    swapped = [t.replace(day=t.month, month=t.day) if t.day <= 12 else t for t in time]
    cruise.table().frame["time_utc"] = [t.strftime("%Y-%m-%dT%H:%M:%SZ") for t in swapped]
    return "day and month exchanged where both are possible"


# Tables


def filler(cruise: Cruise, rng: np.random.Generator) -> str:
    frame, value = cruise.table().frame, float(rng.choice([-9.99, 999.0, 9999.0, -32768.0, 0.0, 99.99]))
    share = float(rng.uniform(0.01, 0.3))
    frame.loc[rng.random(len(frame)) < share, FLOW] = value
    return f"{share:.0%} of the reference's speeds are {value:g}"


def mirrored(cruise: Cruise, rng: np.random.Generator) -> str:
    frame, how = cruise.table().frame, str(rng.choice(["exchanged", "east", "north", "from"]))
    if how == "exchanged":
        frame[FLOW] = frame[FLOW[::-1]].to_numpy()
    frame["u_cm_s"] *= -1.0 if how in ("east", "from") else 1.0
    frame["v_cm_s"] *= -1.0 if how in ("north", "from") else 1.0
    return f"the reference's components: {how}"


def wrong_scale(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.table()  # only a table has a scale
    cruise.deep["columns"]["scale"] = float(rng.choice([1.0, 0.001, 0.0254, 0.5144]))
    return f"scale: {cruise.deep['columns']['scale']}"


def units_change(cruise: Cruise, rng: np.random.Generator) -> str:
    frame, begin, end = cruise.table().frame, *sorted(rng.uniform(0, 1, 2))
    inside = (np.arange(len(frame)) > begin * len(frame)) & (np.arange(len(frame)) < end * len(frame))
    factor = float(rng.choice([100.0, 10.0, -1.0]))
    frame.loc[inside, FLOW] *= factor
    return f"the reference's speeds times {factor:g} in {inside.mean():.0%} of the record"


def stuck_reference(cruise: Cruise, rng: np.random.Generator) -> str:
    frame, share = cruise.table().frame, float(rng.uniform(0.1, 0.9))
    begin = int(rng.uniform(0, 1 - share) * len(frame))
    frame.loc[begin : begin + int(share * len(frame)), FLOW] = frame.loc[begin, FLOW].to_list()
    return f"the reference gives one value in {share:.0%} of the record"


def stuck_vane(cruise: Cruise, rng: np.random.Generator) -> str:
    frame, share = cruise.table().frame, float(rng.uniform(0.2, 1.0))
    speed = np.hypot(frame["u_cm_s"], frame["v_cm_s"])
    held = np.arange(len(frame)) < share * len(frame)
    for name, part in zip(FLOW, (0.6, 0.8), strict=True):
        frame[name] = np.where(held, part * speed, frame[name])
    return f"the reference's vane stuck in {share:.0%} of the record"


def own_export(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace the reference by an export of the affected instrument itself."""
    deep = cruise.table()
    if cruise.is_real:  # its reference is bins of the same instrument
        raise NotApplicableError
    top, how = cruise.pd0(), str(rng.choice(["rounded", "bins rolled", "averaged", "turned", "every second hour"]))
    flow = top.velocity.astype(float)[..., :2]
    flow[flow == -32768] = np.nan
    near = {"bins rolled": flow[:, 2], "averaged": flow.mean(1)}.get(how, flow[:, :2].mean(1))
    if how == "turned":
        east, north = near.T
        near = np.stack([east * np.cos(0.3) + north * np.sin(0.3), north * np.cos(0.3) - east * np.sin(0.3)], 1)
    keep = np.isfinite(near).all(1) & (np.arange(len(near)) % (2 if how.startswith("every") else 1) == 0)
    deep.frame = pd.DataFrame({
        "time_utc": stamps(top.time_s[keep]), "depth_m": top.get(VARIABLE, 16)[keep] / 10.0 + 4.0,
        "u_cm_s": np.round(near[keep, 0] / 10.0, 1), "v_cm_s": np.round(near[keep, 1] / 10.0, 1),
    })  # fmt: skip
    return f"the reference is the affected instrument's own export, {how}"


def other_mooring(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace the samples of the reference by those of another mooring, with the dates unchanged."""
    own, strange = cruise.record("deep"), cruise.record_of(cruise.another(), "deep")
    count = min(len(own), len(strange))
    own.take(np.arange(count))
    own.copy_samples(strange, np.arange(count), np.arange(count))
    return "the reference's file is another mooring's"


# PD0 contents


def caught_by_glob(cruise: Cruise, rng: np.random.Generator) -> str:
    if cruise.is_real:
        raise NotApplicableError
    own, other = cruise.pd0(), Pd0(cruise.path("top"))
    turned, serial = float(rng.uniform(30, 330)), int(rng.integers(1000, 9000))
    half = len(other) // 2
    other.rows = other.rows[half:]
    other.set_heading(other.heading + turned)
    other.put(FIXED, 54, serial, "<u4")
    own.rows = own.rows[:half]
    other.save(cruise.folder / "raw/M/top_b.000")
    cruise.top["files"] = "raw/M/top*.000"
    cruise.opened.pop("top")
    own.save(cruise.folder / "raw/M/top.000")
    return f"another instrument's file, heading {turned:+.0f}, serial {serial}, caught by a glob"


def serial_changes(cruise: Cruise, rng: np.random.Generator) -> str:
    if cruise.is_real:
        raise NotApplicableError
    top, share, turned = cruise.pd0(), rng.uniform(0.2, 0.8), sign(rng) * float(rng.uniform(8, 40))
    after = np.arange(len(top)) > share * len(top)
    top.put(FIXED, 54, 1234, "<u4", after)
    log_heading(cruise, top.heading + turned, after, turns=True)
    return f"the serial number changes at {share:.0%}, with {turned:+.0f} degrees of heading"


def wrong_serial(cruise: Cruise, rng: np.random.Generator) -> str:
    done = exchanged_roles(cruise, rng)
    for role, number in (("top", 9001), ("deep", 7501)):
        told = number if rng.random() < 0.5 else str(number)
        cruise.settings["instruments"][role]["attributes"] = {"serial_number": told}
    return done


def heading_values(cruise: Cruise, rng: np.random.Generator) -> str:
    top, share = cruise.pd0(), float(rng.uniform(0.01, 0.2))
    how = str(rng.choice(["0x8000", "0.00", "random", "+180", "327.67"]))
    hit = rng.random(len(top)) < share
    if rng.random() < 0.3:  # in bursts
        hit = np.convolve(rng.random(len(top)) < share / 8, np.ones(8), "same") > 0
    value = {"0x8000": 32768, "0.00": 0, "327.67": 32767}.get(how)
    random = rng.integers(0, 36000, len(top)) if how == "random" else (100 * np.mod(top.heading + 180, 360)).astype(int)
    top.put(VARIABLE, 18, random[hit] if value is None else value, where=hit)
    return f"headings of {how} in {hit.mean():.1%} of the ensembles"


def stuck_compass(cruise: Cruise, rng: np.random.Generator) -> str:
    top, share = cruise.pd0(), float(rng.uniform(0.05, 0.6))
    begin = int(rng.uniform(0, 1 - share) * len(top))
    inside = (np.arange(len(top)) >= begin) & (np.arange(len(top)) < begin + share * len(top))
    log_heading(cruise, np.full(len(top), top.heading[begin]), inside, turns=True)
    return f"the compass stuck in {share:.0%} of the record"


def coordinates(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.pd0()
    now = int(top.get(FIXED, 25, "u1")[0])
    bits = int(rng.choice([b for b in range(4) if b != now >> 3 & 3]))
    top.put(FIXED, 25, now & ~0b11000 | bits << 3, "u1")
    names = ("beam", "instrument", "ship", "earth")
    return f"EX says {names[bits]} and is {names[now >> 3 & 3]}"


def five_beams(cruise: Cruise, rng: np.random.Generator) -> str:
    count = int(rng.choice([5, 3, 8]))
    cruise.pd0().put(FIXED, 8, count, "u1")
    return f"the fixed leader says {count} beams"


def bias_in_file(cruise: Cruise, rng: np.random.Generator) -> str:
    top, bias = cruise.pd0(), float(rng.choice([20.0, -35.0, 90.0]))
    share = float(rng.uniform(0.2, 0.8))
    after = np.arange(len(top)) > share * len(top)
    top.put(FIXED, 28, round(100 * bias), "<i2", after)
    return f"EB says {bias:g} from {share:.0%} of the record on, and nothing was turned"


def tilts(cruise: Cruise, rng: np.random.Generator) -> str:
    top, how = cruise.pd0(), str(rng.choice(["0x8000", "exchanged", "times ten"]))
    pitch, roll = (top.get(VARIABLE, k, "<i2") for k in (20, 22))
    hit = rng.random(len(top)) < 0.2
    if how == "0x8000":
        top.put(VARIABLE, 20, -32768, "<i2", hit)
    elif how == "exchanged":
        top.put(VARIABLE, 20, roll, "<i2"), top.put(VARIABLE, 22, pitch, "<i2")
    else:
        top.put(VARIABLE, 20, np.clip(10 * pitch.astype(int), -32000, 32000), "<i2")
    return f"tilts {how}"


def slipped(cruise: Cruise, rng: np.random.Generator) -> str:
    """Add a constant to the readings of the compass from one day on, as after an undocumented change of instrument."""
    top, share, turned = cruise.pd0(), rng.uniform(0.2, 0.8), sign(rng) * float(rng.uniform(10, 120))
    log_heading(cruise, top.heading + turned, np.arange(len(top)) > share * len(top), turns=True)
    return f"headings {turned:+.0f} degrees from {share:.0%} of the record on"


def backwards(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.pd0()
    top.turn(-2.0 * top.heading)
    top.set_heading(-top.heading)
    return "headings counted anticlockwise"


# Harmless changes


def shuffled_columns(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.table()
    deep.frame["remark"] = "ok"
    deep.frame = deep.frame[list(rng.permutation(deep.frame.columns))]
    return "columns in another order, one more"


def shuffled_rows(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.table()
    deep.frame = deep.frame.sample(frac=1.0, random_state=int(rng.integers(1000)))
    return "rows in another order"


def zone(cruise: Cruise, rng: np.random.Generator) -> str:
    hours = int(rng.choice([-8, -5, 2, 5, 11]))
    local = stamps(cruise.table().time_s + hours * HOUR_S)
    cruise.table().frame["time_utc"] = np.char.add(np.char.rstrip(local, "Z"), f"{hours:+03d}:00")
    return f"times with {hours:+03d}:00 said"


def other_unit(cruise: Cruise, rng: np.random.Generator) -> str:
    factor = float(rng.choice([10.0, 100.0]))
    cruise.table().frame[FLOW] *= factor
    cruise.deep["columns"]["scale"] = 0.01 / factor
    return f"speeds in another unit, scale {0.01 / factor:g} said"


def split_files(cruise: Cruise, rng: np.random.Generator) -> str:
    top, count = cruise.pd0(), int(rng.integers(2, 6))
    cruise.opened.pop("top")
    for k, part in enumerate(np.array_split(top.rows, count)):
        piece = Pd0(cruise.path("top")) if k == 0 else top
        piece.rows = part.copy()
        piece.save(cruise.folder / f"raw/M/part{k}.000")
    names = [f"raw/M/part{k}.000" for k in range(count)]
    cruise.top["files"] = "raw/M/part*.000" if rng.random() < 0.5 else [str(x) for x in rng.permutation(names)]
    return f"the file in {count} parts"


def longer_leader(cruise: Cruise, rng: np.random.Generator) -> str:
    """Append a block of unknown type to each ensemble, as newer firmware does."""
    top, more = cruise.pd0(), int(rng.integers(2, 40))
    size, blocks = top.size, int(top.rows[0, 5])
    block = np.zeros((len(top), more + 2), np.uint8)
    block[:, 1] = 0x30
    rows = np.concatenate([top.rows[:, :-4], block, top.rows[:, -4:]], axis=1)
    end = 6 + 2 * blocks
    head = np.insert(rows, [end, end], 0, axis=1)
    head[:, 6:end] = (head[:, 6:end].copy().view("<u2") + 2).view(np.uint8)
    head[:, end : end + 2] = np.array([size - 4 + 2], "<u2").view(np.uint8)
    head[:, 5] = blocks + 1
    head[:, 2:4] = np.array([size + more + 2], "<u2").view(np.uint8)
    top.rows, top.size = head, head.shape[1]
    return f"a block of {more} octets more"


def gaps(cruise: Cruise, rng: np.random.Generator) -> str:
    top, share = cruise.pd0(), float(rng.uniform(0.01, 0.08))
    top.rows = top.rows[rng.random(len(top)) > share]
    return f"{share:.0%} of the ensembles lost"


def on_deck(cruise: Cruise, rng: np.random.Generator) -> str:
    days = float(rng.uniform(0.5, 3))
    later(cruise.settings, "start", days), later(cruise.settings, "end", -days)
    return f"{days:.1f} days before deployment and after recovery in the files"


def excluded(cruise: Cruise, rng: np.random.Generator) -> str:
    first, last = cruise.span()
    begin = first + rng.uniform(0.1, 0.8) * (last - first)
    texts = [datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%dT%H:%M:%SZ") for t in (begin, begin + 86400)]
    cruise.top["exclude"] = [{"from": texts[0], "to": texts[1], "why": "fishing"}]
    cruise.cut_truth((begin, begin + 86400), keep=False)
    return "a day excluded"


def clock_told(cruise: Cruise, rng: np.random.Generator) -> str:
    hours = sign(rng) * float(rng.choice([1, 3, 12, 24]))
    cruise.shift("deep", hours * HOUR_S)
    cruise.deep["clock_offset_seconds"] = hours * HOUR_S
    return f"the reference's clock {hours:+g} h, and said so"


def east_longitude(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.settings["longitude"] = float(cruise.settings["longitude"]) % 360.0
    return "longitude from 0 to 360"


def declination_told(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.table()
    if cruise.is_real:
        raise NotApplicableError
    off = round(cruise.declination_deg() + float(rng.uniform(-1.5, 1.5)), 1)
    deep.turn(off)
    cruise.deep["declination_applied"] = off
    return f"declination_applied {off:.1f}, and so it is"


def other_layout(cruise: Cruise, rng: np.random.Generator) -> str:
    path = cruise.folder / "config/moorings/M.yaml"
    keys = list(rng.permutation(list(cruise.settings)))
    cruise.settings = {str(k): cruise.settings[k] for k in keys}
    path.write_text(yaml.safe_dump(cruise.settings))
    return "keys in another order"


def right_serial(cruise: Cruise, rng: np.random.Generator) -> str:
    if cruise.is_real:
        cruise.top["attributes"] = {"serial_number": str(int(rng.integers(1, 9999)))}
        return "a serial number where the file is too old to hold one"
    cruise.top["attributes"] = {"serial_number": [9001, "9001", "WHS9001", "09001"][int(rng.integers(4))]}
    return f"serial_number {cruise.top['attributes']['serial_number']!r}, as in the file"


def linked_raw(cruise: Cruise, rng: np.random.Generator) -> str:
    path, elsewhere = cruise.path("top"), cruise.folder / "disk.000"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)
    return "the raw file is a link"


def table_text(cruise: Cruise, rng: np.random.Generator) -> str:
    path, how = cruise.path("deep"), str(rng.choice(["CRLF", "BOM", "quotes", "spaces"]))
    if path.suffix != ".csv":
        raise NotApplicableError
    text = path.read_text()
    head, body = text.split("\n", 1)
    text = {
        "CRLF": text.replace("\n", "\r\n"), "BOM": "\ufeff" + text, "spaces": text.replace(",", ", "),
        "quotes": ",".join(f'"{x}"' for x in head.split(",")) + "\n" + body,
    }[how]  # fmt: skip
    path.write_bytes(text.encode())
    return f"the table with {how}"


def doubled(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.pd0()
    cut = int(rng.uniform(0.2, 0.8) * len(top))
    again = int(rng.integers(5, 200))
    top.rows = np.concatenate([top.rows[:cut], top.rows[cut - again :]])
    return f"{again} ensembles twice, as where two downloads join"


def noisier(cruise: Cruise, rng: np.random.Generator) -> str:
    frame = cruise.table().frame
    frame[FLOW] = np.round(frame[FLOW], 0 if rng.random() < 0.5 else 1)
    return "the reference rounded"


def half_as_often(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.record("deep")
    deep.take(np.arange(0, len(deep), 2))
    return "the reference every second hour only"


METADATA: tuple[Attack, ...] = (
    declination, years_off, upside_down, wrong_depth, wrong_bottom, exchanged_roles, told_clock, told_drift, alignment,
    pressure_told,
)  # fmt: skip
CLOCKS: tuple[Attack, ...] = (
    reference_clock, reference_clock, affected_clock, reference_clock_drifts, reference_clock_set, day_and_month,
)  # fmt: skip
TABLES: tuple[Attack, ...] = (
    filler, mirrored, wrong_scale, units_change, stuck_reference, stuck_vane, own_export, other_mooring,
)  # fmt: skip
CONTENTS: tuple[Attack, ...] = (
    caught_by_glob, serial_changes, wrong_serial, heading_values, stuck_compass, coordinates, five_beams, bias_in_file,
    tilts, slipped, backwards,
)  # fmt: skip
HARMLESS: tuple[Attack, ...] = (
    shuffled_columns, shuffled_rows, zone, other_unit, split_files, longer_leader, gaps, on_deck, excluded, clock_told,
    east_longitude, declination_told, other_layout, right_serial, linked_raw, table_text, doubled, noisier,
    half_as_often,
)  # fmt: skip
