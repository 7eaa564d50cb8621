"""Would catch a key of a calibration that is ignored, or a mistake in one without a line that names its place."""

import re
from pathlib import Path

import pytest

from compasslib.calibrations import KINDS
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
        "object": None, "parts": [], "spun": [],
        "uncertainty": {},
    }  # fmt: skip


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
    ("kind: two_heads\nfile: raw/cal/aqd.csv\n", "file"),
    ("kind: two_heads\nfile: [raw/cal/a.csv, raw/cal/b.csv]\norientation: [up, left]\n", "orientation"),
    ("kind: two_heads\nfile: [raw/cal/a.csv, raw/cal/b.csv]\nheading_alignment: [1, 2, 3]\n", "heading_alignment"),
    ("kind: swing\nfile: raw/cal/aqd.csv\nvisual: [{compass_deg: 40}]\n", "visual[0].true_deg"),
    ("kind: platfrom\nfile: raw/cal/aqd.csv\n", "kind"),
    ("file: raw/cal/aqd.csv\n", "kind"),
    ("kind: platform\nfile: raw/cal/aqd.csv\nspun: raw/cal/aqd.csv\n", "file"),
    ("kind: platform\n", "file"),
    ("kind: platform\nfile: raw/cal/no.csv\n", "file"),
    (EXAMPLE + "depth: 3\n", "depth"),
    (EXAMPLE.replace("48.4", "98.4"), "latitude"),
    (EXAMPLE.replace("latitude: 48.4\n", ""), "latitude"),
    (EXAMPLE.replace("2022-09-29", "29.9.2022"), "date"),
    (EXAMPLE.replace("columns: {}", "columns: {x: mx}"), "columns.x"),
    (EXAMPLE + "format: pd0\n", "format"),
    (EXAMPLE + "table_step_deg: 12\n", "table_step_deg"),
    (EXAMPLE + "budget: gum\n", "budget"),
    (EXAMPLE + "uncertainty: {slope: 0.2}\n", "uncertainty.slope"),
    (EXAMPLE + "uncertainty: {slope_deg: -0.2}\n", "uncertainty.slope_deg"),
    (EXAMPLE + "compare_with: before\n", "compare_with"),
    (EXAMPLE + "compare_with: aqd\n", "compare_with"),
    (EXAMPLE.replace("withhold: []", "withhold: z"), "withhold"),
]


@pytest.mark.parametrize(("text", "place"), BAD)
def test_invalid_calibration_file_is_reported_in_one_line(cruise: Path, text: str, place: str) -> None:
    write(cruise, FILE, text)
    assert re.fullmatch(rf"{FILE}: {re.escape(place)}: expected .+, found .+; .+", message(cruise)), message(cruise)


def test_circular_comparison_of_two_is_refused(cruise: Path) -> None:
    write(cruise, FILE, EXAMPLE + "compare_with: b\n")
    write(cruise, "config/calibrations/b.yaml", EXAMPLE + "compare_with: aqd\n")
    assert "a circle of comparisons, aqd - b - aqd" in message(cruise)


@pytest.mark.parametrize("name", ["aqd.yml", "a b.yaml", "-x.yaml"])
def test_invalid_calibration_file_name_is_refused(cruise: Path, name: str) -> None:
    write(cruise, f"config/calibrations/{name}", EXAMPLE)
    assert message(cruise).startswith(f"config/calibrations/{name}: expected a file NAME.yaml")
