"""Errors in part of a record: repeated, stuck, out of the water, of another instrument, rotated."""

from __future__ import annotations

import numpy as np
from bases import read_by
from cruises import VARIABLE, Attack, Cruise, NotApplicableError, Pd0

SHARES = {"a tenth": 0.1, "a third": 1.0 / 3.0}
PLACES = {"at the beginning": 0.0, "in the middle": 0.5, "at the end": 1.0}


def stretch(rng: np.random.Generator, count: int) -> tuple[np.ndarray, str]:
    """Draw the part of a record to be modified, (n,) mask, and describe it."""
    share, place = str(rng.choice(list(SHARES))), str(rng.choice(list(PLACES)))
    length = int(SHARES[share] * count)
    begin = int(PLACES[place] * (count - length))
    return (np.arange(count) >= begin) & (np.arange(count) < begin + length), f"{share} {place}"


def elsewhere(rng: np.random.Generator, inside: np.ndarray) -> np.ndarray:
    """Draw indices of equally many samples outside the modified part, repeated cyclically if there are too few."""
    length, outside = int(inside.sum()), np.flatnonzero(~inside)
    return outside[(int(rng.integers(len(outside))) + np.arange(length)) % len(outside)]


def another_compass(rng: np.random.Generator, heading_deg: np.ndarray) -> tuple[np.ndarray, str]:
    """Compute the readings of a compass near randomly drawn iron."""
    strength, towards = float(rng.choice([0.3, 0.6, 1.3])), rng.uniform(0.0, 2.0 * np.pi)
    return read_by(strength * np.exp(1j * towards), heading_deg), f"{strength:g} H"


def log_heading(cruise: Cruise, heading_deg: np.ndarray, inside: np.ndarray, turns: bool) -> None:
    """Write other headings, with or without the rotation of the velocities that such a compass would cause."""
    top = cruise.record()
    if turns:
        change = np.where(inside, heading_deg - top.heading, 0.0)
        top.turn(np.where(np.isfinite(change), change, 0.0))
    top.set_heading(heading_deg[inside], inside)


# The affected instrument


