"""Forward model of a compass near iron with further effects, and its inverse in closed form.

Effects on the field are affine: iron and effects are one matrix and one vector at each sample, which levelling converts
to five coefficients. A is a rotation of the reading: it includes the mean veer, which must not tilt. ``heading_deg``
means correct magnetic headings, ``recorded_deg`` readings, ``earth_nT`` the earth's field in the body, (n, 3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles, compass
from compasslib.effects.effect import Effect, Scene, parameter_slices
from compasslib.types import Floats

MIN_HEADING_SLOPE = 0.2  # lower bound of |d gamma / d beta| in denominators; closer to a fold linearization fails
COMPASS_STEPS = np.full(5, 0.02)  # of A..E: very roughly a degree
PROBE_DEG = 0.01  # step of finite differences with respect to heading


@dataclass(frozen=True)
class ForwardModel:
    """A fitted compass with further effects."""

    coefficients: Floats  #: (5,) A..E of the level exact compass, dimensionless
    horizontal_nT: float  #: earth's horizontal field that B and C were scaled with, nT
    terms: tuple[Effect, ...] = ()  #: effects in the order in which they act

    @property
    def parameters(self) -> Floats:
        """A..E and the values of the terms, (p,)."""
        return np.concatenate([self.coefficients, *(term.values for term in self.terms)])

    @property
    def steps(self) -> Floats:
        """Changes of the parameters that each turn the heading by very roughly a degree, (p,)."""
        return np.concatenate([COMPASS_STEPS, *(term.steps() for term in self.terms)])

    def at(self, parameters: Floats) -> ForwardModel:
        """Replace the parameters, (p,), in the order of ``parameters``."""
        each = zip(self.terms, parameter_slices(self.terms, 5), strict=True)
        terms = tuple(term.at(parameters[place]) for term, place in each)
        return replace(self, coefficients=parameters[:5], terms=terms)


def recorded_heading(simulation: ForwardModel, scene: Scene, heading_deg: Floats) -> Floats:
    """Compute the recorded heading, (n,) degrees."""
    earth = earth_field_in_body(scene, heading_deg - north_shift(simulation, scene))
    return angles.wrap360(apply_readout(simulation, scene, sensed_angle(simulation, scene, earth)))


def earth_field_in_body(scene: Scene, heading_deg: Floats) -> Floats:
    """Compute the earth's field forward, starboard, down in the tilted body, (n, 3) nT; headings to actual north."""
    sine, cosine = angles.sin_cos(heading_deg)
    level = np.stack([scene.horizontal_nT * cosine, -scene.horizontal_nT * sine, scene.vertical_nT], axis=-1)
    return np.einsum("nji,nj->ni", scene.levelling, level)


def sensed_angle(simulation: ForwardModel, scene: Scene, earth_nT: Floats) -> Floats:
    """Compute the angle of the levelled field, with iron and further effects, before the readout, (n,) degrees."""
    soft, hard = _iron(simulation)
    field = _applied(simulation, "field", earth_nT @ soft.T + hard, scene)
    x, y = (np.einsum("nj,nj->n", scene.levelling[:, k], field) for k in (0, 1))
    return angles.argument(x - 1j * y)


def invert_heading(simulation: ForwardModel, scene: Scene, recorded_deg: Floats) -> Floats:
    """Compute the correct headings that give the recorded ones, (n, 2) degrees, NaN where there is none."""
    sensed = invert_readout(simulation, scene, recorded_deg)
    roots = compass.inverse(coefficients_with_effects(simulation, scene), sensed)
    return angles.wrap360(roots + np.broadcast_to(north_shift(simulation, scene), recorded_deg.shape)[:, None])


def coefficients_with_effects(simulation: ForwardModel, scene: Scene) -> Floats:
    """Compute A..E of iron and field effects at each sample's tilt and time, (5, n); the fitted A is in the readout."""
    soft, hard = _iron(simulation)
    if _acting(simulation, "field"):  # affine: known from its action on no field and on the unit fields
        fields = [np.tile(hard, (len(scene), 1)), *(np.tile(hard + column, (len(scene), 1)) for column in soft.T)]
        hard, *ends = (_applied(simulation, "field", field, scene) for field in fields)
        soft = np.stack([end - hard for end in ends], axis=-1)
    return compass.level_coefficients(
        soft,
        hard,
        horizontal_nT=scene.horizontal_nT,
        vertical_nT=scene.vertical_nT,
        pitch_deg=np.nan_to_num(scene.pitch_deg),
        roll_deg=np.nan_to_num(scene.roll_deg),
    )


def apply_readout(simulation: ForwardModel, scene: Scene, sensed_deg: Floats) -> Floats:
    """Compute the reading from the angle of the levelled field, (n,) degrees, not wrapped."""
    return _applied(simulation, "reading", sensed_deg - _turn_of_readout(simulation), scene)


