"""Would catch probabilities that do not add up, or that ignore prior odds, slow noise or held-out days."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import discrepancy as bench
from benchmarks.discrepancy import field_of, fitted
from compasslib import angles
from compasslib.deviation.average import CompassSeries, average_compasses
from compasslib.effects import SIDES
from compasslib.effects.effect import YEAR_S
from compasslib.inference import design, heldout, linear_model, noise, places, search
from compasslib.inference.finding import Detection
from compasslib.inference.kinds.mooring import diagnose
from compasslib.inference.linear_model import AMPLITUDES_DEG, linearize
from tests.world import pairs as world
from tests.world.diagnosed import seen, state_of


def inferred(wanted, seed, n=6000):
    drawn = world.planted(world.make(seed, wide=True, n=n), wanted)
    return drawn, search.infer(design.refit(state_of(drawn), []), 1.0, 199)


@pytest.fixture(scope="module")
def lobes():
    return inferred({"octantal": 3.0}, 8)


@pytest.fixture(scope="module")
def iron():
    return inferred({"hard_iron_drift": 2.0}, 5, n=2500)


def test_probabilities_add_up(lobes, iron):
    for _, found in (lobes, iron):
        for place in (*found.places, found.further):
            assert place.probability.sum() + place.none == pytest.approx(1.0)
            assert place.evidence.noise_probability().sum() == pytest.approx(1.0)
        assert sum(found.sides().values()) == pytest.approx(1.0)
        assert sum(weight for weight, _ in found.weighted) <= 1.0 + 1e-9
        for chances in found.chances:
            assert 0.95 <= sum(chances.values()) <= 1.0 + 1e-9
            assert {name for name in [*chances][1:] if not name.startswith("composed:")} <= set(SIDES)
        assert np.exp([option.share for option in found.model.options]).sum() == pytest.approx(1.0)


def test_the_true_effect_and_its_side_are_most_probable(lobes):
    drawn, found = lobes
    assert [next(iter(chances)) for chances in found.chances] == list(drawn.truth)
    assert found.sides()["compass"] > 0.99
    first, further = found.detections
    assert first.rank_p == 0.005 and further.rank_p > 0.01  # of 199 surrogates


def test_products_give_the_evidence_of_the_gaussian_model(lobes):
    """The log Bayes factor of one option equals that of the dense covariance of the whitened residual."""
    _, found = lobes
    model, water, option = found.model, found.slow_noise, 0
    rows = np.linspace(0, len(model.residual) - 1, 300).astype(int)  # a part of the record, to invert its covariance
    part = replace(model, white=model.white[rows], freed=replace(model.freed, innovation=model.freed.innovation[rows]))
    white, ends = part.white.astype(float), part.products.ends
    slow = white[:, ends[-1] :] * np.sqrt(model.slow.variances(water))
    columns = white[:, ends[option] : ends[option + 1]]
    logs = []
    for amplitude in (0.0, *AMPLITUDES_DEG):
        covariance = np.eye(300) + slow @ slow.T + amplitude**2 * columns @ columns.T
        logs.append(
            -0.5 * part.residual @ np.linalg.solve(covariance, part.residual) - 0.5 * np.linalg.slogdet(covariance)[1]
        )
    expected = np.logaddexp.reduce(logs[1:]) - np.log(len(AMPLITUDES_DEG)) - logs[0]
    assert part.marginalized(water).evidence[option, 0] == pytest.approx(expected, abs=0.02)


def test_an_effect_at_its_limit_is_detected_in_nine_of_ten_simulations(iron):
    _, found = iron
    model, last = found.model, found.detections[-1]
    k = next(k for k, option in enumerate(model.options) if option.name == "octantal")
    visible = model.freed.visible(model.options[k].columns)
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(2, 199))
    direction *= found.limits["octantal"] / np.sqrt(np.mean((visible @ direction) ** 2, axis=0))
    drawn = model.draw(found.further.evidence, 199, 77, found.entered)
    planted = drawn + model.white[:, model.products.columns(k)] @ direction.astype(np.float32)
    score = model.scores(planted)
    statistic = model.weigh(found.further.evidence.likely_noises, found.entered, score).statistic
    # The limit counts the evidence of the effect alone, detection that of any option, which is larger.
    assert 0.8 < np.mean(statistic >= max(last.threshold, search.LIKELY)) < 0.99


def test_a_step_is_dated_to_the_sample():
    drawn = world.planted(world.make(8, wide=True, n=6000), {"hard_iron_step": 4.0})
    state = design.refit(state_of(drawn), [])
    kind = next(kind for kind in state.comparison.terms if kind.name == "hard_iron_step")
    dates, shares = linear_model.search_dates(state, design.term_columns(state, kind()))
    assert shares.sum() == pytest.approx(1.0) and len(dates) < 150
    assert np.abs(dates - drawn.truth["hard_iron_step"]["date_s"]).min() <= 3600.0


def test_a_veering_current_is_stated_by_its_driver():
    _, found = seen({"current_veer": 4.0}, seed=14)
    assert found.verdict in ("explained", "ambiguous") and not found.findings and found.sides["water"] > 0.5
    written = found.to_json()["current"]
    assert {one["level"] for one in written} <= {"driver", "side"} and written[0]["unit"] == "degrees"
    assert written[0]["driver"] == "speed" and written[0]["low"] < 4.0 < 1.3 * written[0]["high"]
    assert not found.applied or not any(one.compass for one in found.applied[:1] if one.effect == "none")


@pytest.mark.parametrize(("acts_on", "driver"), [("offset", "tide"), ("veer", "tilt")])
def test_reading_and_current_with_the_same_driver_share_the_probability(acts_on, driver):
    """Both yield nearly the same pairs. Regression test: the current, treated as noise, took all of the probability."""
    made = world.make(3, wide=True, n=4000)
    series = {"tide": np.cos(2.0 * np.pi * made.hours / 12.4206), "tilt": made.tilt[1] - made.tilt[1].mean()}[driver]
    effect = world.Effect({}, **{acts_on: series if acts_on == "veer" else lambda gamma: series})
    drawn = world.planted(made, {driver: 3.0}, {driver: effect})
    fit, field = fitted(drawn), field_of(drawn)
    found = diagnose(drawn.pairs, drawn.covariates, fit, field)
    corrected, _ = bench.corrected(drawn, fit, field, found)
    off = np.abs(angles.difference(corrected.heading_deg, drawn.heading))
    assert np.mean(off < 1.96 * corrected.sigma_deg) > 0.75  # the current is likelier beforehand
    right = "compass" if acts_on == "offset" else "water"
    assert found.sides[right] > 0.2 and found.sides["compass"] + found.sides["water"] > 0.9
    contested = [stated for stated in found.current if stated.probability < 0.95]
    if contested:
        assert found.verdict == "ambiguous" and "second current meter" in found.separated_by
        assert contested[0].driver == driver and "whose reading follows" in contested[0].text


def test_an_uninformative_record_states_no_current():
    drivers = ("speed", "depth", "tide", "tilt", "motion", "flow_direction", "velocity_bias", "beam_gain")
    unknown = noise.infer_current(drivers, 1e-9 * np.eye(8), np.zeros(8))
    assert unknown.acting == pytest.approx(0.5, abs=0.01)
    probability, stated = unknown.statements(16.0 * np.eye(8), 0.5)
    assert probability < 0.51 and not stated
    known = noise.infer_current(drivers, np.diag([1e3, *[1e-9] * 7]), np.array([1e3, *[0.0] * 7]))
    probability, stated = known.statements(16.0 * np.eye(8), 0.5)
    assert probability > 0.95 and stated[0].driver == "speed" and 3.5 < stated[0].size_deg < 4.5


def test_slow_noise_columns_have_the_variance_of_the_process(lobes):
    _, found = lobes
    slow = noise.slow_noise_basis(found.fitted.comparison)
    water = noise.SlowNoise(noise.Process(3.0, 20.0), noise.Process(0.0, 5.0), 0.0)
    count = len(slow.frequency)
    square = slow.columns[:, :count] ** 2 @ slow.variances(water)[:count]
    # Periods below eight days are not represented; the variance is larger at both ends of the recording.
    assert 0.85 * 9.0 < np.mean(square) < 1.1 * 9.0


def test_tidal_columns_represent_tidal_shear(lobes):
    drawn, found = lobes
    slow, pairs = noise.slow_noise_basis(found.fitted.comparison), drawn.pairs
    waves = slow.columns[:, 3 * len(slow.frequency) : slow.season[0]]
    moon = np.sin(2.0 * np.pi * (pairs.time_s - pairs.time_s[0]) / 3600.0 / 12.4206)
    still = angles.direction(pairs.lower_east, pairs.lower_north)
    turned = angles.difference(angles.direction(pairs.lower_east + 0.01 * moon, pairs.lower_north), still)
    fast = np.hypot(pairs.lower_east, pairs.lower_north) > 0.05
    sizes, *_ = np.linalg.lstsq(waves[fast], turned[fast], rcond=None)
    assert sizes[0] == pytest.approx(0.01, rel=0.3) and np.abs(sizes[1:]).max() < 0.003


def test_held_out_days_confirm_a_true_effect(lobes, monkeypatch):
    _, found = lobes
    made, predict = [], heldout._PartitionedRecord.predict
    monkeypatch.setattr(heldout._PartitionedRecord, "predict", lambda *given: made.append(given) or predict(*given))
    proof = heldout.cross_validate(found, 0, surrogates=19)
    # No day enters its own prediction: other residuals in the first fold change only predictions of the other folds.
    record, targets = made[0]
    other = np.where(record.folds[0][:, None], -targets, targets)
    before, after = (predict(record, each).values for each in (targets, other))
    assert np.allclose(before[0], after[0], rtol=1e-4, atol=1e-6) and not np.allclose(before[1:], after[1:], rtol=0.01)
    points, slope = proof.points, proof.slope.value
    assert np.allclose(points.after_deg, points.before_deg - points.centre) and len(points.centre) == 8
    assert np.sum((points.before_deg - slope * points.centre) ** 2 / points.sigma_deg**2) < 20.0  # 8 points, 1 slope
    assert np.all(slope * points.centre[[0, 1, -2, -1]] / points.sigma_deg[[0, 1, -2, -1]] * [-1, -1, 1, 1] > 2.0)
    assert abs(slope - 1.0) < 0.1 and proof.slope.high - proof.slope.low < 0.5
    assert proof.method == "interleaved" and proof.gain > 10.0 and proof.p_value < 0.01
    assert proof.rms_after_deg < proof.rms_before_deg
    assert proof.placebo.n == 19 and proof.placebo.rank_p == 0.05 and proof.confirmed  # no surrogate gains as much
    assert proof.anew.low > 0.0 and proof.slope.low < 1.0 < proof.slope.high
    assert 2.0 < proof.amplitude.low < proof.amplitude.fitted_elsewhere < proof.amplitude.high < 4.0


def test_changed_iron_is_held_out_in_blocks(iron):
    _, found = iron
    assert found.model.options[found.chosen[0]].block[2] in ("time", "voltage")
    proof = heldout.cross_validate(found, 0, surrogates=0)
    assert proof.placebo.rank_p is None and not proof.confirmed
    assert proof.method == "interleaved"


def compass_off_by(deg: float, weight: float, others: tuple[CompassSeries, ...] = ()) -> CompassSeries:
    """Make a compass without deviation whose reading is off by a constant, with a standard error of 1°."""
    reading = np.arange(0.0, 360.0, 30.0) + deg
    turned = lambda heading_deg: np.ones((len(heading_deg), 1))  # noqa: E731
    return CompassSeries(reading, np.zeros(5), np.eye(1), turned, weight=weight, others=others)


def test_equal_weights_average_headings_and_widen_sigma():
    at = compass_off_by(0.0, 0.5, (compass_off_by(4.0, 0.5),))
    made = average_compasses(at, np.arange(0.0, 360.0, 30.0))
    assert made.shift_deg == pytest.approx(2.0, abs=1e-9)
    assert made.sigma_deg == pytest.approx(np.hypot(1.0, 2.0))
    assert np.all(made.agreed == 0.5)  # they are four standard errors apart
    sure = average_compasses(replace(at, weight=0.97, others=(compass_off_by(4.0, 0.03),)), np.zeros(12))
    assert np.all(sure.agreed > 0.9) and np.all(np.abs(angles.wrap180(sure.shift_deg)) < 0.2)


def test_season_columns_represent_a_yearly_veer(lobes):
    _, found = lobes
    slow, time_s = noise.slow_noise_basis(found.fitted.comparison), found.fitted.comparison.scene.time_s
    veer, columns = np.cos(2.0 * np.pi * time_s / YEAR_S + 1.0), slow.columns[:, slow.season]
    sizes, *_ = np.linalg.lstsq(columns, veer, rcond=None)
    np.testing.assert_allclose(columns @ sizes, veer, atol=1e-6)
    assert any(np.all(slow.variances(each)[slow.season][:4] > 0.0) for each in slow.slow_noises())


def test_the_larger_p_value_of_both_kinds_of_surrogates_counts():
    low, high = np.linspace(-2.0, 1.0, 199), np.linspace(-2.0, 4.0, 199)
    detection = Detection.by_rank(2.0, [low, high])
    assert detection.rank_p > 0.3 and not detection.significant and detection.threshold > 3.9
    assert Detection.by_rank(2.0, [low]).significant and not Detection.by_rank(2.0, []).significant


@pytest.mark.parametrize(
    ("count", "higher", "detected"),
    [(199, 1, True), (199, 2, False), (19, 0, True), (19, 1, False), (18, 0, False)],
)
def test_few_surrogates_detect_what_exceeds_all_of_them(count, higher, detected):
    detection = Detection.by_rank(2.0, [np.append(np.zeros(count - higher), np.full(higher, 3.0))])
    assert detection.significant == detected
    assert (detection.threshold is None) == (count == 18)


def test_surrogates_with_random_signs_keep_the_noise_of_each_time():
    state = state_of(world.planted(world.make(8, wide=True, n=4000), {}))
    model = linearize(state, slow := noise.slow_noise_basis(state.comparison))
    calm = np.arange(4000) >= 1000
    drawn = model.draw(model.weigh(slow.slow_noises()[:1]), 50, 1, (), np.where(calm, 0.0, 1.0).astype(np.float32))
    assert np.std(drawn[calm]) < 0.2 * np.std(drawn[~calm])
    assert abs(np.mean(drawn[~calm])) < 0.2 * np.std(drawn[~calm])


def test_the_constant_is_not_lost_beside_slow_noise():
    """A constant veer looks like A: with it in the noise, rounding errors moved A by 9 degrees here."""
    initial = design.refit(state_of(world.planted(world.make(7, wide=False, n=3000), {"hard_iron_step": 3.0})), [])
    slow, constants = noise.slow_noise_basis(initial.comparison), []
    for size_deg in (0.001, 10.0):
        slow_noise = noise.SlowNoise(noise.Process(size_deg, 170.0), noise.Process(0.0, 5.0), 0.0)
        fitted = design.refit(places.with_slow_noise(initial, initial, slow, slow_noise), [])
        constants.append(np.rad2deg(fitted.simulation.coefficients[0]))
    assert abs(constants[1] - constants[0]) < 1.0
