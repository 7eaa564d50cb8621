"""What to measure next: chances follow what an observation can tell."""

import numpy as np
import pytest
from test_inference_mooring import seen

from compasslib.inference import experiments
from compasslib.inference.experiments import ANYTHING, Rows


@pytest.fixture(scope="module")
def ambiguous():
    """A slow drift of iron in half a year, which the falling supply voltage follows."""
    drawn, found = seen({"hard_iron_drift": 1.5}, seed=12)
    return drawn, found


def test_chances_are_stated_where_a_set_has_several_names(ambiguous):
    _, found = ambiguous
    assert found.verdict == "ambiguous"
    chances = [chance for _, chance in found.experiments]
    assert len(chances) >= 3 and all(0.0 <= one <= 1.0 for one in chances) and chances == sorted(chances, reverse=True)
    written = found.to_json()["experiments"]
    assert [(one["what"], one["probability"]) for one in written] == list(found.experiments)


def test_what_an_observation_brings_of_its_own_takes_from_what_it_tells():
    rng = np.random.default_rng(3)
    known = rng.normal(size=(50, 2))
    free = Rows(known, np.ones((50, 1)), np.full(1, 1.0 / ANYTHING)).information
    centred = known - known.mean(axis=0)
    np.testing.assert_allclose(free, centred.T @ centred, rtol=1e-5)
    fixed = Rows(known, np.ones((50, 1)), np.full(1, 1e9)).information
    np.testing.assert_allclose(fixed, known.T @ known, rtol=1e-5)


def test_a_series_that_only_falls_goes_on_and_others_come_back():
    time_s = np.arange(1000.0)
    falling, season = 40.0 - 0.004 * time_s, np.sin(time_s / 30.0)
    np.testing.assert_allclose(experiments._continued(falling, time_s, 1000.0), falling - 4.0)
    np.testing.assert_array_equal(experiments._continued(season, time_s, 1000.0), season)


def test_one_name_is_left_where_the_verdict_would_have_it():
    """A name is sure whatever else may stand beside it; an even contest leaves two, a probable nothing is not sure."""
    names = [(), ("heeling",), ("current_veer", "heeling"), ("temperature",)]
    draws = np.array([[0.0, 0.6, 0.38, 0.02], [0.0, 0.5, 0.0, 0.5], [0.8, 0.2, 0.0, 0.0], [0.97, 0.03, 0.0, 0.0]]).T
    each = [experiments._single_name_share(names, draws[:, k : k + 1]) for k in range(4)]
    assert each == [1.0, 0.0, 0.0, 1.0] and experiments._single_name_share(names, draws) == 0.5
