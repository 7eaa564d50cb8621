"""YAML files of calibrations: values, defaults, and a one-line message for every mistake."""

# ruff: noqa: E501, RUF100 - messages are compared as printed, on one line

from __future__ import annotations

from pathlib import Path

import pytest

from compasslib.calibrations import KINDS, budget
from compasslib.config import calibrations
from compasslib.config import cruise as config
from compasslib.errors import InputError
from compasslib.stages.settings import check_cruise

FILE = "config/calibrations/aqd.yaml"
# A calibration file with comments, as a user may write it.
EXAMPLE = """\
kind: platform                  # platform | swing | magnetometer | declination | two_heads
file: raw/cal/aqd.csv           # CSV; or with format: mmp_acm, nmea0183, iaga2002
columns: {}                     # where names differ from those below
declination: auto
latitude: 48.4
longitude: -4.5
date: 2022-09-29
withhold: []                    # columns that the analysis must not see
"""


@pytest.fixture
def cruise(tmp_path: Path) -> Path:
    for name in ("aqd.csv", "b.csv", "a.csv"):
        write(tmp_path, f"raw/cal/{name}", "reference_deg,recorded_deg\n")
    write(tmp_path, "config/config.yaml", "moorings: []\n")
    write(tmp_path, FILE, EXAMPLE)
    return tmp_path


def write(root: Path, name: str, text: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text)


def message(root: Path) -> str:
    with pytest.raises(InputError) as caught:
        check_cruise(config.load_cruise(root))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_example_calibration_is_read_with_its_defaults(cruise: Path) -> None:
    loaded = config.load_cruise(cruise).calibrations
    assert list(loaded) == ["aqd"] and loaded["aqd"].files == ("raw/cal/aqd.csv",) and loaded["aqd"].placed
    assert calibrations.settings(loaded["aqd"]) == {
        "declination": "auto", "latitude": 48.4, "longitude": -4.5, "date_s": 1664409600.0, "withhold": [],
        "table_step_deg": 10, "format": "csv", "columns": {}, "budget": None,
        "mounting_deg": None, "object": None, "parts": [], "spun": [], "observatory": [],
        "uncertainty": dict.fromkeys(budget.ROWS),
    }  # fmt: skip


def test_missing_calibration_folder_gives_no_calibrations(tmp_path: Path) -> None:
    write(tmp_path, "config/config.yaml", "moorings: []\n")
    assert config.load_cruise(tmp_path).calibrations == {}


def test_every_kind_is_read_by_its_own_model(cruise: Path) -> None:
    assert set(KINDS) <= set(calibrations.MODELS)
    for kind, model in calibrations.MODELS.items():
        write(cruise, FILE, f"kind: {kind}\nfile: [raw/cal/b.csv, raw/cal/a.csv]\n")  # order matters: heads a and b
        read = config.load_cruise(cruise).calibrations["aqd"]
        assert type(read) is model and read.files == ("raw/cal/b.csv", "raw/cal/a.csv") and not read.placed


def test_columns_and_uncertainty_rows_reach_the_settings(cruise: Path) -> None:
    extra = "format: table\ncolumns: {reference_deg: bench}\nuncertainty: {slope_deg: 0.2}\nbudget: le_menn\n"
    write(cruise, FILE, "kind: platform\nfile: raw/cal/*.csv\ntable_step_deg: 15\ndeclination: -0.7\n" + extra)
    read = config.load_cruise(cruise).calibrations["aqd"]
    settings = calibrations.settings(read)
    assert read.files == ("raw/cal/a.csv", "raw/cal/aqd.csv", "raw/cal/b.csv")
    assert settings["columns"] == {"reference_deg": "bench"} and settings["uncertainty"]["slope_deg"] == 0.2
    assert (settings["format"], settings["table_step_deg"], settings["declination"]) == ("csv", 15, -0.7)


def test_swing_and_two_heads_keys_reach_the_settings(cruise: Path) -> None:
    marks = "visual: [{compass_deg: 40, true_deg: 42}]\nsun: [{compass_deg: 10, time_utc: 2022-09-29T09:00Z}]\n"
    write(cruise, FILE, f"kind: swing\nfile: raw/cal/a.csv\nmin_speed_kn: 3\n{marks}")
    swing = calibrations.settings(config.load_cruise(cruise).calibrations["aqd"])
    assert swing["visual"] == [{"compass_deg": 40.0, "true_deg": 42.0}] and swing["min_speed_kn"] == 3.0
    assert swing["sun"] == [{"compass_deg": 10.0, "time_utc": 1664442000.0}] and swing["max_lag_s"] is None
    heads = "start: 2022-09-29\norientation: [up, down]\nheading_alignment: 45\n"
    write(cruise, FILE, f"kind: two_heads\nfile: [raw/cal/b.csv, raw/cal/a.csv]\n{heads}")
    two = calibrations.settings(config.load_cruise(cruise).calibrations["aqd"])
    assert two["start_s"] == 1664409600.0
    assert two["orientation"] == ["up", "down"] and two["heading_alignment"] == [45.0, 45.0]


