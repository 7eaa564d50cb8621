"""Would catch a wrong evidence or rank in the search of short recordings."""

from __future__ import annotations

import numpy as np
import pytest

from compasslib import angles, compass
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds import platform
from compasslib.inference.short_options import AMPLITUDES, WHITE, log_evidence
from compasslib.statistics.noise import arma_innovations, arma_series
from tests.world.bench import MILD, ring


def bench(error, seed: int, rounds: int = 2) -> Diagnosis:
    """Diagnose 24 headings a round, with noise of 0.3 degrees and an error, a function of reading and elapsed share."""
    correct = np.tile(ring(24), rounds)
    recorded = compass.recorded_heading(MILD, correct)
    recorded = recorded + error(recorded, np.linspace(0.0, 1.0, len(correct)))
    noise = np.random.default_rng(seed).normal(0.0, 0.3, len(correct))
    return platform.diagnose_readings(correct, angles.wrap360(recorded + noise), field=None, options=Options())


def test_evidence_is_that_of_students_law():
    rng = np.random.default_rng(1)
    base, columns, residual = rng.normal(size=(14, 3)), rng.normal(size=(14, 2)), rng.normal(size=14)
    found = log_evidence(WHITE, base, columns, np.array([0, 2]), residual[:, None])
    logs = []
    for amplitude in (0.0, *AMPLITUDES):
        precision = np.linalg.inv(np.eye(14) + amplitude**2 * columns @ columns.T)
        fitted = base.T @ precision @ base
        left = residual - base @ np.linalg.solve(fitted, base.T @ precision @ residual)
        determinants = np.linalg.slogdet(fitted)[1] - np.linalg.slogdet(precision)[1]
        logs.append(-0.5 * determinants - 0.5 * (14 - 3) * np.log(left @ precision @ left))
    assert found[0][0] == pytest.approx(logs[0], abs=1e-6)
    expected = np.logaddexp.reduce(logs[1:]) - np.log(len(AMPLITUDES)) - logs[0]
    assert found[1][0, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("law", [(0.0, 0.0), (0.9, -0.4), (0.5, 0.0)])
def test_a_series_has_its_innovations_back(law):
    white = np.random.default_rng(2).normal(size=(400, 3))
    series = arma_series(white, law)
    np.testing.assert_allclose(arma_innovations(series, law), white, atol=1e-9)
    assert law == (0.0, 0.0) or np.corrcoef(series[1:, 0], series[:-1, 0])[0, 1] > 0.3


def test_ranks_of_benches_without_effects_are_even():
    ranks = np.array([bench(lambda g, t: 0.0, seed).detection.rank_p for seed in range(40)])
    assert np.sum(ranks <= 0.01) <= 1 and 0.3 < np.median(ranks) < 0.7


def test_an_effect_ranks_above_all_surrogates():
    found = bench(lambda g, t: 2.0 * angles.sin_cos(3.0 * g)[0], 3)
    assert found.detection.rank_p == 1 / 200 and found.detection.n_surrogates == 199
    assert [item.effect for item in found.findings] == ["sextantal"] and found.findings[0].probability > 0.95


def test_two_effects_are_both_named():
    found = bench(lambda g, t: 2.0 * angles.sin_cos(3.0 * g)[0] + 3.0 * (t > 0.6), 4)
    assert (found.verdict, {item.effect for item in found.findings}) == ("explained", {"sextantal", "heading_slip"})


def test_two_harmonics_are_not_one_composed_effect():
    found = bench(lambda g, t: 2.0 * angles.sin_cos(3.0 * g)[0] + 2.0 * angles.sin_cos(4.0 * g)[0], 1)
    assert (found.verdict, {item.effect for item in found.findings}) == ("explained", {"sextantal", "octantal"})


def test_what_only_a_composed_effect_describes_is_unexplained():
    found = bench(lambda g, t: 2.0 * angles.sin_cos(7.0 * g)[0], 5)
    assert found.verdict == "unexplained" and found.unexplained.covariates == ("heading",)
    assert found.unexplained.rms_effect_deg == pytest.approx(2.0 / np.sqrt(2.0), rel=0.2)
