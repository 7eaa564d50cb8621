"""Would catch a stated uncertainty of headings that leaves out the reference's own compass, or counts it twice."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles
from compasslib.deviation import fit_deviation
from compasslib.deviation.correction import correct, reference_modes
from compasslib.deviation.model import ALIGNMENT_SIGMA_DEG, STUDENT_68, constant_sigma, reference_compass
from compasslib.records import ReferenceCompass
from tests.world.sea import field_of, pairs, record_of

STATED = ReferenceCompass("deep", 2.0, 2.0)


def by_reference(seen, off_deg, **others):
    """Turn the reference's directions, clockwise."""
    east, north = angles.turn(seen.lower_east, seen.lower_north, off_deg)
    return replace(seen, lower_east=east, lower_north=north, **others)


@pytest.mark.parametrize("apart_deg", [0.0, 9.0])
def test_share_of_the_reference_in_a_constant_is_that_of_draws(apart_deg):
    rng = np.random.default_rng(5)
    own, error = rng.normal(0.0, ALIGNMENT_SIGMA_DEG, 2_000_000), 2.0 / STUDENT_68 * rng.standard_t(4.0, 2_000_000)
    near = np.abs(own + error - apart_deg) < 0.2
    # With n near the sum, the rms of the draws has a relative error of a percent.
    assert constant_sigma(apart_deg, 0.0, 2.0) == pytest.approx(angles.rms(error[near]), rel=0.03)


@pytest.mark.parametrize("method", ["exact", "von_appen"])
def test_modes_are_the_changes_that_an_error_of_the_reference_makes(method):
    seen, _ = pairs((0.0, 0.15, 0.1, 0.0, 0.0), n=2000, seed=8)
    psi = angles.wrap360(40.0 * np.sin(np.arange(2000) / 50.0) + np.arange(2000) / 11.0)
    seen = replace(seen, lower_heading_deg=psi, compass=STATED)
    fit, (sine, cosine) = fit_deviation(method, seen), angles.sin_cos(psi)
    corrected = correct(record_of(seen), fit, field_of(seen), seen)
    modes = reference_modes(fit, corrected.heading_corrected_deg)
    for k, pattern in ((1, sine), (2, cosine)):
        moved = fit_deviation(method, by_reference(seen, STATED.iron_deg * pattern))
        after = correct(record_of(seen), moved, field_of(seen), seen)
        change = angles.difference(after.heading_corrected_deg, corrected.heading_corrected_deg)
        at = modes[:, k]
        # The response is linear; the published series, whose abscissa moves too, follows it to a factor.
        apart = angles.rms(angles.difference(change, at))
        assert apart < (0.04 if method == "exact" else 0.8) * max(angles.rms(at), 0.5)


def test_true_references_add_the_declination_and_given_values_count():
    seen, _ = pairs(n=40)
    field = field_of(seen)
    assert reference_compass("deep", field, magnetic=True).declination_deg == 0.0
    assert reference_compass("deep", field, magnetic=False).sigma_deg > 2.0
    gyro = reference_compass("deep", field, magnetic=False, sigma_deg=0.0, iron_nT=0.0)
    assert gyro.sigma_deg == gyro.iron_deg == 0.0 < gyro.declination_deg


def test_headings_lie_in_their_interval_where_the_reference_errs():
    """Of 16 moorings whose reference errs as ``STATED``; the standard error of the share within 95 % is 2.5 %."""
    rng, inside = np.random.default_rng(77), []
    for k in range(16):
        seen, heading = pairs((np.tan(np.deg2rad(rng.normal(0.0, 4.0))), 0.3, 0.1, 0.03, 0.0), n=600, seed=100 + k)
        psi = angles.wrap360(rng.uniform(0.0, 360.0) + np.cumsum(rng.normal(0.0, 9.0, 600)))
        sine, cosine = angles.sin_cos(psi)
        off = rng.normal(0.0, 2.0) + rng.normal(0.0, 2.0) * sine + rng.normal(0.0, 2.0) * cosine
        seen = by_reference(seen, off, lower_heading_deg=psi, compass=STATED)
        fit = fit_deviation("exact", seen)
        fits = fit, replace(fit, reference=None)
        made, sure = (correct(record_of(seen), one, field_of(seen), seen) for one in fits)
        error = np.abs(angles.difference(made.heading_corrected_deg, heading))
        inside.append([np.mean(error < 1.96 * one.heading_uncertainty_deg) for one in (made, sure)])
        assert np.all(made.heading_common_deg <= made.heading_uncertainty_deg)
    stated, sure = np.mean(inside, axis=0)
    assert 0.9 < stated < 0.99 and sure < 0.88
