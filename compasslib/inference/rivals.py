"""Readings that may follow a driver of the current in its place: nearly the same pairs would be recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects.composed import ComposedEffect, as_current
from compasslib.inference.blocks import scaled_option
from compasslib.inference.current import coupled_drivers
from compasslib.inference.finding import SURE
from compasslib.inference.linear_model import Entered, Evidence, LinearModel
from compasslib.inference.noise import SlowNoise
from compasslib.types import Floats

READING = ("compass", "reading")
CURRENT_ODDS = 3.0  # of the current: in real records directions differ by its speed (docs/background/method.md)
MOST_LOG = 700.0  # logarithm of a ratio that can still be represented


@dataclass(frozen=True)
class Rival:
    """A reading that may follow drivers of the current."""

    probability: float  # that it is the compass, not the current
    option: int  # its likeliest form


def find_rivals(
    model: LinearModel,
    entered: Entered,
    slow_noise: SlowNoise | None,
    slow_noises: Sequence[SlowNoise | None],
) -> dict[frozenset[str], Rival]:
    """Find a rival for each group of drivers that vary together and that the current is likely to follow.

    Args:
        slow_noise: the likeliest slow noise.
        slow_noises: kinds of slow noise that are not improbable.
    """
    current, rivals = model.current(entered, slow_noise), dict[frozenset[str], Rival]()
    if current is None or model.slow is None:
        return rivals
    present = np.mean(current.values != 0.0, axis=0) >= SURE
    acting = [driver for driver, there in zip(current.drivers, present, strict=True) if there]
    taken = {model.options[k].block for k, _ in entered}
    for group in dict.fromkeys(map(coupled_drivers, acting)):
        readings = [
            k
            for k, option in enumerate(model.options)
            if option.block[:2] == READING and option.term.driver in group and option.block not in taken
        ]
        if readings:
            rivals[group] = _compare(model, entered, slow_noises, group, readings)
    return rivals


def _compare(
    model: LinearModel,
    entered: Entered,
    slow_noises: Sequence[SlowNoise | None],
    group: frozenset[str],
    readings: Sequence[int],
) -> Rival:
    """Compare the compass with the current, which follows the drivers in the same forms or as in the noise."""
    assert model.slow is not None
    without = replace(model, slow=model.slow.without_current(group))
    alike = _as_current(without, entered, readings)
    shares = np.array([model.options[k].share for k in readings])
    shares -= np.logaddexp.reduce(shares)
    place = [(number, size) for number, (_, size) in enumerate(entered)]
    of_compass = _log_evidence(without.weigh(slow_noises, entered), readings) + shares
    in_same_form = _log_evidence(alike.weigh(slow_noises, place), range(len(entered), len(alike.options))) + shares
    noise = model.weigh(slow_noises, entered)
    as_noise = np.logaddexp.reduce(noise.log_prior[:, 0] + noise.none[:, 0])
    of_current = np.log(CURRENT_ODDS) + np.logaddexp(np.logaddexp.reduce(in_same_form), as_noise)
    ratio = float(np.clip(of_current - np.logaddexp.reduce(of_compass), -MOST_LOG, MOST_LOG))
    return Rival(1.0 / (1.0 + float(np.exp(ratio))), readings[int(np.argmax(of_compass))])


def _log_evidence(evidence: Evidence, options: Sequence[int]) -> Floats:
    """Compute the log evidence of some options, slow noise marginalized, (k,)."""
    none = evidence.log_prior[:, 0] + evidence.none[:, 0]
    return np.asarray(np.logaddexp.reduce(none[:, None] + evidence.options[:, list(options), 0], axis=0))


def _as_current(model: LinearModel, entered: Entered, readings: Sequence[int]) -> LinearModel:
    """Build the model whose options are the entered ones, and turns of the current in the forms of some readings."""
    turned = []
    for k in readings:
        term = model.options[k].term
        assert isinstance(term, ComposedEffect)
        turned.append(scaled_option(model.freed, as_current(term)))
    options = (*(model.options[k] for k, _ in entered), *turned)
    columns = np.concatenate([option.columns for option in options], axis=1)
    unit = np.float32(model.freed.response / model.freed.sigma / np.sqrt(model.scatter))
    white = [model.freed.whiten_and_project(columns) * unit, model.white[:, model.products.ends[-1] :]]
    return replace(model, options=options, white=np.concatenate(white, axis=1))
