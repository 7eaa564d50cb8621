"""Which ellipsoid a magnetometer's log can carry: what the orientations determine, what held-out blocks prefer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer.ellipsoid import (
    AXES,
    CENTRE,
    CIRCLE,
    ELLIPSE,
    ELLIPSOID,
    LEVEL_AND_THIRD,
    SPHERE,
    FittedEllipsoid,
    Model,
    ScaledReadings,
)
from compasslib.calibrations.magnetometer.log import Log
from compasslib.statistics import robust
from compasslib.statistics.autocorrelation import effective_number
from compasslib.types import Floats

MOST_UNSURE = 0.05  # of the field: a parameter that is less sure is not given
LASTING = 0.003  # of the field: linearity, cross-axis, gradients; an error that more readings do not average out
FOLDS = 5
LEAST_ARC_DEG, FEWEST_SECTORS, MOST_SCATTER = 120.0, 6, 0.25
MOST_TILT_DEG, FLAT = 30.0, 0.3  # of a platform that counts as level: by its tilts, or by z's scatter over the radius
OUTLYING, MOST_OUTLYING = 6.0, 0.05
DIAGONAL, OTHERS, LEVEL_SOFT = ("S11", "S22", "S33"), ("S12", "S13", "S23"), ("S11", "S22", "S12")
UNSEEN_LEVEL = ("z offset", "S33", "S13", "S23")


@dataclass(frozen=True)
class Choice:
    """The model that was chosen with what it was chosen from; without a fit ``why`` says what is missing."""

    fitted: FittedEllipsoid | None = None
    readings: ScaledReadings | None = None
    scale: float = 1.0  # file's unit for one unit of the readings
    level: bool = False
    scores: dict[str, float] = field(default_factory=dict)  # rms of the modulus on held-out blocks, percent
    undetermined: dict[str, str] = field(default_factory=dict)  # parameter -> reason
    weakest: dict[str, float] = field(default_factory=dict)  # one standard error over the field, as judged
    full: FittedEllipsoid | None = None  # the largest model that is determined
    why: str = ""


def choose(log: Log, body: Floats) -> Choice:
    """Return the model that the log carries: the whole ellipsoid, else what a level platform shows.

    Args:
        body: the same in the body frame, (n, 3).
    """
    space = _space(body) if log.has_z else Choice(why="There is no z.")
    if space.fitted is not None:
        return space
    return _level(log, body)


def far_off(choice: Choice) -> NDArray[np.bool_]:
    """Return which readings lie so far off the fitted modulus that they are not its noise, (n,); none where many do."""
    if choice.full is None or choice.readings is None:
        return np.zeros(0, dtype=bool)
    off = ellipsoid.modulus(_field(choice.full.iron()[0], choice.readings), choice.readings.down) - 1.0
    off = np.abs(off - np.median(off))
    far = off > OUTLYING * max(robust.width(off), LASTING)
    return far if far.mean() < MOST_OUTLYING else np.zeros_like(far)


def _space(body: Floats) -> Choice:
    readings, scale, centre = _scaled(body, np.zeros_like(body))
    sphere = _try(SPHERE, readings, centre)
    if sphere is None:
        return Choice(why="The readings determine no sphere.")
    noise = _noise(ELLIPSOID, sphere, readings)
    if noise[0] > MOST_SCATTER:
        return Choice(why=_scattered(noise[0], "ellipsoid"))
    unsure = _unsure(ELLIPSOID, sphere, readings, noise)
    lost = _with_their_like(unsure, DIAGONAL, OTHERS)
    if any(unsure[name] > MOST_UNSURE for name in CENTRE):
        return Choice(why="The orientations do not cover the sphere.")
    models = [model for model in (SPHERE, AXES, ELLIPSOID) if not set(lost) & set(model.free)]
    reasons = {name: _reason(unsure[name], "the orientations leave it") for name in lost}
    return _best(models, readings, centre, Choice(scale=scale, undetermined=reasons, weakest=unsure))


def _level(log: Log, body: Floats) -> Choice:
    down = log.levelling()[:, 2, :]
    if log.tilted and np.percentile(_tilt(down), 99.0) > MOST_TILT_DEG:
        return Choice(why="The orientations neither cover the sphere nor stay level.")
    readings, scale, centre = _scaled(body, down)
    circle = _try(CIRCLE, readings, centre)
    if circle is None:
        return Choice(why="The readings lie on no circle: the instrument did not turn, or the record is constant.")
    noise = _noise(ELLIPSE, circle, readings)
    why = _poor(circle, readings, noise[0])
    if why or (log.has_z and not log.tilted and readings.field[:, 2].std() > FLAT):
        return Choice(why=why or "The orientations neither cover the sphere nor stay level, and no tilts are logged.")
    unsure = _unsure(LEVEL_AND_THIRD, circle, readings, noise) if log.tilted else {}
    both = _unsure(ELLIPSE, circle, readings, noise)
    lost = _with_their_like(both, LEVEL_SOFT)
    rest = _unsure(CIRCLE, circle, readings, noise) if lost else both
    if max(rest["x offset"], rest["y offset"]) > MOST_UNSURE:
        return Choice(why="The readings cover too little of a turn: not even the centre of the circle is determined.")
    reasons = _unseen(log, unsure, down) | {name: _reason(both[name], "the part of a turn leaves it") for name in lost}
    models = [CIRCLE] if lost else [CIRCLE, ELLIPSE]
    return _best(models, readings, centre, Choice(scale=scale, level=True, undetermined=reasons, weakest=unsure | rest))


def _unseen(log: Log, unsure: dict[str, float], down: Floats) -> dict[str, str]:
    """Return what a platform that turns about the vertical cannot show, with the reason."""
    if not log.has_z:
        return dict.fromkeys(UNSEEN_LEVEL, "there is no z")
    mixed = "turning about the vertical, what the vertical field induces looks like hard iron in x and y"
    if not log.tilted:
        level = "without tilts the horizontal field does not show it"
        return {"z offset": level, "S33": level, "S13": mixed, "S23": mixed}
    spans = f"tilts of up to {np.percentile(_tilt(down), 99.0):.0f}° leave it"
    return {**{name: _reason(unsure[name], spans) for name in ("z offset", "S33")}, "S13": mixed, "S23": mixed}


def _with_their_like(unsure: dict[str, float], *groups: tuple[str, ...]) -> list[str]:
    """Return the names in those groups of which one is too unsure: a model has all of a group or none."""
    return [name for group in groups if any(unsure[k] > MOST_UNSURE for k in group) for name in group]


def _reason(unsure: float, spans: str) -> str:
    if unsure <= MOST_UNSURE:
        return f"{spans} beside others of its kind that are not determined"
    size = f"unsure by {100.0 * unsure:.0f} % of the field" if unsure < 1.0 else "open by more than the whole field"
    return f"{spans} {size}; at most {100.0 * MOST_UNSURE:.0f} % is accepted"


def _tilt(down: Floats) -> Floats:
    """Return the angle between the body's third axis and the vertical, (n,) degrees."""
    return angles.argument(down[:, 2] + 1j * np.hypot(down[:, 0], down[:, 1]))


