"""Would catch a user's series interpolated into its gaps, or wrongly to the instrument's times."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compasslib.errors import InputError
from compasslib.inference import covariates
from compasslib.preparation.deployment import add_covariates, add_field_strength
from compasslib.records import MAGNETOMETER
from tests.world.products import make_record

HEADER = "when,ntu\n"


@pytest.fixture
def record():
    return replace(make_record(6), time_s=1189000000.0 + 3600.0 * np.arange(6))


def given(path, rows):
    path.write_text(HEADER + "".join(f"{np.datetime64(int(t), 's')}Z,{x}\n" for t, x in rows))
    return {"turbidity": {"files": [str(path)], "columns": {"time": "when", "value": "ntu"}, "unit": "NTU"}}


def test_series_is_interpolated_but_not_across_gaps(record, tmp_path):
    begin = record.time_s[0]
    rows = [(begin - 1800.0 * k, 2.0 * k) for k in (-1, -2, -3)] + [(begin + 9 * 1800.0, 18.0)]
    found = add_covariates(record, given(tmp_path / "t.csv", rows))
    np.testing.assert_array_equal(found.channels["turbidity"], [np.nan, -4.0, np.nan, np.nan, np.nan, np.nan])
    assert found.channel_units == {"turbidity": "NTU"} and found.warnings == record.warnings


def test_series_outside_the_record_is_refused(record, tmp_path):
    rows = [(record.time_s[0] + 4e7 + 3600.0 * k, k) for k in range(5)]
    with pytest.raises(InputError, match=r"t\.csv: expected values of turbidity while .*found 2008-12-.*check times"):
        add_covariates(record, given(tmp_path / "t.csv", rows))


def with_magnetometer(n=600, strength=lambda t: 1.0):
    """Simulate a record with a magnetometer near fixed iron: field 500 counts, dip 60 degrees, all headings."""
    rng = np.random.default_rng(3)
    record = replace(make_record(n), time_s=1189000000.0 + 3600.0 * np.arange(n))
    heading, pitch, roll = rng.uniform(0.0, 360.0, n), *rng.normal(0.0, 2.0, (2, n))
    attitude = Rotation.from_euler("ZYX", np.column_stack([heading, pitch, roll]), degrees=True)
    earth = attitude.inv().apply([250.0, 0.0, 433.0]).T  # forward, starboard, down
    axes = strength(record.time_s) * earth + [[40.0], [-25.0], [60.0]] + rng.normal(0.0, 1.0, (3, n))
    series = dict(zip(MAGNETOMETER, axes, strict=True))
    tilts = {"heading_deg": heading, "pitch_deg": pitch, "roll_deg": roll}
    return replace(record, **tilts, channels=series, channel_units=dict.fromkeys(series, "count"))


def test_field_strength_is_derived_from_the_magnetometer():
    step = add_field_strength(with_magnetometer(strength=lambda t: np.where(t > np.median(t), 1.02, 1.0)))
    seen = step.channels["field_strength"]
    assert np.mean(seen[300:]) - np.mean(seen[:300]) == pytest.approx(1.8, abs=0.3)  # 2, less a tenth due to fixed iron
    assert f"saw the field's strength change by {np.std(seen):.2f} % rms" in step.warnings[-1]
    still = add_field_strength(with_magnetometer()).channels["field_strength"]
    assert np.std(still) < 0.3
    drivers = covariates.logged_series(step, [])
    assert "field_strength" in drivers and not set(MAGNETOMETER) & set(drivers)


def test_record_without_magnetometer_data_is_unchanged(record):
    assert add_field_strength(record) is record
    dead = replace(with_magnetometer(), channels=dict.fromkeys(MAGNETOMETER, np.zeros(600)))
    assert add_field_strength(dead) is dead
