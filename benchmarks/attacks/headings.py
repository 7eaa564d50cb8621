"""Mistakes in the numbers of headings: unit, range, resolution, bits, correction, north."""

from __future__ import annotations

import numpy as np
from cruises import VARIABLE, Attack, Cruise, Pd0
from local import log_heading, stretch

from compasslib import angles


def part(rng: np.random.Generator, count: int) -> tuple[np.ndarray, str]:
    """Draw the whole record or a part of it, (n,) mask, and describe it."""
    if rng.random() < 0.5:
        return np.ones(count, dtype=bool), "the whole record"
    return stretch(rng, count)


def _put(cruise: Cruise, values: np.ndarray, inside: np.ndarray) -> None:
    """Overwrite headings by unconverted numbers; velocities are not changed."""
    top = cruise.record()
    top.put_heading(np.where(inside, values, top.heading))


def unit(cruise: Cruise, rng: np.random.Generator) -> str:
    top, named = cruise.record(), str(rng.choice(["gradians", "radians", "tenths", "minutes", "mils", "hundredths"]))
    factor = {
        "gradians": 1 / 0.9, "radians": np.pi / 180, "tenths": 0.1, "minutes": 60.0, "mils": 6400 / 360,
        "hundredths": 100.0,
    }[named]  # fmt: skip
    inside, where = part(rng, len(top))
    _put(cruise, top.heading * factor, inside)
    return f"headings in {named}, {where}"


def folded(cruise: Cruise, rng: np.random.Generator) -> str:
    top, how = cruise.record(), str(rng.choice(["modulo 180", "mirrored above 180", "halved", "without its sign"]))
    heading = top.heading
    new = {
        "modulo 180": np.mod(heading, 180.0), "mirrored above 180": np.where(heading > 180, 360 - heading, heading),
        "halved": heading / 2.0, "without its sign": np.abs(angles.wrap180(heading)),
    }[how]  # fmt: skip
    inside, where = part(rng, len(top))
    _put(cruise, new, inside)
    return f"headings {how}, {where}"