def _scaled(body: Floats, down: Floats) -> tuple[ScaledReadings, float, Floats]:
    """Return the readings over the radius of the circle or sphere through them, that radius, and its centre over it."""
    centre, radius = ellipsoid.start(ScaledReadings(body, down))
    scale = radius if radius > 0.0 else 1.0
    return ScaledReadings(body / scale, down), scale, centre / scale


def _poor(circle: FittedEllipsoid, readings: ScaledReadings, noise: float) -> str:
    """Return why a circle through the readings means nothing; empty where it does."""
    if noise > MOST_SCATTER:
        return _scattered(noise, "circle or ellipse")
    towards = np.sort(angles.argument((readings.field - circle.iron()[0][:3])[:, :2] @ np.array([1.0, -1.0j])))
    arc = 360.0 - float(np.max(np.diff(towards, append=towards[0] + 360.0)))
    if arc < LEAST_ARC_DEG:
        return f"The instrument turned through {arc:.0f}°, at least {LEAST_ARC_DEG:.0f}° (a third of a turn) is needed."
    sectors = len(np.unique(towards // 10.0))
    if sectors < FEWEST_SECTORS:
        return f"The readings repeat {sectors} headings, at least {FEWEST_SECTORS} apart by 10° are needed."
    return ""


def _scattered(noise: float, shape: str) -> str:
    return (
        f"The readings scatter by {100.0 * noise:.0f} % about a {shape}: the instrument kept one heading, "
        "or its field is not the earth's with iron."
    )


def _unsure(
    judged: Model, fitted: FittedEllipsoid, readings: ScaledReadings, noise: tuple[float, float]
) -> dict[str, float]:
    """Return one standard error of each parameter over the field: noise that averages, and errors that do not."""
    each = float(np.hypot(noise[0] / np.sqrt(noise[1]), LASTING))
    return {name: each * by for name, by in ellipsoid.dilution(judged, fitted.iron()[0], readings).items()}


def _noise(largest: Model, fitted: FittedEllipsoid, readings: ScaledReadings) -> tuple[float, float]:
    """Return the noise of one axis and how many readings are independent, by the largest model that can be fitted.

    Soft iron that a sphere leaves over would count as noise with a long memory.
    """
    iron, noise = fitted.iron()[0], fitted.noise
    try:
        parameters, variance = ellipsoid.solve(largest, readings, iron[:3])
        iron, noise = parameters @ largest.chain, float(np.sqrt(max(variance, 0.0)))
    except np.linalg.LinAlgError:
        pass  # that is what the judgement is about to say
    residual = ellipsoid.modulus(_field(iron, readings), readings.down) - 1.0
    times = np.arange(len(readings), dtype=float)
    return noise, effective_number(residual, times, longest_s=len(readings) / 10.0)


def _best(models: Sequence[Model], readings: ScaledReadings, centre: Floats, found: Choice) -> Choice:
    """Return the model that predicts contiguous blocks best which it was not fitted to."""
    scores = {model.name: _score(model, readings, centre) for model in models}
    fits = {model.name: fitted for model in models if (fitted := _try(model, readings, centre))}
    if not fits:
        return Choice(why="No ellipsoid can be fitted to the readings.")
    return Choice(
        fits[min(fits, key=lambda name: scores[name])],
        readings,
        found.scale,
        found.level,
        scores,
        found.undetermined,
        found.weakest,
        fits[list(fits)[-1]],
    )


def _try(model: Model, readings: ScaledReadings, centre: Floats) -> FittedEllipsoid | None:
    try:
        return ellipsoid.fit(model, readings, centre)
    except np.linalg.LinAlgError:
        return None


def _score(model: Model, readings: ScaledReadings, centre: Floats) -> float:
    """Return the rms of the modulus on held-out blocks about 1, percent."""
    fold, off = ellipsoid.blocks(len(readings)) % FOLDS, np.full(len(readings), np.nan)
    for k in range(FOLDS):
        try:
            iron = ellipsoid.solve(model, readings.take(fold != k), centre)[0] @ model.chain
        except np.linalg.LinAlgError:
            return float("inf")
        left = readings.take(fold == k)
        off[fold == k] = ellipsoid.modulus(_field(iron, left), left.down) - 1.0
    return float(100.0 * np.sqrt(np.mean(off**2)))


def _field(iron: Floats, readings: ScaledReadings) -> Floats:
    return ellipsoid.corrected(iron[:3], iron[3:].reshape(3, 3), readings)
