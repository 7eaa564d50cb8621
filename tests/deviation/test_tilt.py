"""Would catch a tilted compass treated as level, heeling iron missed, or found where there is none."""

import json
from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles, compass
from compasslib.deviation import fit_deviation
from compasslib.deviation.correction import correct_headings, readings_at_pairs
from compasslib.deviation.exact import fit_exact
from compasslib.deviation.model import fit_from_json
from compasslib.deviation.tilt import fit_tilt, tilted_coefficients
from tests.world.pairs import red_from_rest as red_noise
from tests.world.sea import FOLDED, MILD, pairs

DIP = 4.35


def tilted_pairs(heeling: float, n: int = 5000, iron=MILD):
    """Simulate pairs recorded with a tilted compass, and the correct headings."""
    rng = np.random.default_rng(7)
    seen, heading = pairs(iron, n=n, seed=2)
    pitch, roll = 2.0 + red_noise(rng, n, 8, 5.0), -3.0 + red_noise(rng, n, 8, 5.0)
    at = tilted_coefficients(np.array(iron), heeling, DIP, pitch, roll)
    recorded = angles.wrap360(compass.recorded_heading(at, heading) + rng.normal(0.0, 0.5, n))
    upper = angles.turn(seen.upper_east, seen.upper_north, angles.difference(recorded, seen.heading_deg))
    return replace(
        seen, heading_deg=recorded, pitch_deg=pitch, roll_deg=roll, upper_east=upper[0], upper_north=upper[1]
    ), heading


def test_without_tilt_it_is_the_level_compass():
    at = tilted_coefficients(np.array(MILD), 0.3, DIP, np.zeros(3), np.array([0.0, np.nan, 0.0]))
    assert at == pytest.approx(np.tile(np.array(MILD)[:, None], 3))


def test_heeling_is_recovered_and_the_headings_gain():
    seen, heading = tilted_pairs(0.6)
    level = fit_exact(seen)
    fitted = fit_tilt(seen, level, DIP)
    sigma = np.sqrt(np.diag(fitted.covariance))
    assert sigma[5] < 0.1 and abs(fitted.heeling - 0.6) < 4.0 * sigma[5]
    at = tilted_coefficients(fitted.coefficients, fitted.heeling, DIP, seen.pitch_deg, seen.roll_deg)
    before, after = (angles.rms(compass.inverse(k, seen.heading_deg)[:, 0] - heading) for k in (level.coefficients, at))
    assert after < 0.7 * before


@pytest.mark.parametrize("iron", [MILD, FOLDED])
def test_headings_of_a_tilted_compass_are_corrected(iron):
    seen, heading = tilted_pairs(0.6, n=4000, iron=iron)
    fits = (fit_deviation("exact", seen), fit_deviation("exact", seen, dip_ratio=DIP))
    level, tilted = (correct_headings(readings_at_pairs(seen), fit, seen) for fit in fits)
    before, after = (np.abs(angles.difference(found.heading_deg, heading)) for found in (level, tilted))
    assert np.median(after) < 0.7 * np.median(before)
    assert np.mean(after < 1.96 * tilted.sigma_deg) > 0.93


def test_a_tilted_fit_is_restored_from_json():
    seen, _ = tilted_pairs(0.6, n=600)
    fitted = fit_deviation("exact", seen, dip_ratio=DIP)
    again = fit_from_json(json.loads(json.dumps(fitted.to_json())))
    assert again.tilted and again.heeling == fitted.heeling and again.covariance.shape == (6, 6)


def test_no_heeling_is_found_where_there_is_none():
    fitted = fit_tilt(*(seen := tilted_pairs(0.0)[0], fit_exact(seen)), DIP)
    assert abs(fitted.heeling) < 3.5 * np.sqrt(fitted.covariance[5, 5])


def test_heeling_is_undetermined_by_a_constant_tilt():
    seen, _ = tilted_pairs(0.3, n=2000)
    steady = replace(seen, pitch_deg=np.zeros(2000), roll_deg=np.zeros(2000))
    fitted = fit_tilt(steady, fit_exact(steady), DIP)
    assert abs(fitted.heeling) < 1e-6 and fitted.covariance[5, 5] < 1.0
