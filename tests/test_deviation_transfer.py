"""Coefficients carried between places, against the full compass with known iron."""

import numpy as np
import pytest

from compasslib import compass
from compasslib.deviation.model import FieldAtPlace, transfer_coefficients

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


def test_without_knowledge_the_truth_lies_between_the_extremes_and_it_is_said():
    carried = transfer_coefficients(at(BREST), np.zeros((5, 5)), BREST, GREENLAND)
    truth = at(GREENLAND)
    assert np.sqrt(np.diag(carried.covariance))[1] > 0.01
    assert (np.abs(carried.coefficients - truth) <= np.sqrt(12) * np.sqrt(np.diag(carried.covariance)) + 1e-9).all()
    assert "a second calibration at another dip would tell" in carried.warning


def test_without_semicircular_coefficients_nothing_is_said():
    carried = transfer_coefficients([0.01, 0.0, 0.0, 0.03, 0.02], np.eye(5) * 1e-6, BREST, GREENLAND)
    assert carried.warning == "" and carried.coefficients.tolist() == [0.01, 0.0, 0.0, 0.03, 0.02]


def test_a_weak_field_is_said():
    carried = transfer_coefficients(at(BREST), np.zeros((5, 5)), BREST, FieldAtPlace(4000.0, 56000.0))
    assert carried.warning == "the horizontal field is 4000 nT; below 5000 nT no correction holds"
