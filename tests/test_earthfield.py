"""Would catch a field that differs from ppigrf's, a date beyond IGRF, a wrong declination of the metadata."""

from datetime import datetime

import numpy as np
import ppigrf
import pytest

from compasslib import angles, earthfield
from compasslib.errors import InputError

DECEMBER_2007, EG4 = 1196467200.0, (65.3, -33.0)


@pytest.mark.parametrize("place", [(65.3, -33.0), (-40.0, 170.0), (89.9, 10.0)])
def test_model_agrees_with_ppigrf(place):
    """Within 0.001 nT, as ppigrf converts to geodetic components by a series."""
    dates = [datetime(1901, 3, 1), datetime(1987, 6, 1), datetime(2007, 12, 1), datetime(2029, 12, 1)]
    east, north, up = (np.ravel(x).astype(float) for x in ppigrf.igrf(place[1], place[0], 0.0, dates))
    seconds = [(date - datetime(1970, 1, 1)).total_seconds() for date in dates]
    declination, horizontal, down = earthfield.igrf(*place, seconds)
    sine, cosine = angles.sin_cos(declination)
    assert np.array([horizontal * sine, horizontal * cosine, down]) == pytest.approx(
        np.array([east, north, -up]), abs=1e-3
    )


def test_field_along_a_deployment_and_between_nodes():
    field = earthfield.field_along(*EG4, 1188864000.0, 1223078400.0)
    assert field.declination_deg[[0, -1]] == pytest.approx([-23.59, -23.22], abs=0.01)
    middle = (field.time_s[3] + field.time_s[4]) / 2
    exact = earthfield.igrf(*EG4, [middle])[0][0]
    assert earthfield.declination_at(field, np.array([middle]))[0] == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize(
    ("given", "said"),
    [(-23.0, ""), (23.4, "which has the other sign"), (-46.8, "looks like the double"), (-24.8, "off IGRF (-23.40)")],
)
def test_given_declination_overrides_the_model_and_a_mistake_is_named(given, said):
    field = earthfield.field_along(*EG4, 1188864000.0, 1223078400.0, given)
    assert (field.declination_deg == given).all() and field.source == "metadata"
    assert said in field.warnings[0] if said else field.warnings == ()
    written = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(field).items()}
    assert earthfield.field_from_json(written).warnings == field.warnings


@pytest.mark.parametrize(("applied", "warned"), [({"top": -22.0}, False), ({"top": 23.4}, True), ({}, False)])
def test_declination_applied_is_compared_with_the_model(applied, warned):
    field = earthfield.field_along(*EG4, 1188864000.0, 1223078400.0, applied=applied)
    assert field.source == "IGRF" and bool(field.warnings) == warned
    assert not warned or field.warnings[0].startswith("top: declination_applied +23.40 degrees in the metadata is")


def test_dates_outside_the_model_are_refused():
    with pytest.raises(InputError, match="dates from 1900 to 2029, which IGRF covers, found 2031-01-01"):
        earthfield.igrf(*EG4, [1924992000.0])