def clipped(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns = cruise.record(), bool(rng.random() < 0.5)
    low, high = ((0.0, 255.0), (0.0, 327.67), (40.0, 320.0), (0.0, 180.0), (90.0, 360.0))[int(rng.integers(5))]
    inside, where = part(rng, len(top))
    log_heading(cruise, np.clip(top.heading, low, high), inside, turns)
    return f"headings clipped to {low:g}–{high:g}{' with the turn of the velocities' * turns}, {where}"


def rounded(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns, step = cruise.record(), bool(rng.random() < 0.5), float(rng.choice([5.0, 10.0, 22.5, 45.0]))
    down = bool(rng.random() < 0.3)
    new = step * (np.floor if down else np.rint)(top.heading / step)
    inside, where = part(rng, len(top))
    log_heading(cruise, new, inside, turns)
    return f"headings {'cut down' if down else 'rounded'} to {step:g}{' with the velocities' * turns}, {where}"


def stuck_bit(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns, bit = cruise.record(), bool(rng.random() < 0.5), int(rng.integers(9, 15))
    raw = np.rint(100 * top.heading).astype(int)
    high = bool(rng.random() < 0.5)
    raw = raw | 1 << bit if high else raw & ~(1 << bit)
    inside, where = part(rng, len(top))
    if turns:
        top.turn(np.where(inside, raw / 100.0 - top.heading, 0.0))
    _put(cruise, raw / 100.0, inside)
    return f"bit {bit} of the heading stuck at {int(high)}{' with the turn of the velocities' * turns}, {where}"


def octets(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    how = str(rng.choice(["bytes exchanged", "the low byte alone", "the high byte alone", "8 bits"]))
    raw = np.rint(100 * top.heading).astype(np.uint16)
    new = {
        "bytes exchanged": raw.byteswap() / 100.0, "the low byte alone": (raw & 0xFF) / 100.0,
        "the high byte alone": (raw & 0xFF00) / 100.0, "8 bits": np.floor(top.heading * 256 / 360.0),
    }[how]  # fmt: skip
    inside, where = part(rng, len(top))
    _put(cruise, new, inside)
    return f"headings: {how}, {where}"


def averaged_across_north(cruise: Cruise, rng: np.random.Generator) -> str:
    """Average headings arithmetically across north, which gives means that point south."""
    top, width = cruise.record(), float(rng.choice([8.0, 20.0, 40.0]))
    heading = top.heading
    near = np.abs(angles.wrap180(heading))
    new = np.where(near < width, heading + rng.uniform(0, 1, len(top)) * (180.0 - heading), heading)
    inside, where = part(rng, len(top))
    _put(cruise, new, inside)
    return f"headings averaged across north within {width:g} degrees, {where}"


def averaged(cruise: Cruise, rng: np.random.Generator) -> str:
    """Average headings over hours, while velocities were rotated by the headings of single samples."""
    top, hours, arithmetic = cruise.record(), int(rng.choice([6, 12, 24])), bool(rng.random() < 0.5)
    window = np.ones(hours) / hours
    if arithmetic:
        new = np.convolve(top.heading, window, "same")
    else:
        new = np.rad2deg(np.angle(np.convolve(np.exp(1j * np.deg2rad(top.heading)), window, "same")))
    inside, where = part(rng, len(top))
    log_heading(cruise, new, inside, turns=False)
    return f"headings averaged over {hours} samples{', arithmetically' * arithmetic}, {where}"


def held(cruise: Cruise, rng: np.random.Generator) -> str:
    top, every = cruise.record(), int(rng.choice([2, 6, 12, 24]))
    inside, where = part(rng, len(top))
    log_heading(cruise, top.heading[np.arange(len(top)) // every * every], inside, turns=False)
    return f"headings held over {every} samples, {where}"


def corrected_already(cruise: Cruise, rng: np.random.Generator) -> str:
    """Replace headings by corrected ones, while velocities were rotated by the recorded ones."""
    top = cruise.record()
    truth = cruise.truth_at(top.time_s)
    inside, where = part(rng, len(top))
    log_heading(cruise, truth, inside & np.isfinite(truth), turns=False)
    cruise.undecidable = bool(inside.all()) and not (isinstance(top, Pd0) and top.is_beam)
    return f"headings corrected already, velocities not, {where}"


def true_north(cruise: Cruise, rng: np.random.Generator) -> str:
    """Refer headings to true north, with or without the velocities."""
    top, turns = cruise.record(), bool(rng.random() < 0.5)
    inside, where = part(rng, len(top))
    log_heading(cruise, top.heading + cruise.declination_deg(), inside, turns)
    cruise.undecidable = bool(inside.all())
    return f"headings true, not magnetic{', velocities too' * turns}, {where}"


def mirrored(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns = cruise.record(), bool(rng.random() < 0.5)
    inside, where = part(rng, len(top))
    log_heading(cruise, -top.heading, inside, turns)
    return f"headings counted anticlockwise{' with the turn of the velocities' * turns}, {where}"


def half_turn(cruise: Cruise, rng: np.random.Generator) -> str:
    top, turns, angle = cruise.record(), bool(rng.random() < 0.5), float(rng.choice([180.0, 90.0, -90.0]))
    inside, where = part(rng, len(top))
    log_heading(cruise, top.heading + angle, inside, turns)
    cruise.undecidable = bool(inside.all())
    return f"headings {angle:+.0f}{' with the velocities' * turns}, {where}"


def shuffled(cruise: Cruise, rng: np.random.Generator) -> str:
    top = cruise.record()
    inside, where = part(rng, len(top))
    new = top.heading.copy()
    new[inside] = rng.permutation(new[inside])
    log_heading(cruise, new, inside, turns=False)
    return f"headings in another order, {where}"


def by_index(cruise: Cruise, rng: np.random.Generator) -> str:
    """Change every nth heading, as in interleaved records."""
    top, every, turns = cruise.record(), int(rng.choice([2, 3, 5, 10])), bool(rng.random() < 0.5)
    how = str(rng.choice(["offset", "random", "late", "of another compass"]))
    hit = np.arange(len(top)) % every == 0
    heading, truth = top.heading, cruise.truth_at(top.time_s)
    turned = float(rng.choice([-1, 1]) * rng.uniform(15, 90))
    new = {
        "offset": heading + turned, "random": rng.uniform(0, 360, len(top)), "late": np.roll(heading, 6),
        "of another compass": np.where(np.isfinite(truth), heading + 40 * np.sin(np.deg2rad(truth + turned)), heading),
    }[how]  # fmt: skip
    log_heading(cruise, new, hit, turns)
    return f"every {every}th heading {how}{f' of {turned:+.0f}' * (how == 'offset')}{' with the velocities' * turns}"


def tilts_of_sign(cruise: Cruise, rng: np.random.Generator) -> str:
    top: Pd0 = cruise.pd0()
    how = str(rng.choice(["pitch negative", "roll negative", "roll + 180", "both times 0.1"]))
    pitch, roll = (top.get(VARIABLE, k, "<i2").astype(int) for k in (20, 22))
    pitch = -pitch if how == "pitch negative" else pitch // 10 if "times" in how else pitch
    turned = {"roll negative": -roll, "roll + 180": (roll + 36000) % 36000 - 18000, "both times 0.1": roll // 10}
    roll = turned.get(how, roll)
    top.put(VARIABLE, 20, pitch, "<i2"), top.put(VARIABLE, 22, roll, "<i2")
    return f"tilts: {how}"


HEADINGS: tuple[Attack, ...] = (
    unit, folded, clipped, rounded, stuck_bit, octets, averaged_across_north, averaged, held, corrected_already,
    true_north, mirrored, half_turn, shuffled, by_index, tilts_of_sign,
)  # fmt: skip
