"""Would catch an effect without text or literature, a forward model without inverse or with a wrong derivative."""

import runpy
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from compasslib import angles, compass
from compasslib.effects import CATALOGUE, Scene
from compasslib.effects.composed import BeamGain, PivotFriction, compose_effect, effect_by_name, place_effect
from compasslib.effects.effect import turning_scene
from compasslib.effects.forward import (
    ForwardModel,
    added_term_jacobian,
    earth_field_in_body,
    heading_jacobian,
    heading_slope,
    invert_heading,
    recorded_heading,
    water_veer,
)
from compasslib.effects.iron import Heeling, LevelSoftIron, SoftIronInSpace, TemperatureOfField
from compasslib.effects.readout import CompassLag, Octantal, Sextantal, TiltUncompensated
from compasslib.effects.reference import LateCourse
from compasslib.inference import comparison, wording

NAMES = [
    "hard_iron", "soft_iron", "large_deviation", "heeling", "hard_iron_drift", "hard_iron_step", "temperature",
    "supply_voltage", "sextantal", "octantal", "field_disturbance", "secular_variation", "declination_error",
    "heading_slip", "compass_drift", "clock_offset", "clock_drift", "current_veer", "compass_lag", "stuck_tilt",
    "tilt_uncompensated", "water_drift", "course_lag", "mooring_motion", "mounting_offset", "battery_change",
    "reference_deviation", "reference_slip", "reference_beams", "reference_bias", "pressure", "moving_iron",
    "tilt_offset", "pivot_friction", "beam_gain", "velocity_bias",
]  # fmt: skip
H_NT, Z_NT, N = 12000.0, 52000.0, 400
LEVEL = np.array([0.03, 0.25, -0.2, 0.02, 0.01])
RNG = np.random.default_rng(1)
TIME_S = 1.19e9 + 86400.0 * np.arange(N)
HEADING = RNG.uniform(0.0, 360.0, N)
# Turn rates are those of a mooring, some thousandths of a degree per second; the other departures are of order one.
NEEDED = {name for term in CATALOGUE for name in term.needs} | {"pitch", "speed"}
DEPARTURES = {name: RNG.normal(0.0, 0.003 if name == "turn_rate" else 1.0, N) for name in sorted(NEEDED)}
SCENE = Scene(
    TIME_S, np.full(N, H_NT), np.full(N, Z_NT), RNG.normal(3, 2, N), RNG.normal(-2, 2, N), TIME_S[0], DEPARTURES
)
FLAT = replace(SCENE, pitch_deg=np.zeros(N), roll_deg=np.zeros(N))
COMPASS_AND_WATER = [term for term in CATALOGUE if "mooring" in term.recordings and term.acts_on != "time"]
MOVING = turning_scene(SCENE, lambda ahead_s: 0.01 * ahead_s * np.ones(N))


