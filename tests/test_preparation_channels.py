"""Series that a user gives stand at the instrument's times, and nothing stands where they do not reach."""

from dataclasses import replace

import numpy as np
import pytest
from test_archive import make_record

from compasslib.core.errors import InputError
from compasslib.preparation import channels

HEADER = "when,ntu\n"


@pytest.fixture
def record():
    return replace(make_record(6), time_s=1189000000.0 + 3600.0 * np.arange(6))


def given(path, rows):
    path.write_text(HEADER + "".join(f"{np.datetime64(int(t), 's')}Z,{x}\n" for t, x in rows))
    return {"turbidity": {"files": [str(path)], "columns": {"time": "when", "value": "ntu"}, "unit": "NTU"}}


def test_a_series_is_read_between_its_values_and_not_in_its_gaps(record, tmp_path):
    begin = record.time_s[0]
    rows = [(begin - 1800.0 * k, 2.0 * k) for k in (-1, -2, -3)] + [(begin + 9 * 1800.0, 18.0)]
    found = channels.beside(record, given(tmp_path / "t.csv", rows))
    np.testing.assert_array_equal(found.channels["turbidity"], [np.nan, -4.0, np.nan, np.nan, np.nan, np.nan])
    assert found.channel_units == {"turbidity": "NTU"}


def test_a_series_of_another_year_is_refused_in_one_line(record, tmp_path):
    rows = [(record.time_s[0] + 4e7 + 3600.0 * k, k) for k in range(5)]
    with pytest.raises(InputError, match=r"t\.csv: expected values of turbidity while .*found 2008-12-.*check times"):
        channels.beside(record, given(tmp_path / "t.csv", rows))