BAD = [
    ("kind: two_heads\nfile: raw/cal/aqd.csv\n", "file: expected two files, of head a and of head b, found 1; write for example file: [a.000, b.000]"),
    ("kind: two_heads\nfile: [raw/cal/a.csv, raw/cal/b.csv]\norientation: [up, left]\n", "orientation[1]: expected up or down, or a list of two of these, found 'left'; write for example orientation: [up, down]"),
    ("kind: two_heads\nfile: [raw/cal/a.csv, raw/cal/b.csv]\nheading_alignment: [1, 2, 3]\n", "heading_alignment: expected degrees, or a list of two, found 3; write for example heading_alignment: [0, 45]"),
    ("kind: swing\nfile: raw/cal/aqd.csv\nvisual: [{compass_deg: 40}]\n", "visual[0].true_deg: expected degrees from 0 to 360, found nothing; add for example true_deg: 42"),
    ("kind: platfrom\nfile: raw/cal/aqd.csv\n", "kind: expected platform, tilt, swing, magnetometer, declination or two_heads, found 'platfrom'; write platform"),
    ("file: raw/cal/aqd.csv\n", "kind: expected platform, tilt, swing, magnetometer, declination or two_heads, found nothing; add for example kind: platform"),
    ("kind: platform\nfile: raw/cal/aqd.csv\nspun: raw/cal/aqd.csv\n", "file: expected another file than spun and observatory, found 'raw/cal/aqd.csv'; correct one"),
    ("kind: platform\n", "file: expected a path, a list of paths or a glob, relative to the cruise folder, found nothing; add for example file: raw/cal/aqd.csv"),
    ("kind: platform\nfile: raw/cal/no.csv\n", "file: expected an existing file, found no file raw/cal/no.csv; put it there or correct the path, relative to the cruise folder"),
    (EXAMPLE + "depth: 3\n", "depth: expected a key out of kind, file, declination, latitude, longitude, date, withhold, table_step_deg, parts, compare_with, compass, sphere, format, columns, mounting_deg, spun, observatory, object, budget, uncertainty, delimiter, decimal, time_format, timezone, missing, skip_rows, found the unknown 'depth'; delete it, or indent it below the key that it belongs to"),
    (EXAMPLE.replace("48.4", "98.4"), "latitude: expected a number from -90 to 90, found 98.4; check the sign and the order of latitude and longitude"),
    (EXAMPLE.replace("latitude: 48.4\n", ""), "latitude: expected latitude beside longitude, found nothing; add latitude or delete longitude"),
    (EXAMPLE.replace("2022-09-29", "29.9.2022"), "date: expected a date or UTC time from 1980 to 2100, found '29.9.2022'; write for example date: 2022-09-29"),
    (EXAMPLE.replace("columns: {}", "columns: {x: mx}"), "columns.x: expected a key out of reference_deg, recorded_deg, time_utc, found the unknown 'x'; delete it, or indent it below the key that it belongs to"),
    (EXAMPLE + "format: pd0\n", "format: expected csv, found 'pd0'; write for example format: csv"),
    (EXAMPLE + "table_step_deg: 12\n", "table_step_deg: expected 10 or 15, found 12; write for example table_step_deg: 10"),
    (EXAMPLE + "budget: gum\n", "budget: expected le_menn, found 'gum'; write for example budget: le_menn"),
    (EXAMPLE + "uncertainty: {slope: 0.2}\n", "uncertainty.slope: expected a key out of graduation_deg, slope_deg, ruggedness_deg, protractor_deg, field_deg, declination_deg, homogeneity_deg, maker_accuracy_deg, found the unknown 'slope'; write slope_deg"),
    (EXAMPLE + "uncertainty: {slope_deg: -0.2}\n", "uncertainty.slope_deg: expected a largest error, degrees from 0 to 180, found -0.2; write for example slope_deg: 0.26"),
    (EXAMPLE + "compare_with: before\n", "compare_with: expected the NAME of another, earlier calibration, found 'before'; correct the name; the earlier one stands alone"),
    (EXAMPLE + "compare_with: aqd\n", "compare_with: expected the NAME of another, earlier calibration, found a circle of comparisons, aqd - aqd; correct the name; the earlier one stands alone"),
    (EXAMPLE.replace("withhold: []", "withhold: z"), "withhold: expected a list of column names, found 'z'; write for example withhold: [heading_deg]"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), BAD, ids=[expected.partition(",")[0] for _, expected in BAD])
def test_invalid_calibration_file_is_reported_in_one_line(cruise: Path, text: str, expected: str) -> None:
    write(cruise, FILE, text)
    assert message(cruise) == f"{FILE}: {expected}"


def test_circular_comparison_of_two_is_refused(cruise: Path) -> None:
    write(cruise, FILE, EXAMPLE + "compare_with: b\n")
    write(cruise, "config/calibrations/b.yaml", EXAMPLE + "compare_with: aqd\n")
    assert "a circle of comparisons, aqd - b - aqd" in message(cruise)


@pytest.mark.parametrize("name", ["aqd.yml", "a b.yaml", "-x.yaml"])
def test_invalid_calibration_file_name_is_refused(cruise: Path, name: str) -> None:
    write(cruise, f"config/calibrations/{name}", EXAMPLE)
    assert message(cruise) == (
        f"config/calibrations/{name}: expected a file NAME.yaml, the name of 1 to 64 letters, digits, '_', '.' and '-', "
        f"the first a letter or digit, found {name}; rename the file"
    )
