"""Declinations applied twice or not at all, and confusions of files, axes, units and calibrations."""

from __future__ import annotations

import shutil
from copy import deepcopy
from typing import Any

import numpy as np
import pandas as pd
import yaml
from bases import read_by
from cruises import FIXED, VARIABLE, Attack, Cruise, NotApplicableError, Pd0, Table
from references import smoothed

# Declination


def declination_sign(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.true_north, cruise.undecidable = True, True
    how = str(rng.choice(["the sign of the declination", "no declination", "the sign of the longitude"]))
    if how == "the sign of the longitude":
        cruise.settings["longitude"] = -float(cruise.settings["longitude"])
    else:
        cruise.settings["declination"] = round(-cruise.declination_deg(), 2) if "sign" in how else 0.0
    return how


def north_mistaken(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.true_north, cruise.undecidable = True, True
    now = cruise.deep.get("direction_reference", "magnetic")
    cruise.deep["direction_reference"] = {"magnetic": "true", "true": "magnetic"}[now]
    return f"the reference's directions called {cruise.deep['direction_reference']}"


def declination_told(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.true_north, cruise.undecidable = True, True
    role, times = str(rng.choice(["top", "deep"])), float(rng.choice([-1.0, 1.0]))
    if cruise.settings["instruments"][role].get("direction_reference") == "true":
        role = "top"
    told = round(times * cruise.declination_deg(), 2)
    cruise.settings["instruments"][role]["declination_applied"] = told
    return f"{role}: declination_applied {told:+.1f} told, nothing was applied"


def declination_applied(cruise: Cruise, rng: np.random.Generator) -> str:
    """Rotate velocities by the declination once more, or backwards, without documentation."""
    cruise.true_north = True
    role, times = str(rng.choice(["top", "deep"])), float(rng.choice([-2.0, -1.0, 1.0, 2.0]))
    share = float(rng.choice([0.0, 0.0, 0.3, 0.7]))
    record = cruise.record(role)
    if isinstance(record, Pd0) and record.is_beam:
        raise NotApplicableError
    after = np.arange(len(record)) >= share * len(record)
    record.turn(np.where(after, times * cruise.declination_deg(), 0.0))
    cruise.undecidable = share == 0.0
    return f"{role}: velocities turned by {times:+.0f} declinations{f' from {share:.0%} on' * (share > 0)}"


def bias_applied(cruise: Cruise, rng: np.random.Generator) -> str:
    """Write the declination as EB to the leader, with the data not rotated or rotated twice."""
    cruise.true_north, cruise.undecidable = True, True
    top, off, how = cruise.pd0(), cruise.declination_deg(), str(rng.choice(["in the leader alone", "in both, twice"]))
    top.put(FIXED, 28, round(100 * off), "<i2")
    if how == "in both, twice":
        top.turn(2 * off)
        top.set_heading(top.heading + 2 * off)
    return f"EB of the declination {how}"


DECLINATION: tuple[Attack, ...] = (
    declination_sign, north_mistaken, declination_told, declination_applied, bias_applied,
)  # fmt: skip

# Confusions


def calibration_of_another(cruise: Cruise, rng: np.random.Generator) -> str:
    strength = float(rng.choice([0.1, 0.3, 0.6]))
    correct = 10.0 * np.arange(36)
    recorded = read_by(strength * np.exp(1j * rng.uniform(0, 2 * np.pi)), correct)
    with_reference = bool(rng.random() < 0.7)
    calibrated(cruise, rng, correct, recorded)
    if not with_reference:
        cruise.settings.pop("reference")
        cruise.undecidable = True
    return f"a calibration of another compass ({strength:g} H), {'with' if with_reference else 'without'} a reference"


def calibrated(cruise: Cruise, rng: np.random.Generator, correct: np.ndarray, recorded: np.ndarray) -> None:
    """Configure the correction of a mooring by bench readings, at the mooring's place and start."""
    folder = cruise.folder / "config/calibrations"
    folder.mkdir()
    settings = {key: cruise.settings[key] for key in ("latitude", "longitude")}
    settings |= {"date": str(cruise.settings["start"])[:10], "kind": "platform", "file": "raw/k.csv"}
    (folder / "K.yaml").write_text(yaml.safe_dump(settings))
    recorded = np.mod(recorded + rng.normal(0, 0.4, len(recorded)), 360.0)
    frame = pd.DataFrame({"reference_deg": correct, "recorded_deg": recorded})
    frame.round(2).to_csv(cruise.folder / "raw/k.csv", index=False)
    cruise.settings["fit"] = {"method": "calibration", "name": "K"}


def two_names(cruise: Cruise, rng: np.random.Generator) -> str:
    """Declare the same files as two moorings of one compass, which contain the information only once."""
    cruise.top["compass"] = "wh1"
    later = deepcopy(cruise.settings)
    later["name"] = "N"
    how = str(rng.choice(["the same dates", "another year", "a half each, overlapping"]))
    span = cruise.span()
    if how == "another year":
        for key in ("start", "end"):
            later[key] = (pd.Timestamp(str(later[key])) + pd.Timedelta(days=365)).strftime("%Y-%m-%dT%H:%M:%SZ")
        strange = Pd0(cruise.path("top"))
        strange.shift(365 * 86400.0)
        (cruise.folder / "raw/N").mkdir()
        strange.save(cruise.folder / "raw/N/top.000")
        shutil.copy(cruise.path("deep"), cruise.folder / "raw/N")
        later["instruments"]["top"]["files"] = "raw/N/top.000"
        later["instruments"]["deep"]["clock_offset_seconds"] = -365 * 86400.0
    elif how.startswith("a half"):
        begin, end = (pd.Timestamp(span[0] + x * (span[1] - span[0]), unit="s") for x in (0.4, 0.6))
        cruise.settings["end"] = end.strftime("%Y-%m-%dT%H:%M:%SZ")
        later["start"] = begin.strftime("%Y-%m-%dT%H:%M:%SZ")
    (cruise.folder / "config/moorings/N.yaml").write_text(yaml.safe_dump(later, sort_keys=False))
    return f"one mooring under two names, {how}"


def _copy(cruise: Cruise) -> Pd0 | Table:
    return type(cruise.record("deep"))(cruise.path("deep"))


def reference_twice(cruise: Cruise, rng: np.random.Generator) -> str:
    """List copies of one reference, rotated by a constant, as several references."""
    deep, angle, copies = cruise.record("deep"), float(rng.choice([0.0, 25.0, -40.0, 90.0])), int(rng.choice([1, 2]))
    deep.turn(angle)
    for k in range(copies):
        again = _copy(cruise)
        again.turn(angle)
        cruise.add_reference(f"deep{k + 2}", again)
    names = ["deep", *(f"deep{k + 2}" for k in range(copies))]
    cruise.settings["reference"] = names
    cruise.undecidable = True
    return f"one reference listed {copies + 1} times, turned by {angle:+.0f}"


def outvoted(cruise: Cruise, rng: np.random.Generator) -> str:
    """Add to a correct reference a wrong one that is listed twice."""
    how = str(rng.choice(["turned by 40", "3 h late", "stuck", "of random direction"]))
    for k in (2, 3):
        wrong = _copy(cruise)
        if how == "3 h late":
            wrong.shift(3 * 3600.0)
        elif how == "stuck":
            wrong.flow = np.broadcast_to(wrong.flow[5], wrong.flow.shape)
        else:
            wrong.turn(40.0 if how.startswith("turned") else np.random.default_rng(k // 4).uniform(0, 360, len(wrong)))
        cruise.add_reference(f"deep{k}", wrong)
    cruise.settings["reference"] = list(rng.permutation(["deep", "deep2", "deep3"]).tolist())
    return f"a right reference beside one {how} that is listed twice"


def two_disagree(cruise: Cruise, rng: np.random.Generator) -> str:
    how = str(rng.choice(["turned by 30", "3 h late", "a running mean", "of other sign"]))
    wrong = _copy(cruise)
    if how == "3 h late":
        wrong.shift(3 * 3600.0)
    elif how == "a running mean":
        wrong.flow = smoothed(wrong.flow, np.ones(24))
    elif how == "of other sign":
        wrong.flow = -wrong.flow
    else:
        wrong.turn(30.0)
    cruise.add_reference("deep2", wrong)
    first = bool(rng.random() < 0.5)
    cruise.settings["reference"] = ["deep2", "deep"] if first else ["deep", "deep2"]
    return f"two references, the {'first' if first else 'second'} {how}"


def own_bins(cruise: Cruise, rng: np.random.Generator) -> str:
    """Add the reference's own bins as a second reference, whose noise would be counted as independent."""
    again, noise = _copy(cruise), float(rng.choice([0.5, 2.0, 8.0]))
    again.flow = again.flow + noise * (rng.normal(size=again.flow.shape) + 1j * rng.normal(size=again.flow.shape))
    cruise.add_reference("deep2", again)
    cruise.settings["reference"] = ["deep", "deep2"]
    return f"the reference's own bins as a second reference, {noise:g} mm/s apart"


def own_file(cruise: Cruise, rng: np.random.Generator) -> str:
    """Use the affected instrument as its own reference, under another name."""
    how = str(rng.choice(["the same file", "a copy", "a copy, 3 m deeper", "a copy, headings corrected"]))
    cruise.pd0()
    settings: dict[str, Any] = deepcopy(cruise.top)
    if how != "the same file":
        copy = Pd0(cruise.path("top"))
        if "3 m" in how:
            copy.put(VARIABLE, 16, copy.get(VARIABLE, 16) + 30)
            settings["depth"] = 103
        if "corrected" in how:
            copy.set_heading(copy.heading + 12.0)
        copy.put(FIXED, 54, 4242, "<u4") if not cruise.is_real else None
        copy.save(cruise.folder / "raw/M/copy.000")
        settings["files"] = "raw/M/copy.000"
    cruise.settings["instruments"]["deep"] = settings
    return f"the affected instrument as its own reference, {how}"


def top_of_another(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace the affected instrument's samples and true headings by another mooring's, with the dates unchanged."""
    another = cruise.another()
    own, strange = cruise.record(), cruise.record_of(another, "top")
    count = min(len(own), len(strange))
    _, truth = np.load(cruise.bases / f"{another}.npy")
    own.take(np.arange(count))
    own.copy_samples(strange, np.arange(count), np.arange(count))
    cruise.set_truth(truth[:count])
    return "the affected instrument's file is another mooring's"


def another_year(cruise: Cruise, rng: np.random.Generator) -> str:
    """Shift the velocities of the reference to another season, with the dates unchanged."""
    deep, shift = cruise.record("deep"), float(rng.uniform(0.2, 0.8))
    deep.flow = np.roll(deep.flow, int(shift * len(deep)), axis=0)
    return "the reference's values are of another season"


def scaled(cruise: Cruise, rng: np.random.Generator) -> str:
    role, factor = str(rng.choice(["top", "deep"])), float(rng.choice([0.1, 10.0, 1.94, 0.01, 0.514]))
    record = cruise.record(role)
    share = float(rng.choice([0.0, 0.0, 0.4]))
    after = np.arange(len(record)) >= share * len(record)
    record.flow = np.where(after[:, None], record.flow * factor, record.flow)
    return f"{role}: speeds times {factor:g}{f' from {share:.0%} on' * (share > 0)}"


def axes_mistaken(cruise: Cruise, rng: np.random.Generator) -> str:
    role = str(rng.choice(["top", "top", "deep"]))
    how = str(rng.choice(["exchanged", "east negative", "north negative", "both negative"]))
    record = cruise.record(role)
    flow = record.flow
    new = {
        "exchanged": flow.imag + 1j * flow.real, "east negative": -flow.conj(), "north negative": flow.conj(),
        "both negative": -flow,
    }[how]  # fmt: skip
    share = float(rng.choice([0.0, 0.0, 0.5]))
    after = np.arange(len(record)) >= share * len(record)
    record.flow = np.where(after[:, None], new, flow)
    return f"{role}: east and north {how}{f' from {share:.0%} on' * (share > 0)}"


def one_component(cruise: Cruise, rng: np.random.Generator) -> str:
    role, how = str(rng.choice(["top", "deep"])), str(rng.choice(["offset", "zero", "clipped", "of 8 bits", "doubled"]))
    record = cruise.record(role)
    flow = record.flow
    east, largest = flow.real, np.nanmax(np.abs(flow.real))
    new = {
        "offset": east + 0.6 * largest, "zero": 0.0 * east, "clipped": np.clip(east, -0.2 * largest, 0.2 * largest),
        "of 8 bits": np.mod(east + 128, 256) - 128, "doubled": 2.0 * east,
    }[how]  # fmt: skip
    record.flow = new + 1j * flow.imag
    return f"{role}: east component {how}"


def instrument_axes(cruise: Cruise, rng: np.random.Generator) -> str:
    """Store velocities in the frame of the instrument that are declared as earth coordinates."""
    top = cruise.record()
    top.turn(-top.heading)
    if isinstance(top, Pd0) and top.is_beam:
        raise NotApplicableError
    return "velocities in the instrument's frame called earth"


def pressure_unit(cruise: Cruise, rng: np.random.Generator) -> str:
    role, factor = str(rng.choice(["top", "deep"])), float(rng.choice([10.0, 0.1, 1.45, 3.28, 0.0]))
    record = cruise.record(role)
    if isinstance(record, Table):
        record.frame["depth_m"] *= factor
    else:
        record.put(VARIABLE, 16, np.clip(record.get(VARIABLE, 16) * factor, 0, 65535).astype(int))
        if not cruise.is_real:
            record.put(VARIABLE, 48, (record.get(VARIABLE, 48, "<u4") * factor).astype(np.int64), "<u4")
    return f"{role}: pressure and depth times {factor:g}"


def facing(cruise: Cruise, rng: np.random.Generator) -> str:
    """Invert the orientation bit of the file, in all or half of the record."""
    top, share = cruise.pd0(), float(rng.choice([0.0, 0.5]))
    after = np.arange(len(top)) >= share * len(top)
    said = bool(rng.random() < 0.5)
    top.put(FIXED, 4, top.get(FIXED, 4, "u1")[after] ^ 0x80, "u1", after)
    if said:
        cruise.top.pop("orientation", None)
    return f"the file faces the other way{', and no key says how' * said}{' from 50% on' * (share > 0)}"


IDENTITIES: tuple[Attack, ...] = (
    calibration_of_another, two_names, reference_twice, outvoted, two_disagree, own_bins, own_file, top_of_another,
    another_year, scaled, axes_mistaken, one_component, instrument_axes, pressure_unit, facing,
)  # fmt: skip