def absent(kind):
    return kind(date_s=float(TIME_S[N // 3])) if kind.dated() else kind()


def of_some_size(kind):
    term = absent(kind)
    return term.at(0.5 * term.steps())


def acted_on(kind):
    if kind.acts_on in ("field", "velocity"):
        return RNG.normal(0.0, 2e4, (N, 3 if kind.acts_on == "field" else 2))
    return RNG.uniform(0.0, 360.0, N)


@pytest.mark.parametrize("kind", CATALOGUE, ids=lambda k: k.__name__)
def test_every_effect_has_complete_metadata(kind):
    assert kind.side in ("compass", "reference", "water", "clock")
    assert kind.stage in ("surroundings", "sensor", "readout", "clock")
    assert kind.literature and kind.fitted() and (kind.__doc__ or "").endswith(".")
    assert kind.side != "clock" or kind.acts_on == "time"
    assert (kind.side == "water") <= (kind.acts_on in ("water", "velocity")) <= (kind.side in ("water", "reference"))
    assert all(f.metadata["unit"] and f.metadata["meaning"] for f in fields(kind))


@pytest.mark.parametrize("kind", CATALOGUE, ids=lambda k: k.__name__)
def test_default_parameters_have_no_effect_and_others_a_finite_one(kind):
    x = acted_on(kind)
    assert kind() == absent(kind).at(0.0 * kind.steps()) or kind.dated()
    np.testing.assert_allclose(absent(kind).apply(x, MOVING), x, rtol=1e-12)
    changed = of_some_size(kind).apply(x, MOVING)
    assert changed.shape == x.shape and np.isfinite(changed).all() and np.abs(changed - x).max() > 0.0


@pytest.mark.parametrize("kind", COMPASS_AND_WATER, ids=lambda k: k.__name__)
def test_jacobian_equals_the_numeric_derivative_of_the_inverse(kind):
    simulation = ForwardModel(LEVEL, H_NT, (absent(kind),))
    recorded = recorded_heading(simulation, SCENE, HEADING)
    columns = heading_jacobian(simulation, SCENE, HEADING, first=5)
    for j, step in enumerate(kind.steps()):
        shift = 0.1 * step * (np.arange(len(kind.steps())) == j)
        shown = []
        for sign in (1.0, -1.0):
            moved = simulation.at(np.append(LEVEL, sign * shift))
            shown.append(invert_heading(moved, SCENE, recorded)[:, 0] + water_veer(moved, SCENE))
        numeric = angles.difference(*shown) / (0.2 * step)
        # The column is a one-sided difference over a twentieth of a step, with errors of about 0.01 degrees per step.
        np.testing.assert_allclose(columns[:, j] * step, numeric * step, atol=0.02, rtol=0.01)


NOBODY_LISTED = [
    place_effect(compose_effect("field_horizontal", "depth", "smooth"), 0.0, 20.0),
    place_effect(compose_effect("field_down", "temperature", "bands")),
    place_effect(compose_effect("reading", "heading", "harmonics")),
    place_effect(compose_effect("reading", "hour", "daily")),
    place_effect(compose_effect("field_horizontal", "time", "free"), TIME_S[0], TIME_S[-1]),
    place_effect(compose_effect("field_horizontal", "time", "creep"), TIME_S[0], 1e6),
    place_effect(compose_effect("reading", "pitch", "memory"), 1.5),
    place_effect(compose_effect("lobe3", "temperature", "linear")),
    place_effect(compose_effect("lobe4", "voltage", "linear")),
    place_effect(compose_effect("field_horizontal", "time", "box"), TIME_S[50], TIME_S[150]),
    place_effect(compose_effect("flow_gain", "speed", "linear")),
    place_effect(compose_effect("flow_offset", "time", "slow"), TIME_S[0], TIME_S[-1]),
    place_effect(compose_effect("reading", "temperature*time", "linear")),
]


@pytest.mark.parametrize("bare", NOBODY_LISTED, ids=lambda term: term.name)
def test_a_composed_effect_satisfies_the_rules_of_listed_ones(bare):
    x = acted_on(type(bare))
    np.testing.assert_allclose(bare.apply(x, SCENE), x, rtol=1e-12)
    term = bare.at(0.5 * bare.steps())
    simulation = ForwardModel(LEVEL, H_NT, (term,))
    recorded = recorded_heading(simulation, SCENE, HEADING)
    roots = invert_heading(simulation, SCENE, recorded)
    assert np.nanmin(np.abs(angles.difference(roots, HEADING[:, None])), axis=1).max() < 1e-5
    assert effect_by_name(term.name) is type(term) if term.name.startswith("composed:") else term.name in NAMES
    beside = added_term_jacobian(ForwardModel(LEVEL, H_NT), SCENE, HEADING, bare)
    alone = heading_jacobian(ForwardModel(LEVEL, H_NT, (bare,)), SCENE, HEADING, first=5)
    np.testing.assert_allclose(beside * bare.steps(), alone * bare.steps(), atol=0.02)


def test_added_term_jacobian_ignores_other_terms_on_the_reading():
    stands = Sextantal(6.0, -3.0)
    rival = Octantal()
    empty = ForwardModel(LEVEL, H_NT)
    beside = added_term_jacobian(ForwardModel(LEVEL, H_NT, (stands,)), FLAT, HEADING, rival)
    slopes = [heading_slope(x, FLAT, HEADING) for x in (empty, ForwardModel(LEVEL, H_NT, (stands,)))]
    alone = heading_jacobian(ForwardModel(LEVEL, H_NT, (rival,)), FLAT, HEADING, first=5)
    clear = np.abs(slopes[1]) > 0.3
    np.testing.assert_allclose((beside * slopes[1][:, None])[clear], (alone * slopes[0][:, None])[clear], atol=0.05)


def test_forward_model_without_terms_and_tilt_is_the_exact_compass():
    recorded = recorded_heading(ForwardModel(LEVEL, H_NT), FLAT, HEADING)
    assert np.abs(angles.difference(recorded, compass.recorded_heading(LEVEL, HEADING))).max() < 1e-9


def test_heeling_is_the_vertical_iron_of_the_tilted_compass():
    level = np.array([0.0, 0.25, -0.2, 0.02, 0.01])  # A = 0: it rotates the reading here and tilts with the iron there
    ours = recorded_heading(ForwardModel(level, H_NT, (Heeling(3000.0),)), SCENE, HEADING)
    soft = np.array([[1.02, 0.01, 0.0], [0.01, 0.98, 0.0], [0.0, 0.0, 1.0]])
    tilted = compass.level_coefficients(
        soft, np.array([0.25, -0.2, 3000.0 / H_NT]), horizontal_nT=1.0, vertical_nT=Z_NT / H_NT,
        pitch_deg=SCENE.pitch_deg, roll_deg=SCENE.roll_deg,
    )  # fmt: skip
    assert np.abs(angles.difference(ours, compass.recorded_heading(tilted, HEADING))).max() < 1e-9


def test_a_compass_without_compensation_reads_the_angle_in_its_own_plane():
    simulation = ForwardModel(np.zeros(5), H_NT, (TiltUncompensated(1.0),))
    body = earth_field_in_body(SCENE, HEADING)
    expected = angles.argument(body[:, 0] - 1j * body[:, 1])
    assert np.abs(angles.difference(recorded_heading(simulation, SCENE, HEADING), expected)).max() < 1e-9


def test_terms_compose_on_the_field_and_not_by_adding_deviations():
    warm = TemperatureOfField(2500.0, -1500.0)
    alone, with_iron = ForwardModel(np.zeros(5), H_NT, (warm,)), ForwardModel(LEVEL, H_NT, (warm,))
    turned = [angles.difference(recorded_heading(s, FLAT, HEADING), HEADING) for s in (alone, with_iron)]
    iron = angles.difference(compass.recorded_heading(LEVEL, HEADING), HEADING)
    assert angles.rms(turned[1] - turned[0] - iron) > 1.0


def at_its_bound(kind):
    """Return a term with parameters of fifteen steps each, or the largest that are invertible."""
    term = absent(kind)
    term = term.at(15.0 * kind.steps())
    while not term.possible:
        term = term.at(0.97 * term.values)
    return term


STRONG = np.array([0.03, -0.9, 0.95, 0.03, -0.02])  # iron stronger than the earth's horizontal field


@pytest.mark.parametrize("iron", [LEVEL, STRONG], ids=["weak", "strong"])
@pytest.mark.parametrize(
    "kind", [kind for kind in COMPASS_AND_WATER if kind.side == "compass"], ids=lambda k: k.__name__
)
def test_inverse_contains_the_heading_for_large_combined_effects(kind, iron):
    beside = [other for other in (Heeling, TemperatureOfField, Sextantal, Octantal) if other is not kind]
    terms = sorted([at_its_bound(kind), *map(of_some_size, beside)], key=lambda term: CATALOGUE.index(type(term)))
    simulation = ForwardModel(iron, H_NT, tuple(terms))
    recorded = recorded_heading(simulation, SCENE, HEADING)
    roots = invert_heading(simulation, SCENE, recorded)
    # At a fold, where two headings merge, a rounding error of the reading becomes its square root in the heading.
    assert np.nanmin(np.abs(angles.difference(roots, HEADING[:, None])), axis=1).max() < 1e-3
    again = [recorded_heading(simulation, SCENE, root) for root in roots.T]
    assert np.nanmax(np.abs(angles.difference(np.array(again), recorded))) < 1e-5


@pytest.mark.parametrize("kind", [Sextantal, Octantal])
@pytest.mark.parametrize("turns", [0.2, 0.6, 0.79, 0.95, 0.999])
def test_a_harmonic_is_inverted_if_the_reading_is_monotonic(kind, turns):
    amplitude = turns * 57.29577951 / kind.order
    term = kind(0.6 * amplitude, -0.8 * amplitude)
    x = np.linspace(-400.0, 800.0, 12_345)
    assert np.abs(term.invert(term.apply(x, FLAT), FLAT) - x).max() < 1e-6  # at 0.999 the least slope is 0.001
    assert term.possible


@pytest.mark.parametrize("kind", [Sextantal, Octantal])
def test_a_non_monotonic_harmonic_has_no_inverse(kind):
    simulation = ForwardModel(LEVEL, H_NT, (kind(0.75 * 57.3 / kind.order, 0.75 * 57.3 / kind.order),))
    recorded = recorded_heading(simulation, FLAT, HEADING)
    assert not simulation.terms[0].possible
    assert np.isnan(invert_heading(simulation, FLAT, recorded)).all()


def test_every_effect_listed_for_moorings_is_tested_in_one():
    tried, _ = comparison.testable_effects(SCENE, reference_magnetic=False)
    found_apart = {kind for kind in CATALOGUE if kind.detector}
    assert set(tried) - found_apart == {kind for kind in CATALOGUE if "mooring" in kind.recordings} - found_apart


def test_the_page_of_the_catalogue_is_up_to_date():
    docs = Path(__file__).resolve().parents[2] / "docs"
    made = runpy.run_path(str(docs / "physics.py"))["page"]()
    assert (docs / "physics.md").read_text() == made, "run python docs/physics.py > docs/physics.md"


def test_sizes_are_excluded_only_without_a_unique_heading():
    """Regression test: bounds of plausible sizes set the true cause to zero, and another one was found instead."""
    large = [CompassLag(-300.0), PivotFriction(9.0), BeamGain(0.5), TiltUncompensated(0.2), Heeling(60e3)]
    assert all(term.possible for term in large)
    assert not any(term.possible for term in (Sextantal(20.0), LevelSoftIron(0.8, 0.8), SoftIronInSpace(vertical=-1.2)))
    assert not LateCourse(-1.0).possible  # a negative lag of the course is a lag of the reading


def test_the_specified_effects_have_physics_text_and_are_separated_by_listed_ones():
    names = {term.name for term in CATALOGUE}
    assert names == set(NAMES) and names <= wording.PHYSICS.keys()
    for term in CATALOGUE:
        assert set(term.separated_by) <= names - {term.name}, term.__name__