def invert_readout(simulation: ForwardModel, scene: Scene, recorded_deg: Floats) -> Floats:
    """Compute the angle of the levelled field from a reading, (n,) degrees; NaN where it is not unique."""
    reading = recorded_deg
    for term in reversed(_acting(simulation, "reading")):
        reading = term.invert(reading, scene)
    return reading + _turn_of_readout(simulation)


def north_shift(simulation: ForwardModel, scene: Scene) -> Floats | float:
    """Compute the shift of magnetic north to the east, (n,) degrees or 0."""
    return _applied(simulation, "north", np.zeros(len(scene)), scene) if _acting(simulation, "north") else 0.0


def water_veer(simulation: ForwardModel, scene: Scene) -> Floats | float:
    """Compute the veer of the reference's current relative to the affected instrument's, (n,) degrees or 0."""
    return _applied(simulation, "water", np.zeros(len(scene)), scene) if _acting(simulation, "water") else 0.0


def heading_jacobian(
    simulation: ForwardModel, scene: Scene, heading_deg: Floats, *, first: int = 0, last: int | None = None
) -> Floats:
    """Differentiate the correct heading by each parameter at constant recorded heading, (n, p) degrees per unit."""
    at, steps, columns = simulation.parameters, 0.05 * simulation.steps, []
    still = None if _acting(simulation, "north") else earth_field_in_body(scene, heading_deg)

    def read(trial: ForwardModel) -> Floats:
        earth = earth_field_in_body(scene, heading_deg - north_shift(trial, scene)) if still is None else still
        return apply_readout(trial, scene, sensed_angle(trial, scene, earth))

    reading, veered = read(simulation), water_veer(simulation, scene)
    ahead = recorded_heading(simulation, scene, heading_deg + PROBE_DEG)
    slope = _bounded(angles.difference(ahead, reading) / PROBE_DEG)
    for j in range(first, len(at) if last is None else last):
        more = simulation.at(at + steps[j] * (np.arange(len(at)) == j))
        turned = angles.difference(read(more), reading)
        columns.append((water_veer(more, scene) - veered - turned / slope) / steps[j])
    return np.stack(columns, axis=1) if columns else np.zeros((len(scene), 0))


def added_term_jacobian(simulation: ForwardModel, scene: Scene, heading_deg: Floats, term: Effect) -> Floats:
    """Differentiate the correct heading by the parameters of an added term, (n, p) degrees per unit."""
    if term.acts_on != "reading":
        both = replace(simulation, terms=(term, *simulation.terms))
        return heading_jacobian(both, scene, heading_deg, first=5, last=5 + len(term.fitted()))
    reduced = replace(simulation, terms=tuple(other for other in simulation.terms if other.acts_on != "reading"))
    earth = earth_field_in_body(scene, heading_deg - north_shift(simulation, scene))
    reading = apply_readout(reduced, scene, sensed_angle(reduced, scene, earth))
    slope, steps = _bounded(heading_slope(simulation, scene, heading_deg)), 0.05 * term.steps()
    at, columns = term.apply(reading, scene), []
    for j, step in enumerate(steps):
        more = term.at(term.values + step * (np.arange(len(steps)) == j)).apply(reading, scene)
        columns.append(-angles.difference(more, at) / slope / step)
    return np.stack(columns, axis=1)


def heading_slope(simulation: ForwardModel, scene: Scene, heading_deg: Floats) -> Floats:
    """Compute d gamma / d beta, (n,)."""
    ahead, here = (recorded_heading(simulation, scene, heading_deg + s) for s in (PROBE_DEG, 0.0))
    return angles.difference(ahead, here) / PROBE_DEG


def _bounded(slope: Floats) -> Floats:
    return np.where(np.abs(slope) < MIN_HEADING_SLOPE, np.copysign(MIN_HEADING_SLOPE, slope), slope)


def _iron(simulation: ForwardModel) -> tuple[Floats, Floats]:
    """Express the level compass as soft-iron matrix and hard-iron vector in nT; the readout accounts for A."""
    a, b, c, d, e = simulation.coefficients
    u = 1.0 - 1j * a
    p, v = (b - 1j * c) / u, (d - 1j * e) / u
    soft: Floats = np.array([[1.0 + v.real, -v.imag, 0.0], [-v.imag, 1.0 - v.real, 0.0], [0.0, 0.0, 1.0]])
    return soft, simulation.horizontal_nT * np.array([p.real, -p.imag, 0.0])


def _turn_of_readout(simulation: ForwardModel) -> float:
    return float(np.arctan(simulation.coefficients[0])) / angles.DEGREE


def _acting(simulation: ForwardModel, on: str) -> list[Effect]:
    return [term for term in simulation.terms if term.acts_on == on]


def _applied(simulation: ForwardModel, on: str, x: Floats, scene: Scene) -> Floats:
    for term in _acting(simulation, on):
        x = term.apply(x, scene)
    return x
