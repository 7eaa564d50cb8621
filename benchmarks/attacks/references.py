"""Errors in the series of a reference: filtered, held, filled, with wrong times, interleaved."""

from __future__ import annotations

import numpy as np
from cruises import HOUR_S, Attack, Cruise, NotApplicableError, Table


def smoothed(flow: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute the weighted running mean of finite values, (n, cells)."""
    known = np.isfinite(flow)
    total = [np.convolve(column, weights, "same") for column in np.where(known, flow, 0.0).T]
    count = [np.convolve(column, weights, "same") for column in known.astype(float).T]
    return np.where(known, np.stack(total, 1) / np.maximum(np.stack(count, 1), 1e-9), np.nan)


def _samples(time_s: np.ndarray, hours: float) -> int:
    return max(2, round(hours * HOUR_S / float(np.median(np.diff(time_s)))))


def running_mean(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, hours = cruise.record("deep"), float(rng.choice([3, 6, 12, 25, 48]))
    deep.flow = smoothed(deep.flow, np.ones(_samples(deep.time_s, hours)))
    return f"the reference is a running mean of {hours:g} h"


def trailing_mean(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, hours = cruise.record("deep"), float(rng.choice([3, 6, 12, 24]))
    samples = _samples(deep.time_s, hours)
    deep.flow = smoothed(deep.flow, np.r_[np.zeros(samples - 1), np.ones(samples)])
    return f"the reference is the mean of the {hours:g} h before"


def low_passed(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, hours = cruise.record("deep"), float(rng.choice([6, 12, 30, 60]))
    deviation = _samples(deep.time_s, hours) / 2.4
    reach = np.arange(-int(3 * deviation) - 1, int(3 * deviation) + 2)
    deep.flow = smoothed(deep.flow, np.exp(-0.5 * (reach / deviation) ** 2))
    return f"the reference is low-passed at {hours:g} h"


def detided(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, hours = cruise.record("deep"), float(rng.choice([12, 25]))
    flow = deep.flow
    deep.flow = flow - smoothed(flow, np.ones(_samples(deep.time_s, hours)))
    return f"the reference is what a mean of {hours:g} h leaves"


def held(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, every = cruise.record("deep"), int(rng.choice([2, 3, 6, 12, 24]))
    deep.flow = deep.flow[np.arange(len(deep)) // every * every]
    return f"the reference holds each value for {every} samples"


def interpolated(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, every = cruise.record("deep"), int(rng.choice([3, 6, 12, 24]))
    flow, at = deep.flow, np.arange(len(deep))
    known = at[::every][np.isfinite(flow[::every]).all(1)]
    deep.flow = np.stack([np.interp(at, known, flow[known, k]) for k in range(flow.shape[1])], 1)
    return f"the reference is interpolated from every {every}th sample"


def long_gaps_filled(cruise: Cruise, rng: np.random.Generator) -> str:
    """Fill days without data by linear interpolation."""
    deep, share = cruise.record("deep"), float(rng.choice([0.2, 0.5]))
    flow, at = deep.flow, np.arange(len(deep))
    days = _samples(deep.time_s, 4 * 24.0)
    lost = rng.random(len(deep) // days + 1)[at // days] < share
    known = at[~lost & np.isfinite(flow).all(1)]
    deep.flow = np.stack([np.interp(at, known, flow[known, k]) for k in range(flow.shape[1])], 1)
    return f"{lost.mean():.0%} of the reference is filled by straight lines over days"


def climatology(cruise: Cruise, rng: np.random.Generator) -> str:
    """Fill days without data by the mean daily cycle."""
    deep, share = cruise.record("deep"), float(rng.choice([0.2, 0.5]))
    flow, hour = deep.flow, np.floor(deep.time_s / HOUR_S).astype(int) % 24
    mean = np.stack([np.nanmean(flow[hour == h], axis=0) if (hour == h).any() else 0 * flow[0] for h in range(24)])
    lost = np.arange(len(deep)) < share * len(deep)
    deep.flow = np.where(lost[:, None], mean[hour], flow)
    return f"{share:.0%} of the reference is its mean day"


def predicted(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace the reference by a tidal prediction fitted to it, including its mean."""
    deep = cruise.record("deep")
    flow, time = deep.flow, deep.time_s - deep.time_s[0]
    rate = 2j * np.pi / HOUR_S / np.array([12.42, 12.0, 23.93, 25.82])
    design = np.exp(np.outer(time, [0.0, *rate, *-rate]))
    known = np.isfinite(flow).all(1)
    deep.flow = design @ np.linalg.lstsq(design[known], flow[known], rcond=None)[0]
    return "the reference is a prediction of tides"


def local_time(cruise: Cruise, rng: np.random.Generator) -> str:
    role, hours = str(rng.choice(["top", "deep"])), float(rng.choice([-8, -5, -1, 1, 2, 9]))
    cruise.shift(role, hours * HOUR_S)
    return f"{role}: local time of {hours:+g} h"


def summer_time(cruise: Cruise, rng: np.random.Generator) -> str:
    """Shift times by one hour from some day on, or up to it, without resolving the duplicate or missing hour."""
    role, share, later = str(rng.choice(["top", "deep"])), float(rng.uniform(0.2, 0.8)), bool(rng.random() < 0.5)
    count = len(cruise.record(role))
    after = np.arange(count) > share * count
    cruise.shift(role, np.where(after == later, HOUR_S, 0.0))
    return f"{role}: summer time {'from' if later else 'up to'} {share:.0%} of the record"


def drifts(cruise: Cruise, rng: np.random.Generator) -> str:
    role, hours = str(rng.choice(["top", "deep"])), float(rng.choice([-12, -4, -2, 2, 4, 12]))
    shape = str(rng.choice(["line", "parabola", "there and back"]))
    along = np.linspace(0.0, 1.0, len(cruise.record(role)))
    course = {"line": along, "parabola": along**2, "there and back": np.sin(np.pi * along)}[shape]
    cruise.shift(role, hours * HOUR_S * course)
    return f"{role}: the clock drifts to {hours:+g} h, {shape}"


def rows_late(cruise: Cruise, rng: np.random.Generator) -> str:
    """Shift the column of times against the others from some row on."""
    deep, rows = cruise.record("deep"), int(rng.choice([1, 2, 6, 13]))
    if not isinstance(deep, Table):
        raise NotApplicableError
    share = float(rng.choice([0.0, 0.3, 0.6]))
    after = np.arange(len(deep)) >= share * len(deep)
    deep.flow = np.where(after[:, None], np.roll(deep.flow, rows, axis=0), deep.flow)
    return f"the reference's values {rows} rows late from {share:.0%} on"


def every_other_late(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, every, rows = cruise.record("deep"), int(rng.choice([2, 3])), int(rng.choice([1, 2, 6]))
    hit = np.arange(len(deep)) % every == 0
    deep.flow = np.where(hit[:, None], np.roll(deep.flow, rows, axis=0), deep.flow)
    return f"every {every}th sample of the reference is that {rows} before"


def every_nth_bad(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, every = cruise.record("deep"), int(rng.choice([2, 3, 5, 10]))
    how = str(rng.choice(["random", "reversed", "turned by 60", "conjugate"]))
    hit = np.arange(len(deep)) % every == 0
    angle = {"random": rng.uniform(0, 360, len(deep)), "reversed": 180.0, "turned by 60": 60.0}.get(how, 0.0)
    if how == "conjugate":
        deep.flow = np.where(hit[:, None], np.conj(deep.flow), deep.flow)
    else:
        deep.turn(np.where(hit, angle, 0.0))
    return f"every {every}th sample of the reference {how}"


def interleaved(cruise: Cruise, rng: np.random.Generator) -> str:
    """Interleave the records of two instruments in one file."""
    deep, strange = cruise.record("deep"), cruise.record_of(cruise.another(), "deep")
    every = int(rng.choice([2, 3]))
    to = np.arange(0, len(deep), every)
    deep.copy_samples(strange, to, to % len(strange))
    return f"every {every}th sample of the reference is another mooring's"


def order_lost(cruise: Cruise, rng: np.random.Generator) -> str:
    """Permute blocks of days, as if files of a logger were joined in the wrong order."""
    deep, days = cruise.record("deep"), float(rng.choice([1, 7, 20]))
    block = np.floor((deep.time_s - deep.time_s[0]) / (days * 86400.0)).astype(int)
    order = np.argsort(rng.permutation(block.max() + 1)[block], kind="stable")
    deep.flow = deep.flow[order]
    return f"the reference in blocks of {days:g} days in another order"


REFERENCES: tuple[Attack, ...] = (
    running_mean, trailing_mean, low_passed, detided, held, interpolated, long_gaps_filled, climatology, predicted,
    local_time, summer_time, drifts, rows_late, every_other_late, every_nth_bad, interleaved, order_lost,
)  # fmt: skip
