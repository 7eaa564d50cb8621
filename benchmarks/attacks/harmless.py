"""Harmless changes: other formats of the same dates and units, fewer data, additional noise of the usual size."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pandas as pd
from cruises import VARIABLE, Attack, Cruise, NotApplicableError, Pd0, Table, stamps
from identities import calibrated
from local import log_heading
from moorings import HARMLESS as FORMS

from compasslib import angles


def dates_written(cruise: Cruise, rng: np.random.Generator) -> str:
    how = str(rng.choice(["%Y-%m-%d %H:%M:%S+00:00", "%Y-%m-%dT%H:%MZ", "%Y-%m-%dT%H:%M:%S"]))
    for key in ("start", "end"):
        cruise.settings[key] = pd.Timestamp(str(cruise.settings[key])).strftime(how)
    return f"dates written as {cruise.settings['start']}"


def whole_days(cruise: Cruise, rng: np.random.Generator) -> str:
    start, end = (pd.Timestamp(str(cruise.settings[key])) for key in ("start", "end"))
    cruise.settings["start"] = (start.ceil("D") if cruise.is_real else start.floor("D")).strftime("%Y-%m-%d")
    cruise.settings["end"] = end.floor("D").strftime("%Y-%m-%d")
    return "start and end as dates alone"


def every_second_sample(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    top.take(np.arange(len(top)) % 2 == int(rng.integers(2)))
    return "every second sample of the affected instrument dropped"


def every_second_of_both(cruise: Cruise, rng: np.random.Generator) -> str:
    if cruise.base == "profiler":
        raise NotApplicableError
    for role in ("top", "deep"):
        record = cruise.record(role)
        record.take(np.floor(record.time_s / 3600.0).astype(int) % 2 == 0)
    return "every second hour of both instruments dropped"


def noise_of_headings(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    log_heading(cruise, top.heading + rng.normal(0, 0.1, len(top)), np.ones(len(top), dtype=bool), turns=True)
    return "noise of 0.1 degrees in the headings"


def headings_to_tenths(cruise: Cruise, rng: np.random.Generator) -> str:
    top, step = cruise.record(), float(rng.choice([0.1, 0.25]))
    log_heading(cruise, step * np.rint(top.heading / step), np.ones(len(top), dtype=bool), turns=False)
    return f"headings rounded to {step:g} degrees"


def headings_of_sign(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    if not isinstance(top, Table):
        raise NotApplicableError
    top.put_heading(angles.wrap180(top.heading))
    return "headings from -180 to 180"


def depth_by_a_metre(cruise: Cruise, rng: np.random.Generator) -> str:
    role, off = str(rng.choice(["top", "deep"])), int(rng.choice([-1, 1]))
    if "depth" not in cruise.settings["instruments"][role]:
        raise NotApplicableError
    cruise.settings["instruments"][role]["depth"] += off
    return f"{role}: nominal depth {off:+d} m"


def bottom_by_metres(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.settings["water_depth"] = float(cruise.settings["water_depth"]) + float(rng.choice([0.5, 1.0, 2.0]))
    return "the water a metre or two deeper"


def covariate(cruise: Cruise, rng: np.random.Generator) -> str:
    time = np.arange(*cruise.span(), 3600.0)
    smooth = np.convolve(rng.normal(0, 1, time.size + 100), np.ones(100) / 10, "same")[: time.size]
    frame = pd.DataFrame({"time_utc": stamps(time), "value": smooth.round(3)})
    frame.to_csv(cruise.folder / "raw/M/more.csv", index=False)
    columns = {"time": "time_utc", "value": "value"}
    cruise.settings["covariates"] = {"more": {"format": "table", "files": "raw/M/more.csv", "columns": columns}}
    return "a covariate that drives nothing"


def attributes(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.settings["attributes"] = {"principal_investigator": "A. Person", "project": "Shelf"}
    cruise.deep["attributes"] = {"comment": "hired"}
    return "attributes"


def gaps_of_reference(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, hours = cruise.record("deep"), int(rng.integers(3, 30))
    lost = np.zeros(len(deep), dtype=bool)
    for begin in rng.integers(0, len(deep), 3):
        lost[begin : begin + hours] = True
    deep.take(~lost)
    return f"three gaps of {hours} samples in the reference"


def one_gap(cruise: Cruise, rng: np.random.Generator) -> str:
    top, share = cruise.record(), float(rng.uniform(0.02, 0.08))
    begin = int(rng.uniform(0.1, 0.8) * len(top))
    top.take((np.arange(len(top)) < begin) | (np.arange(len(top)) > begin + share * len(top)))
    return f"one gap of {share:.0%} in the affected record"


def shorter(cruise: Cruise, rng: np.random.Generator) -> str:
    first, last = cruise.span()
    cut = float(rng.uniform(0.05, 0.15)) * (last - first)
    key, time = ("start", first + cut) if rng.random() < 0.5 else ("end", last - cut)
    cruise.settings[key] = pd.Timestamp(time, unit="s").floor("s").strftime("%Y-%m-%dT%H:%M:%SZ")
    cruise.cut_truth((time, last) if key == "start" else (first, time), keep=True)
    return f"the {key} a week or so inside"


def seconds_late(cruise: Cruise, rng: np.random.Generator) -> str:
    seconds = float(rng.choice([-120, -30, 20, 90]))
    cruise.shift("deep", seconds)
    return f"the reference's clock {seconds:+.0f} s"


def noise_of_velocities(cruise: Cruise, rng: np.random.Generator) -> str:
    record = cruise.record("deep")
    shape = record.flow.shape
    record.flow = record.flow + rng.normal(0, 3, shape) + 1j * rng.normal(0, 3, shape)
    return "noise of 3 mm/s in the reference"


def noise_of_depths(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.record("deep")
    noise = rng.normal(0, 0.1, len(deep))
    if isinstance(deep, Table):
        deep.frame["depth_m"] += noise
    else:
        deep.put(VARIABLE, 16, deep.get(VARIABLE, 16) + np.rint(10 * noise).astype(int))
    return "noise of 0.1 m in the depth of the reference"


def declination_number(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.settings["declination"] = round(cruise.declination_deg() + float(rng.uniform(-0.2, 0.2)), 1)
    return "the declination as a number"


def true_reference(cruise: Cruise, rng: np.random.Generator) -> str:
    if cruise.deep.get("direction_reference") == "true":
        raise NotApplicableError
    cruise.record("deep").turn(cruise.declination_deg())
    cruise.deep["direction_reference"] = "true"
    return "the reference's directions true, and said so"


def right_calibration(cruise: Cruise, rng: np.random.Generator) -> str:
    """Correct by a calibration of the same compass, with its mean reading near each heading as bench readings."""
    top = cruise.record()
    truth, recorded = cruise.truth_at(top.time_s), top.heading
    correct, read = [], []
    for middle in range(5, 360, 10):
        off = angles.wrap180(truth - middle)
        near = np.abs(off) < 5.0
        if near.sum() < 8:
            raise NotApplicableError
        correct.append(float(middle))
        error = np.exp(1j * np.deg2rad(recorded[near] - truth[near]))
        read.append(middle + float(np.rad2deg(np.angle(error.mean()))))
    calibrated(cruise, rng, np.array(correct), np.array(read))
    return "corrected by a right calibration"


def second_reference(cruise: Cruise, rng: np.random.Generator) -> str:
    """Add a second reference of the same kind with independent noise."""
    again = type(cruise.record("deep"))(cruise.path("deep"))
    again.flow = again.flow + 14.0 * (rng.normal(size=again.flow.shape) + 1j * rng.normal(size=again.flow.shape))
    cruise.add_reference("deep2", again)
    cruise.settings["reference"] = ["deep", "deep2"]
    return "a second reference"


def unused_instrument(cruise: Cruise, rng: np.random.Generator) -> str:
    cruise.settings["instruments"]["spare"] = deepcopy(cruise.deep)
    return "an instrument that nothing names"


def tilt_noise(cruise: Cruise, rng: np.random.Generator) -> str:
    top: Pd0 = cruise.pd0()
    for offset in (20, 22):
        tilt = top.get(VARIABLE, offset, "<i2").astype(int)
        top.put(VARIABLE, offset, tilt + np.rint(rng.normal(0, 10, len(top))).astype(int), "<i2")
    return "noise of 0.1 degrees in the tilts"


HARMLESS: tuple[Attack, ...] = (
    *FORMS,
    dates_written, whole_days, every_second_sample, every_second_of_both, noise_of_headings, headings_to_tenths,
    headings_of_sign, depth_by_a_metre, bottom_by_metres, covariate, attributes, gaps_of_reference, one_gap, shorter,
    seconds_late, noise_of_velocities, noise_of_depths, declination_number, true_reference, right_calibration,
    second_reference, unused_instrument, tilt_noise,
)  # fmt: skip
