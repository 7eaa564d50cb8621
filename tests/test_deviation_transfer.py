"""Transfer of coefficients between places, against the full compass with known iron."""

import numpy as np
import pytest
from sea import pairs
from test_plots import record

from compasslib import compass
from compasslib.archive import netcdf
from compasslib.archive.files import read_json, write_json
from compasslib.deviation.model import FieldAtPlace, separate_iron, transfer_coefficients
from compasslib.records import EarthField
from compasslib.stages import fit as fit_stage

BREST, GREENLAND = FieldAtPlace(21000.0, 43000.0), FieldAtPlace(11980.0, 52078.0)
SOFT = np.eye(3) + np.array([[0.02, 0.01, 0.05], [-0.01, -0.02, -0.03], [0.0, 0.0, 0.0]])
HARD = (4000.0, -2000.0, 1000.0)


def at(place: FieldAtPlace, soft=SOFT, hard=HARD):
    return compass.level_coefficients(soft, hard, horizontal_nT=place.horizontal_nT, vertical_nT=place.vertical_nT)


def test_hard_iron_alone_scales_as_one_over_h():
    soft = SOFT.copy()
    soft[:2, 2] = 0.0
    carried = transfer_coefficients(at(BREST, soft), np.eye(5) * 1e-6, BREST, GREENLAND)
    assert carried.if_all_hard == pytest.approx(at(GREENLAND, soft), abs=1e-12)


def test_induced_iron_alone_scales_as_the_dip():
    carried = transfer_coefficients(at(BREST, hard=(0, 0, 0)), np.eye(5) * 1e-6, BREST, GREENLAND)
    assert carried.if_all_induced == pytest.approx(at(GREENLAND, hard=(0, 0, 0)), abs=1e-12)


def test_without_knowledge_of_the_iron_the_extremes_enclose_the_truth():
    carried = transfer_coefficients(at(BREST), np.zeros((5, 5)), BREST, GREENLAND)
    truth = at(GREENLAND)
    assert np.sqrt(np.diag(carried.covariance))[1] > 0.01
    assert (np.abs(carried.coefficients - truth) <= np.sqrt(12) * np.sqrt(np.diag(carried.covariance)) + 1e-9).all()
    assert "a second calibration at another dip would tell" in carried.warning


def test_two_places_separate_hard_and_induced_iron():
    parts = separate_iron(at(GREENLAND), at(BREST), GREENLAND, BREST)
    only_hard = at(GREENLAND, SOFT * np.array([1.0, 1.0, 0.0]) + np.diag([0.0, 0.0, 1.0]))
    for k, letter in ((1, "B"), (2, "C")):
        assert parts[letter]["hard_nT"] == pytest.approx(only_hard[k] * GREENLAND.horizontal_nT, abs=1e-6)
        total = parts[letter]["hard_nT"] + parts[letter]["induced_nT"]
        assert total == pytest.approx(at(GREENLAND)[k] * GREENLAND.horizontal_nT)
    assert separate_iron(at(BREST), at(BREST), BREST, BREST) is None


def test_without_semicircular_coefficients_there_is_no_warning():
    carried = transfer_coefficients([0.01, 0.0, 0.0, 0.03, 0.02], np.eye(5) * 1e-6, BREST, GREENLAND)
    assert carried.warning == "" and carried.coefficients.tolist() == [0.01, 0.0, 0.0, 0.03, 0.02]


def test_a_weak_field_is_warned_of():
    carried = transfer_coefficients(at(BREST), np.zeros((5, 5)), BREST, FieldAtPlace(4000.0, 56000.0))
    assert carried.warning.startswith("the horizontal field is 4000 nT; below 5000 nT no correction is reliable")


@pytest.mark.parametrize(("horizontal", "warns"), [(4900.0, True), (5100.0, False)])
def test_a_mooring_in_a_weak_field_is_warned_of_at_sea_too(tmp_path, horizontal, warns):
    """Le Menn et al. 2023, section 7: below 5000 nT corrections are no longer valid."""
    seen, _ = pairs((0.0, 0.2, 0.0, 0.0, 0.0), n=200)
    along = EarthField(*(np.array([x, x]) for x in (1.2e9, -23.5, horizontal, 56000.0, -23.5)))
    netcdf.write_pairs(tmp_path / "pairs.nc", seen)
    netcdf.write_record(tmp_path / "record.nc", record(seen, 200))
    write_json(tmp_path / "field.json", vars(along))
    fit_stage.fit("M", record=tmp_path / "record.nc", pairs=tmp_path / "pairs.nc", field=tmp_path / "field.json",
                  fit=tmp_path / "fit.json", method="exact", tilt=False, given=None, say=print)  # fmt: skip
    assert any("no correction is reliable" in text for text in read_json(tmp_path / "fit.json")["warnings"]) == warns
