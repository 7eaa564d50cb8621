"""Tables: column roles, units, bins, and one line for what cannot be read."""

from pathlib import Path

import numpy as np
import pytest

from compasslib.errors import InputError
from compasslib.readers import read

ROLES = {"time": "t", "depth": "z", "east": "u", "north": "v", "scale": 0.01}


def table(tmp_path: Path, text: str) -> list[Path]:
    path = tmp_path / "deep.csv"
    path.write_text(text)
    return [path]


def test_roles_scale_missing_values_and_extra_columns(tmp_path):
    paths = table(tmp_path, "t,z,extra,u,v\n2007-09-04T00:00:00Z,101,x,10,-5\n2007-09-04 01:00,102,y,,NaN\n")
    record = read("table", paths, {"columns": ROLES})
    assert list(np.diff(record.time_s)) == [3600.0] and record.time_s[0] == 1188864000.0
    assert record.east[0, 0] == pytest.approx(0.1) and np.isnan(record.north[1, 0])
    assert record.counts == {"rows": 2, "velocities_missing": 1}


def test_speed_with_direction_and_forward_port_with_heading(tmp_path):
    polar = table(tmp_path, "t,s,d\n2007-09-04,0.5,90\n")
    record = read("table", polar, {"columns": {"time": "t", "speed": "s", "direction": "d"}})
    assert (record.east[0, 0], record.north[0, 0]) == pytest.approx((0.5, 0.0))
    body = table(tmp_path, "t,x,y,h\n2007-09-04,0.2,0.1,90\n")
    columns = {"time": "t", "x": "x", "y": "y", "heading": "h", "tilt_x": None}
    record = read("table", body, {"columns": columns})
    assert (record.east[0, 0], record.north[0, 0]) == pytest.approx((0.2, 0.1))  # east of it is forward, port is north
    assert record.heading_deg[0] == 90.0


def test_rows_of_one_time_are_bins(tmp_path):
    text = "t,z,u,v\n2007-09-04T00:00,10,1,1\n2007-09-04T00:00,14,2,2\n2007-09-04T01:00,11,3,3\n"
    record = read("table", table(tmp_path, text), {"columns": ROLES})
    assert record.east.shape == (2, 2) and np.isnan(record.east[1, 1])
    assert list(record.bin_depth_m()[0]) == [10.0, 14.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "column 't' (time): expected one of the file's columns, found an empty file"),
        ("t,z,u\n", "column 'v' (north): expected one of the file's columns, found t, z, u"),
        ("t,z,u,v\n2007-09-04,1,1,x7\n", "line 2, v: expected a number or nothing, found 'x7'"),
        ("t,z,u,v\n4 Sept,1,1,1\n", "line 2, t: expected an ISO time like 2007-09-04T00:00:00Z, found '4 Sept'"),
        ("t,z,u,v\n2007-09-04,1,1\n", "line 2, v: expected a number or nothing, found a line of 3 cells"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError) as caught:
        read("table", table(tmp_path, text), {"columns": ROLES})
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_binary_and_missing_files_are_said(tmp_path):
    for path, content in ((tmp_path / "b.csv", b"\xff\xfe\x00\x01"), (tmp_path / "none.csv", None)):
        if content:
            path.write_bytes(content)
        with pytest.raises(InputError, match="expected a readable CSV file"):
            read("table", [path], {"columns": ROLES})
