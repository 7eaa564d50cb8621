"""Covariates from any column of a table: in the order of time, each instant once, rows that contradict left out."""

import pytest

from compasslib.errors import InputError
from compasslib.readers.table import read_series


def test_a_covariate_is_its_rows_in_the_order_of_time_without_gaps_and_contradictions(tmp_path):
    hours = {"03": 3, "01": 1, "02": 2, "04": ""}
    text = "at,A\n" + "".join(f"2007-09-04T{hour}:00Z,{value}\n" for hour, value in hours.items())
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "b.csv").write_text("at,A\n2007-09-04T01:00Z,1\n2007-09-04T02:00Z,9\n")
    files = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    time_s, value, _ = read_series({"files": files, "columns": {"time": "at", "value": "A", "date": None}})
    assert ((time_s - 1188864000.0) / 3600.0).tolist() == [1.0, 3.0] and value.tolist() == [1.0, 3.0]


def test_a_covariate_without_a_value_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("at,A\n2007-09-04T01:00Z,\n")
    with pytest.raises(InputError, match="expected rows with a time and a value, found none"):
        read_series({"files": [str(tmp_path / "a.csv")], "columns": {"time": "at", "value": "A"}})