def headings_repeated(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns = cruise.record(), bool(rng.random() < 0.5)
    inside, where = stretch(rng, len(top))
    new = top.heading.copy()
    new[inside] = new[elsewhere(rng, inside)]
    log_heading(cruise, new, inside, turns)
    return f"headings{' and the turn of the velocities' * turns} repeated from elsewhere, {where}"


def velocities_repeated(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    inside, where = stretch(rng, len(top))
    source = elsewhere(rng, inside)
    if isinstance(top, Pd0):
        velocity = top.velocity.copy()
        velocity[inside] = velocity[source]
        top.velocity = velocity
    else:
        flow = top.flow.copy()
        flow[inside] = flow[source]
        top.flow = flow
    return f"velocities repeated from elsewhere, {where}"


def samples_repeated(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    inside, where = stretch(rng, len(top))
    top.copy_samples(top, np.flatnonzero(inside), elsewhere(rng, inside))
    return f"whole samples repeated from elsewhere, {where}"


def samples_held(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    inside, where = stretch(rng, len(top))
    top.copy_samples(top, np.flatnonzero(inside), np.full(inside.sum(), np.flatnonzero(inside)[0]))
    return f"one whole sample repeated, {where}"


def heading_stuck(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns, jitter = cruise.record(), bool(rng.random() < 0.5), float(rng.choice([0.0, 0.02, 0.5]))
    inside, where = stretch(rng, len(top))
    value = top.heading[np.flatnonzero(inside)[0]]
    log_heading(cruise, value + jitter * rng.normal(size=len(top)), inside, turns)
    return f"heading stuck (noise {jitter:g}){' with the turn of the velocities' * turns}, {where}"


def out_of_water(cruise: Cruise, rng: np.random.Generator) -> str:
    """Simulate time on deck within the stated deployment: velocities are noise, the ship's iron affects the compass."""
    top, tells = cruise.pd0(), bool(rng.random() < 0.6)
    inside, where = stretch(rng, len(top))
    count, number = len(top), int(inside.sum())
    truth = cruise.truth_at(top.time_s)
    truth[inside] = np.mod(rng.uniform(0, 360) + np.cumsum(rng.normal(0, 4, number)), 360)
    top.velocity = np.where(inside[:, None, None], np.rint(rng.normal(0, 60, top.velocity.shape)), top.velocity)
    top.set_heading(truth[inside] + 25.0 * np.sin(np.deg2rad(truth[inside] + 40.0)), inside)
    if tells:
        top.put(VARIABLE, 16, 0, where=inside)  # dm, the depth of the transducer
        if top.get(VARIABLE, 48, "<u4").any() and not cruise.is_real:
            top.put(VARIABLE, 48, rng.integers(0, 30, count)[inside], "<u4", inside)  # 0.001 dbar
    cruise.set_truth(truth)
    return f"on deck{', as its pressure tells' * tells}, {where}"


def by_another_compass(cruise: Cruise, rng: np.random.Generator, *, turns: bool) -> str:
    top = cruise.record()
    inside, where = stretch(rng, len(top))
    reading, named = another_compass(rng, cruise.truth_at(top.time_s))
    log_heading(cruise, reading, inside & np.isfinite(reading), turns)
    return f"another compass beside iron of {named}, {where}"


def other_compass(cruise: Cruise, rng: np.random.Generator) -> str:
    return by_another_compass(cruise, rng, turns=True)


def other_headings(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace headings by those of another compass, as in a merge of two exports, with velocities unchanged."""
    return f"headings, not velocities, of {by_another_compass(cruise, rng, turns=False)}"


def other_record(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace samples by those of another mooring, with the truth unchanged."""
    top, strange = cruise.record(), cruise.record_of(cruise.another(), "top")
    inside, where = stretch(rng, len(top))
    to = np.flatnonzero(inside)
    top.copy_samples(strange, to, to % len(strange))
    return f"samples of another mooring's instrument, {where}"


def redeployed(cruise: Cruise, rng: np.random.Generator) -> str:
    """Simulate a redeployment with other batteries: another compass after a gap."""
    top, share = cruise.record(), float(rng.uniform(0.3, 0.7))
    after = np.arange(len(top)) > share * len(top)
    reading, named = another_compass(rng, cruise.truth_at(top.time_s))
    log_heading(cruise, reading, after & np.isfinite(reading), turns=True)
    gap = (np.arange(len(top)) > share * len(top) - 60) & ~after
    top.take(~gap)
    return f"deployed again after a gap at {share:.0%}, then iron of {named}"


def turned_in_mount(cruise: Cruise, rng: np.random.Generator) -> str:
    """Turn the instrument in its clamp but not the iron: headings and truth change, east and north do not."""
    top, angle = cruise.record(), float(rng.choice([-1, 1]) * rng.uniform(15, 90))
    if isinstance(top, Pd0) and top.is_beam:
        raise NotApplicableError
    inside, where = stretch(rng, len(top))
    cruise.set_truth(np.mod(cruise.truth_at(top.time_s) + np.where(inside, angle, 0.0), 360.0))
    log_heading(cruise, top.heading + angle, inside, turns=False)
    return f"turned by {angle:+.0f} degrees in its mount, {where}"


def compass_offset(cruise: Cruise, rng: np.random.Generator) -> str:
    top, angle = cruise.record(), float(rng.choice([-1, 1]) * rng.uniform(10, 90))
    inside, where = stretch(rng, len(top))
    log_heading(cruise, top.heading + angle, inside, turns=True)
    return f"the compass reads {angle:+.0f} degrees more, {where}"


def headings_lag(cruise: Cruise, rng: np.random.Generator) -> str:
    top, steps = cruise.record(), int(rng.choice([-24, -6, -2, 1, 3, 12, 48]))
    inside, where = stretch(rng, len(top))
    log_heading(cruise, np.roll(top.heading, steps), inside, turns=False)
    return f"headings {steps:+d} samples late, {where}"


# The reference


def reference_repeated(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.record("deep")
    inside, where = stretch(rng, len(deep))
    deep.copy_samples(deep, np.flatnonzero(inside), elsewhere(rng, inside))
    return f"the reference repeated from elsewhere, {where}"


def reference_held(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, noise = cruise.record("deep"), float(rng.choice([0.0, 1.0, 10.0]))
    inside, where = stretch(rng, len(deep))
    flow = deep.flow.copy()
    flow[inside] = flow[np.flatnonzero(inside)[0]] + noise * (rng.normal(size=flow[inside].shape) + 1j)
    deep.flow = flow
    return f"the reference stuck (noise {noise:g} mm/s), {where}"


def reference_of_another(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, strange = cruise.record("deep"), cruise.record_of(cruise.another(), "deep")
    inside, where = stretch(rng, len(deep))
    to = np.flatnonzero(inside)
    deep.copy_samples(strange, to, to % len(strange))
    return f"the reference of another mooring, {where}"


def reference_on_deck(cruise: Cruise, rng: np.random.Generator) -> str:
    deep = cruise.record("deep")
    inside, where = stretch(rng, len(deep))
    flow, tells = deep.flow.copy(), bool(rng.random() < 0.5)
    flow[inside] = rng.normal(0, 30, flow[inside].shape) + 1j * rng.normal(0, 30, flow[inside].shape)
    deep.flow = flow
    if tells and isinstance(deep, Pd0):
        deep.put(VARIABLE, 16, 0, where=inside)
    elif tells:
        deep.frame.loc[inside, "depth_m"] = 0.0
    return f"the reference out of the water{', as its depth tells' * tells}, {where}"


def reference_turned(cruise: Cruise, rng: np.random.Generator) -> str:
    deep, angle = cruise.record("deep"), float(rng.choice([-1, 1]) * rng.uniform(10, 90))
    inside, where = stretch(rng, len(deep))
    deep.turn(np.where(inside, angle, 0.0))
    return f"the reference turned by {angle:+.0f} degrees, {where}"


def reference_by_iron(cruise: Cruise, rng: np.random.Generator) -> str:
    """Add a deviation by the reference's own heading, which varies independently."""
    deep = cruise.record("deep")
    inside, where = stretch(rng, len(deep))
    heading = np.mod(np.cumsum(rng.normal(0, 25, len(deep))), 360.0)
    reading, named = another_compass(rng, heading)
    deep.turn(np.where(inside, reading - heading, 0.0))
    return f"the reference's own compass beside iron of {named}, {where}"


LOCAL: tuple[Attack, ...] = (
    headings_repeated, velocities_repeated, samples_repeated, samples_held, heading_stuck, out_of_water,
    other_compass, other_headings, other_record, redeployed, turned_in_mount, compass_offset, headings_lag,
    reference_repeated, reference_held, reference_of_another, reference_on_deck, reference_turned, reference_by_iron,
)  # fmt: skip
