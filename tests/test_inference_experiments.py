"""Suggested observations: their probabilities of an unambiguous verdict, by the information that they add."""

import numpy as np
import pytest
from test_inference_mooring import seen

from compasslib.inference import experiments
from compasslib.inference.experiments import ANYTHING, Rows


@pytest.fixture(scope="module")
def ambiguous():
    """Slow drift of iron over half a year, confounded with the falling supply voltage."""
    drawn, found = seen({"hard_iron_drift": 1.5}, seed=12)
    return drawn, found


def test_ambiguous_findings_have_experiments_with_probabilities(ambiguous):
    _, found = ambiguous
    assert found.verdict == "ambiguous"
    chances = [chance for _, chance in found.experiments]
    assert len(chances) >= 3 and all(0.0 <= one <= 1.0 for one in chances) and chances == sorted(chances, reverse=True)
    written = found.to_json()["experiments"]
    assert [(one["what"], one["probability"]) for one in written] == list(found.experiments)


def test_free_nuisances_reduce_the_information_of_an_observation():
    rng = np.random.default_rng(3)
    known = rng.normal(size=(50, 2))
    free = Rows(known, np.ones((50, 1)), np.full(1, 1.0 / ANYTHING)).information
    centred = known - known.mean(axis=0)
    np.testing.assert_allclose(free, centred.T @ centred, rtol=1e-5)
    fixed = Rows(known, np.ones((50, 1)), np.full(1, 1e9)).information
    np.testing.assert_allclose(fixed, known.T @ known, rtol=1e-5)


def test_a_trend_is_extrapolated_and_other_series_are_repeated():
    time_s = np.arange(1000.0)
    falling, season = 40.0 - 0.004 * time_s, np.sin(time_s / 30.0)
    np.testing.assert_allclose(experiments._continued(falling, time_s, 1000.0), falling - 4.0)
    np.testing.assert_array_equal(experiments._continued(season, time_s, 1000.0), season)


def test_the_share_of_single_names_follows_the_verdict():
    """An effect is certain by its total probability; equal ones leave two names; no effect at 0.8 is uncertain."""
    names = [(), ("heeling",), ("current_veer", "heeling"), ("temperature",)]
    draws = np.array([[0.0, 0.6, 0.38, 0.02], [0.0, 0.5, 0.0, 0.5], [0.8, 0.2, 0.0, 0.0], [0.97, 0.03, 0.0, 0.0]]).T
    each = [experiments._single_name_share(names, draws[:, k : k + 1]) for k in range(4)]
    assert each == [1.0, 0.0, 0.0, 1.0] and experiments._single_name_share(names, draws) == 0.5
