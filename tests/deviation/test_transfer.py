"""Would catch coefficients carried to another place against the physics, or without a wider interval."""

import numpy as np
import pytest

from compasslib import compass
from compasslib.archive import netcdf
from compasslib.archive.files import read_json, write_json
from compasslib.deviation.model import (
    IRON_NT,
    SPHERE_NT,
    FieldAtPlace,
    PlacedCoefficients,
    iron_design,
    transfer_coefficients,
)
from compasslib.records import EarthField
from compasslib.stages import Files
from compasslib.stages import fit as fit_stage
from tests.world.sea import pairs, record_of

ENDS = {"record": "nc", "pairs": "nc", "field": "json", "fit": "json"}
BREST, GREENLAND = FieldAtPlace(21000.0, 43000.0), FieldAtPlace(11980.0, 52078.0)
ICELAND = FieldAtPlace(13300.0, 50200.0)
SOFT = np.eye(3) + np.array([[0.02, 0.01, 0.05], [-0.01, -0.02, -0.03], [0.0, 0.0, 0.0]])
HARD = (4000.0, -2000.0, 1000.0)


def at(place: FieldAtPlace, soft=SOFT, hard=HARD):
    return compass.level_coefficients(soft, hard, horizontal_nT=place.horizontal_nT, vertical_nT=place.vertical_nT)


def placed(place: FieldAtPlace, coefficients=None, sigma=0.003):
    """Return coefficients, by default those of the iron above, as calibrated at a place."""
    return PlacedCoefficients(at(place) if coefficients is None else coefficients, sigma**2 * np.eye(5), place)


def forward(place: FieldAtPlace, hard_nT: float, induced_nT: float):
    """Return the coefficients of iron along the forward axis, its induced part as at Brest."""
    pull = hard_nT + induced_nT * place.vertical_nT / BREST.vertical_nT
    return np.array([0.01, pull / place.horizontal_nT, 0.0, 0.02, 0.0])


@pytest.mark.parametrize("place", [BREST, GREENLAND])
def test_coefficients_are_linear_in_the_iron(place):
    a, b, d, e = (SOFT - np.eye(3))[[0, 0, 1, 1], [0, 1, 0, 1]]  # lambda is 1
    iron = [(d - b) / 2.0, *HARD[:2], *SOFT[:2, 2], (a - e) / 2.0, (d + b) / 2.0]
    assert iron_design(place) @ iron == pytest.approx(at(place), abs=1e-12)


def test_iron_that_nearly_cancels_at_home_is_within_the_interval():
    """P = +2000 and cZ = -2580 nT at Brest: B is -0.028 there and -0.094 at 65 N, 14 standard errors of a rule that
    takes all iron as hard or all as induced."""
    home, there = forward(BREST, 2000.0, -2580.0), forward(GREENLAND, 2000.0, -2580.0)
    assert (round(home[1], 3), round(there[1], 3)) == (-0.028, -0.094)
    single = transfer_coefficients([placed(BREST, home)], GREENLAND)
    sigma = np.sqrt(np.diag(single.covariance))
    assert np.all(np.abs(single.coefficients - there) < 1.96 * sigma) and 0.02 < sigma[1] < 0.05
    assert "a second calibration at another dip would tell" in single.warning
    both = transfer_coefficients([placed(BREST, home), placed(ICELAND, forward(ICELAND, 2000.0, -2580.0))], GREENLAND)
    narrow = np.sqrt(np.diag(both.covariance))
    assert np.all(np.abs(both.coefficients - there) < 1.96 * narrow) and narrow[1] < 0.3 * sigma[1]


def test_strong_iron_and_a_declared_sphere_widen_the_interval():
    """Standard deviation of B by iron alone: (Z'/Z - 1) / root 2 times 2500 nT, 4000 nT or what was calibrated."""
    weak, strong = (placed(BREST, forward(BREST, hard_nT, 0.0), 1e-6) for hard_nT in (200.0, 9000.0))
    for one, iron_nT, sigma_nT in ((weak, IRON_NT, 2500.0), (weak, SPHERE_NT, 4000.0), (strong, IRON_NT, 9000.0)):
        sigma = np.sqrt(transfer_coefficients([one], GREENLAND, iron_nT).covariance[1, 1])
        ratio = GREENLAND.vertical_nT / BREST.vertical_nT - 1.0
        assert sigma * GREENLAND.horizontal_nT == pytest.approx(ratio * sigma_nT / np.sqrt(2.0), rel=1e-3)


def test_a_compass_moored_where_it_was_calibrated_is_unchanged():
    here = placed(BREST)
    stayed = transfer_coefficients([here], BREST)
    assert stayed.coefficients == pytest.approx(here.coefficients, abs=1e-4)  # the prior takes a thousandth of sigma
    assert np.diag(stayed.covariance) == pytest.approx(np.diag(here.covariance), rel=1e-2) and stayed.warning == ""


@pytest.mark.parametrize(("horizontal", "warns"), [(4900.0, True), (5100.0, False)])
def test_a_mooring_in_a_weak_field_is_warned_of_at_sea_too(tmp_path, horizontal, warns):
    """Le Menn et al. 2023, section 7: below 5000 nT corrections are no longer valid."""
    seen, _ = pairs((0.0, 0.2, 0.0, 0.0, 0.0), n=200)
    along = EarthField(*(np.array([x, x]) for x in (1.2e9, -23.5, horizontal, 56000.0, -23.5)))
    netcdf.write_pairs(tmp_path / "pairs.nc", seen)
    netcdf.write_record(tmp_path / "record.nc", record_of(seen))
    write_json(tmp_path / "field.json", vars(along))
    files = Files(**{key: tmp_path / f"{key}.{end}" for key, end in ENDS.items()})
    fit_stage.fit("M", files, print, method="exact", given=None, sphere=False)
    assert any("no correction is reliable" in text for text in read_json(tmp_path / "fit.json")["warnings"]) == warns
