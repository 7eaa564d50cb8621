"""YAML files of a cruise: values, defaults, and a one-line message for every mistake."""

# ruff: noqa: E501, RUF100 - messages are compared as printed, on one line

from __future__ import annotations

import json
import os
import random
import re
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path

import jsonschema
import pytest
import yaml

from compasslib import readers
from compasslib.config import calibrations, json_schema, schema, section, values
from compasslib.config import cruise as config
from compasslib.errors import InputError
from compasslib.stages.settings import Moorings

ROOT = Path(__file__).resolve().parents[2]
MOORING_FILE = "config/moorings/EG4.yaml"
GRID = {"step_m": None, "from_m": None, "to_m": None, "minutes": None, "max_gap_m": None, "max_gap_minutes": 180.0}
PRODUCT = {"grid": GRID, "flags": (1, 2), "daily": False}

CONFIG = """\
moorings: config/moorings       # folder, or a list of files; may be an empty list
demonstration: false
attributes: {institution: ..., project: ..., principal_investigator: ..., license: ...}   # optional
overlap: {max_minutes: 20, max_metres: 20, bins: 2, grid_minutes: 60, grid_tolerance_minutes: 30}
fit: {method: exact}            # exact | von_appen   (a mooring file may override)
diagnose: {enabled: true, apply: true, min_effect_deg: 0.5}
"""

MOORING = """\
name: EG4
latitude: 65.3333               # degrees north
longitude: -32.9550             # degrees east
water_depth: 894                # m
start: 2007-09-04T00:00:00Z     # deployed; samples outside are not used
end: 2008-10-04T00:00:00Z
declination: auto               # auto = IGRF at this place, along the time axis; or degrees east
compromised: top                # the instrument to correct
reference: deep                 # the trusted one
instruments:
  top:
    format: pd0                 # pd0 | acm_table | mmp_acm | table
    files: raw/EG4/top.000      # path, list or glob, relative to the cruise folder
    depth: 100                  # nominal transducer depth, m; the pressure sensor's where the file has one
    orientation: up             # up | down; checked against the file
    declination_applied: 0      # degrees already inside the file's directions
    clock_offset_seconds: 0     # instrument clock minus UTC at start
    clock_drift_seconds: 0      # the same at end, minus the offset at start
    pressure_offset: 0          # dbar, subtracted
    exclude: []                 # [{from: ..., to: ..., why: ...}]: known-bad windows, flagged 4, not used
    attributes: {serial_number: ...}
  deep:
    format: table
    files: raw/EG4/deep.csv
    depth: 120
    columns: {time: time_utc, depth: depth_m, east: u_cm_s, north: v_cm_s, scale: 0.01}
    # columns of table and acm_table: time; depth or pressure; east+north, or speed+direction
    direction_reference: magnetic   # magnetic | true; default magnetic for every format
    # mmp_acm: files, pressure_files, start_offset_seconds
fit: {method: exact}            # optional; exact | von_appen | calibration (with name)
diagnose: {apply: true}         # optional
covariates:                     # optional, other series that the search for left-out physics may use
  declination_observatory: {format: iaga2002, files: raw/obs/*.min}
"""

SHORTEST = """\
name: M1
latitude: 10
longitude: 20
water_depth: 100
start: 2007-09-04
end: 2008-10-04
compromised: top
instruments: {top: {format: pd0, files: raw/EG4/top.000}}
"""

COLUMNS = "{time: time_utc, depth: depth_m, east: u_cm_s, north: v_cm_s, scale: 0.01}"


@pytest.fixture
def cruise(tmp_path: Path) -> Path:
    """Write a cruise folder with the example configuration and return its path."""
    for name in ("EG4/top.000", "EG4/deep.csv", "EG4/b.000", "EG4/a.000", "obs/lrv2.min", "obs/lrv1.min"):
        write(tmp_path, f"raw/{name}", "")
    write(tmp_path, "config/config.yaml", CONFIG)
    write(tmp_path, MOORING_FILE, MOORING)
    return tmp_path


def write(root: Path, name: str, text: str | bytes) -> None:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())


def edited(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the example"
    return text.replace(old, new)


def message(root: Path) -> str:
    with pytest.raises(InputError) as caught:
        config.load_cruise(root)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def with_line(line: str) -> str:
    """Return the example with the line of the same key and indentation replaced; a new key is inserted first."""
    new, old = line.partition(":")[0] + ":", MOORING
    place = old.find("\n" + new) + 1
    if new == "name:":
        return line + old[old.index("\n") :]
    if not place:
        return edited(old, "  top:\n", f"  top:\n{line}\n") if line.startswith(" ") else f"{line}\n{old}"
    if new == "covariates:":
        return old[:place] + line + "\n"
    return old[:place] + line + old[old.index("\n", place) :]


# --- valid input ----------------------------------------------------------------------------------------------------


def test_example_configuration_is_read(cruise: Path) -> None:
    loaded = config.load_cruise(cruise)
    mooring = loaded.moorings["EG4"]
    top, deep = mooring.instruments["top"], mooring.instruments["deep"]
    assert loaded.root == cruise
    assert loaded.mooring_files == {"EG4": MOORING_FILE}
    assert loaded.options.attributes["institution"] == "..."
    assert (mooring.latitude, mooring.longitude, mooring.water_depth) == (65.3333, -32.9550, 894.0)
    assert (mooring.start, mooring.end) == (datetime(2007, 9, 4, tzinfo=UTC), datetime(2008, 10, 4, tzinfo=UTC))
    assert (mooring.start_s, mooring.declination) == (1188864000.0, "auto")
    assert (top.files, top.depth, top.orientation, top.declination_applied) == (("raw/EG4/top.000",), 100.0, "up", 0.0)
    assert deep.columns is not None
    assert deep.columns.headers() == {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s"}
    assert deep.columns.scale == 0.01
    assert mooring.covariates["declination_observatory"].files == ("raw/obs/lrv1.min", "raw/obs/lrv2.min")


DIAGNOSE = {"enabled": True, "apply": True, "min_effect_deg": 0.5, "prior_odds": 1.0, "surrogates": 199}
QUALITY = {
    "percent_good": 25.0, "correlation": None, "error_velocity": None, "echo": None, "tilt_deg": 45.0, "speed": 5.0,
    "side_lobe": True,
}  # fmt: skip
FIT = {
    "method": "exact", "name": (), "tilt": False, "model": "exact", "coefficients": None, "covariance": None,
    "file": None, "columns": None,
}  # fmt: skip


def test_all_but_eight_keys_have_defaults(cruise: Path) -> None:
    write(cruise, "config/config.yaml", "{}")
    write(cruise, MOORING_FILE, SHORTEST)
    loaded = config.load_cruise(cruise)
    assert loaded.options.model_dump() == {
        "moorings": "config/moorings",
        "demonstration": False,
        "seed": 2007,
        "attributes": {},
        "supersedes": (),
        "overlap": {
            "max_minutes": 20.0, "max_metres": 20.0, "bins": 2, "predict": True, "grid_minutes": 60.0, "grid_tolerance_minutes": 30.0
        },
        "fit": FIT,
        "diagnose": DIAGNOSE,
        "conventions": {"check": False},
        "product": PRODUCT,
        "figures": {"formats": ("png",)},
        "quality": QUALITY,
    }  # fmt: skip
    assert loaded.moorings["M1"].model_dump() == {
        "name": "M1", "latitude": 10.0, "longitude": 20.0, "water_depth": 100.0, "start_s": 1188864000.0,
        "end_s": 1223078400.0, "declination": "auto", "affected": ("top",), "reference": (),
        "instruments": {"top": {
            "format": "pd0", "files": ("raw/EG4/top.000",), "depth": None, "orientation": None,
            "declination_applied": None, "heading_alignment": None, "sound_speed": "auto", "clock_offset_seconds": 0.0,
            "clock_drift_seconds": 0.0, "pressure_offset": 0.0, "direction_reference": "magnetic", "exclude": (),
            "compass": None, "sphere": None, "compass_sigma_deg": None, "compass_iron_nT": None, "kind": None, "parts": (), "sphere_distance_m": None, "fit": None,
            "attributes": {}, "columns": None, "pressure_files": (), "start_offset_seconds": 0.0,
            "bin_size": None, "first_bin": None, "flags": None, "delimiter": None, "decimal": None,
            "time_format": None, "timezone": None, "missing": (), "skip_rows": None,
        }},
        "attributes": {}, "fit": FIT,
        "diagnose": DIAGNOSE, "confirmed": {"constant": False}, "product": PRODUCT,
        "quality": QUALITY, "covariates": {},
    }  # fmt: skip


def test_table_options_apply_to_covariates_too(cruise: Path) -> None:
    keys = ["delimiter: ';'", "decimal: comma", "timezone: '+0200'", "missing: [-99.9, x]", "skip_rows: 2"]
    flow = f"{{format: table, files: raw/EG4/deep.csv, columns: {{date: d, clock: c, value: A}}, {', '.join(keys)}}}"
    depth = "    depth: 120\n"
    text = edited(with_line(f"covariates: {{supply: {flow}}}"), depth, depth + "".join(f"    {key}\n" for key in keys))
    write(cruise, MOORING_FILE, text)
    mooring = config.load_cruise(cruise).moorings["EG4"]
    wanted = {"delimiter": ";", "decimal": ",", "timezone": "+02:00", "missing": ["-99.9", "x"], "skip_rows": 2}
    for table in (mooring.instruments["deep"], mooring.covariates["supply"]):
        assert wanted.items() <= table.model_dump(mode="json").items()
    columns = mooring.covariates["supply"].columns
    assert columns is not None
    assert columns.model_dump(exclude_none=True) == {"date": "d", "clock": "c", "value": "A"}


def test_models_serialize_to_plain_json(cruise: Path) -> None:
    loaded = config.load_cruise(cruise)
    dumped = loaded.moorings["EG4"].model_dump(mode="json")
    assert json.loads(json.dumps(dumped, allow_nan=False)) == dumped
    assert json.loads(json.dumps(loaded.options.model_dump(mode="json"))) == loaded.options.model_dump(mode="json")


def test_an_empty_value_counts_as_absent(cruise: Path) -> None:
    write(cruise, MOORING_FILE, SHORTEST + "reference:\ncovariates:\ndiagnose: {apply: }\nattributes: {ship: }\n")
    mooring = config.load_cruise(cruise).moorings["M1"]
    assert (mooring.reference, mooring.covariates, mooring.diagnose.apply, mooring.attributes) == ((), {}, True, {})


def test_mooring_file_overrides_cruise_options(cruise: Path) -> None:
    write(cruise, "config/config.yaml", "fit: {method: von_appen}\ndiagnose: {apply: false, min_effect_deg: 2}\n")
    write(cruise, MOORING_FILE, edited(MOORING, "diagnose: {apply: true} ", "diagnose: {enabled: off} "))
    write(cruise, "config/moorings/M1.yaml", SHORTEST)
    own, general = config.load_cruise(cruise).moorings.values()
    assert (own.fit.method, general.fit.method) == ("exact", "von_appen")
    assert own.diagnose.model_dump() == DIAGNOSE | {"enabled": False, "apply": False, "min_effect_deg": 2.0}
    assert general.diagnose.model_dump() == DIAGNOSE | {"apply": False, "min_effect_deg": 2.0}


def test_keys_of_the_other_formats_are_read(cruise: Path) -> None:
    instruments = """\
instruments:
  top:
    format: mmp_acm
    files: [raw/EG4/b.000, raw/EG4/*.000]
    pressure_files: raw/EG4/deep.csv
    columns: {time: t, pressure: p}
    start_offset_seconds: 1e3
    exclude: [{from: 2007-10-01, to: 2007-10-02T12:00Z, why: fouled}, {from: 2008-01-01, to: 2008-01-02}]
  acm: {format: acm_table, files: raw/EG4/a.000, columns: {time: t, pressure: p, x: vx, y: vy, heading: h, tilt_x: tx, tilt_y: ty, temperature: T}}
  pd0: {format: pd0, files: raw/EG4/a.000, heading_alignment: 45, sound_speed: {salinity: 7}, direction_reference: true}
  speeds: {format: table, files: raw/EG4/a.000, depth: 5, columns: {time: t, speed: s, direction: d, heading: h}}
"""
    write(cruise, MOORING_FILE, SHORTEST.rpartition("instruments")[0] + instruments)
    found = config.load_cruise(cruise).moorings["M1"].instruments
    assert found["top"].files == ("raw/EG4/b.000", "raw/EG4/a.000", "raw/EG4/top.000")
    assert found["top"].pressure_files == ("raw/EG4/deep.csv",)
    assert found["top"].start_offset_seconds == 1000.0
    assert [(w.to_s - w.from_s, w.why) for w in found["top"].exclude] == [(129600.0, "fouled"), (86400.0, "")]
    assert (found["pd0"].heading_alignment, found["pd0"].direction_reference) == (45.0, "true")
    assert found["pd0"].sound_speed == {"salinity": 7.0}


@pytest.mark.parametrize(
    ("written", "hours"),
    [
        ("2007-09-04", 0),
        ("'2007-09-04'", 0),
        ("2007-09-04T06:00:00Z", 6),
        ("2007-09-04 06:00:00", 6),
        ("2007-09-04T06:00", 6),
        ("2007-09-04T06:00:00.000 UTC", 6),
        ("2007-09-04T06:00:00+02:00", 4),
        ("2007-09-04T06:00:00-0330", 9.5),
        ('"2007-09-04T06:00Z"', 6),
    ],
)
def test_dates_are_read_in_every_form(cruise: Path, written: str, hours: float) -> None:
    write(cruise, MOORING_FILE, with_line(f"start: {written}"))
    assert config.load_cruise(cruise).moorings["EG4"].start_s == 1188864000.0 + 3600 * hours


def test_dates_may_be_python_objects() -> None:
    zone = timezone(timedelta(hours=2))
    assert values.time_s(date(2007, 9, 4)) == 1188864000.0
    assert values.time_s(datetime.fromisoformat("2007-09-04")) == 1188864000.0
    assert values.time_s(datetime(2007, 9, 4, 2, tzinfo=zone)) == 1188864000.0


def test_attributes_that_look_like_other_types_stay_text(cruise: Path) -> None:
    texts = "{a: 2007-09-04, b: 0123, c: 12:30, d: no, e: 1e5, f: 123456789012345678901, g: 0x1F, h: .inf, i: 1_0}"
    write(cruise, MOORING_FILE, SHORTEST + f"attributes: {texts}\n")
    given = config.load_cruise(cruise).moorings["M1"].attributes
    assert list(given.values()) == re.findall(r": ([^,}]+)", texts)


def test_numbers_are_read_in_every_form(cruise: Path) -> None:
    for written, value in (("1e-2", 0.01), (".01", 0.01), ("+1.", 1.0), ("2.5E-1", 0.25), ("3", 3.0)):
        write(cruise, MOORING_FILE, edited(MOORING, "scale: 0.01", f"scale: {written}"))
        columns = config.load_cruise(cruise).moorings["EG4"].instruments["deep"].columns
        assert columns is not None
        assert columns.scale == value


def test_moorings_may_be_a_list_or_empty(cruise: Path) -> None:
    write(cruise, "other/Z.yaml", edited(MOORING, "name: EG4", "name: Z"))
    write(cruise, "config/config.yaml", f"moorings: [other/Z.yaml, {MOORING_FILE}]\n")
    assert list(config.load_cruise(cruise).moorings) == ["EG4", "Z"]
    write(cruise, "config/config.yaml", "moorings: []\n")
    assert config.load_cruise(cruise).moorings == {}


def test_moorings_are_ordered_by_file_name(cruise: Path) -> None:
    write(cruise, "config/moorings/A.yml", edited(MOORING, "name: EG4", "name: Z"))
    write(cruise, "config/moorings/.hidden.yaml", "not read")
    write(cruise, "config/moorings/notes.txt", "not read")
    assert list(config.load_cruise(cruise).moorings) == ["Z", "EG4"]


def test_file_name_that_looks_like_a_glob_is_literal(cruise: Path) -> None:
    write(cruise, "raw/EG4/top[1].000", "")
    write(cruise, MOORING_FILE, with_line('    files: "raw/EG4/top[1].000"'))
    assert config.load_cruise(cruise).moorings["EG4"].instruments["top"].files == ("raw/EG4/top[1].000",)


def test_demonstration_may_name_files_simulated_later(cruise: Path) -> None:
    write(cruise, "config/config.yaml", "demonstration: true\nseed: 7\n")
    write(cruise, MOORING_FILE, SHORTEST.replace("top.000", "later.000"))
    loaded = config.load_cruise(cruise)
    assert loaded.options.seed == 7
    assert loaded.moorings["M1"].instruments["top"].files == ("raw/EG4/later.000",)
    write(cruise, MOORING_FILE, SHORTEST.replace("top.000", "*.000"))
    assert message(cruise) == (
        "config/moorings/EG4.yaml: instruments.top.files: expected plain paths, as these files are "
        "made or fetched later, found 'raw/EG4/*.000'; list the files"
    )


def test_fit_by_calibration_requires_its_file_and_place(cruise: Path) -> None:
    write(cruise, MOORING_FILE, with_line("fit: {method: calibration, name: aqd}"))
    assert message(cruise) == (
        "config/moorings/EG4.yaml: fit.name: expected the file config/calibrations/aqd.yaml, found none; "
        "write that file or correct the name"
    )
    write(cruise, "config/calibrations/aqd.yaml", "kind: platform\nfile: raw/EG4/deep.csv\n")
    assert message(cruise) == (
        "config/moorings/EG4.yaml: fit.name: expected latitude, longitude and date in config/calibrations/aqd.yaml, "
        "to carry its coefficients to the mooring, found none; add them there"
    )
    placed = "kind: platform\nfile: raw/EG4/deep.csv\nlatitude: 48.4\nlongitude: -4.5\ndate: 2022-09-29\n"
    write(cruise, "config/calibrations/aqd.yaml", placed)
    assert config.load_cruise(cruise).moorings["EG4"].fit.name == ("aqd",)


def test_configuration_of_a_real_cruise_is_read() -> None:
    folder = ROOT.parent / "shared/data/cruise_eh2"
    if not folder.is_dir():
        pytest.skip(f"no {folder}: the real records are not part of this repository")
    loaded = config.load_cruise(folder)
    assert list(loaded.moorings) == ["E0", "E1", "E2"]
    assert loaded.moorings["E2"].fit.method == "von_appen"
    assert loaded.moorings["E0"].instruments["deep"].direction_reference == "true"


def test_readme_documents_every_key_and_format() -> None:
    text = (ROOT / "config/README.md").read_text()
    named = [*vars(schema).values(), *vars(section).values(), *vars(calibrations).values()]
    models = [m for m in named if isinstance(m, type) and issubclass(m, schema.Section)]
    keys = {key for model in models for key in schema.allowed_keys(model)}
    assert [key for key in sorted(keys) if f"`{key}`" not in text] == []
    pages = text, (ROOT / "docs/reference/formats.md").read_text()
    assert [form for form in readers.FORMATS if any(f"`{form}`" not in page for page in pages)] == []


def test_product_keys_are_inherited_singly_but_the_grid_whole(cruise: Path) -> None:
    write(
        cruise, "config/config.yaml", CONFIG + "product: {daily: true, grid: {minutes: 60, step_m: auto}, flags: 1}\n"
    )
    write(cruise, MOORING_FILE, with_line("product: {grid: {step_m: 4, from_m: 20}}"))
    loaded = config.load_cruise(cruise)
    assert loaded.options.product.model_dump() == {"grid": GRID | {"minutes": 60.0}, "flags": (1,), "daily": True}
    made = loaded.moorings["EG4"].product
    assert made.grid and (made.grid.step_m, made.grid.from_m, made.grid.minutes) == (4.0, 20.0, None)
    assert made.daily and made.flags == (1,)
    write(cruise, MOORING_FILE, with_line("product: {grid: false}"))
    assert config.load_cruise(cruise).moorings["EG4"].product.grid is None


# --- invalid input, in one line -------------------------------------------------------------------------------------

BAD_LINES = [
    ("product: {grid: {minutes: often}}", "product.grid.minutes: expected auto, or minutes from 1 to 1440, found 'often'; write for example minutes: 60"),
    ("product: {grid: {from_m: 90, to_m: 80}}", "product.grid.to_m: expected metres below from_m, 90.0, found 80; correct one of the two"),
    ("product: {flags: [1, 4]}", "product.flags: expected a list of flags out of 1, 2 and 3, found a list; write for example flags: [1, 2]"),
    ("product: {grid: {step_m: 0.000001}}", "product.grid.step_m: expected auto, or metres from 0.1 to 1000, found 1e-06; write for example step_m: 8"),
    ("latitude: 95.3", "latitude: expected a number from -90 to 90, found 95.3; check the sign and the order of latitude and longitude"),
    ("latitude: 65,3", "latitude: expected a number from -90 to 90, found '65,3'; write a number with a point, without quotes, unit or leading zeros"),
    ("latitude: true", "latitude: expected a number from -90 to 90, found true; check the sign and the order of latitude and longitude"),
    ("latitude: 1e999", "latitude: expected a number from -90 to 90, found '1e999'; check the sign and the order of latitude and longitude"),
    ("latitude: [65]", "latitude: expected a number from -90 to 90, found a list; check the sign and the order of latitude and longitude"),
    ("latitude:", "latitude: expected a number from -90 to 90, found nothing; add for example latitude: 65.3333"),
    ("longitude: -181", "longitude: expected a number from -180 to 360, found -181; check the sign and the order of latitude and longitude"),
    ("water_depth: 0", "water_depth: expected metres above 0, at most 12000, found 0; write it positive, in metres"),
    ("start: 04.09.2007", "start: expected a date or UTC time from 1980 to 2100, found '04.09.2007'; write for example start: 2007-09-04T00:00:00Z"),
    ("start: 2007-13-04", "start: expected a date or UTC time from 1980 to 2100, found '2007-13-04'; write for example start: 2007-09-04T00:00:00Z"),
    ("start: 1907-09-04", "start: expected a date or UTC time from 1980 to 2100, found '1907-09-04'; write for example start: 2007-09-04T00:00:00Z"),
    ("start: 20070904", "start: expected a date or UTC time from 1980 to 2100, found 20070904; write for example start: 2007-09-04T00:00:00Z"),
    ("end: 2006-10-04", "end: expected a time after start, 2007-09-04T00:00:00Z, found 2006-10-04T00:00:00Z; correct one of the two"),
    ("declination: IGRF", "declination: expected auto, or degrees east from -180 to 180, found 'IGRF'; write for example declination: auto"),
    ("declination: 181", "declination: expected auto, or degrees east from -180 to 180, found 181; write for example declination: auto"),
    ("name: ../EG4", "name: expected 1 to 64 letters, digits, '_', '.' and '-', the first a letter or digit, found '../EG4'; write for example EG4"),
    ("name: 2007", "name: expected 1 to 64 letters, digits, '_', '.' and '-', the first a letter or digit, found 2007; write it in quotes: '2007'"),
    ("name: M1;touch x", "name: expected 1 to 64 letters, digits, '_', '.' and '-', the first a letter or digit, found 'M1;touch x'; write for example EG4"),
    ("name: proof", "name: expected a name other than calibrations, compasses, proof, logs, benchmarks, figures, summary.csv, report.html, usable.json, ro-crate-metadata.json, which results/ holds for other things, found 'proof'; rename the mooring"),
    ("compromised: tpo", "compromised: expected an instrument of this mooring (top, deep), found 'tpo'; write one of these names"),
    ("reference: bottom", "reference: expected an instrument of this mooring (top, deep), found 'bottom'; write one of these names"),
    ("reference: top", "reference: expected another instrument than compromised, found 'top'; name the reference instrument, or delete reference where there is none"),
    ("latitud: 65", "latitud: expected a key out of name, latitude, longitude, water_depth, start, end, declination, compromised, reference, instruments, attributes, fit, diagnose, confirmed, product, quality, covariates, found the unknown 'latitud'; write latitude"),
    ("fit: {method: von_appen, tilt: true}", "fit.tilt: expected it only with method: exact, found it with von_appen; delete it"),
    ("fit: {method: exakt}", "fit.method: expected exact, von_appen, calibration, coefficients or pairs, found 'exakt'; write exact"),
    ("fit: exact", "fit: expected a mapping, found 'exact'; write below it keys out of method, name, tilt, model, coefficients, covariance, file, columns"),
    ("fit: {method: coefficients}", "fit.coefficients: expected it with method: coefficients, found nothing; add it, see config/README.md"),
    ("fit: {method: coefficients, coefficients: {A: 1}}", "fit.coefficients: expected the five numbers A to E, found a mapping; write for example coefficients: {A: 0, B: 0.3, C: 0.1, D: 0, E: 0}"),
    ("fit: {method: exact, model: exact}", "fit.model: expected it only with method: coefficients or pairs, found it with exact; delete it"),
    ("fit: {method: coefficients, coefficients: {A: 0, B: 0, C: 0, D: 0, E: 0}, covariance: [[-1,0,0,0,0],[0,1,0,0,0],[0,0,1,0,0],[0,0,0,1,0],[0,0,0,0,1]]}", "fit.covariance: expected five rows of five numbers, a covariance, found a list; write for example covariance: [[...], ...]"),
    ("fit: {method: calibration}", "fit.name: expected the NAME of config/calibrations/NAME.yaml, found nothing; write fit: {method: calibration, name: NAME}"),
    ("fit: {method: exact, name: aqd}", "fit.name: expected no name beside method: exact, found 'aqd'; delete it or write method: calibration"),
    ("diagnose: {apply: maybe}", "diagnose.apply: expected true or false, found 'maybe'; write for example apply: true"),
    ("attributes: {ship: [a, b]}", "attributes.ship: expected a text or a number, found a list; write it in quotes: ship: '...'"),
    ("attributes: {Software_Version: 9}", "attributes.Software_Version: expected attributes that describe, such as institution, title or comment, found 'Software_Version', which the product states itself; delete it"),
    ("    attributes: {date_created: 1970-01-01}", "instruments.top.attributes.date_created: expected attributes that describe, such as institution, title or comment, found 'date_created', which the product states itself; delete it"),
    ("attributes: {'': c}", "attributes: expected attribute names of letters, digits and '_', found ''; write for example ship"),
    ("attributes: {a b: c}", "attributes: expected attribute names of letters, digits and '_', found 'a b'; write for example ship"),
    ("covariates: {obs: {format: iaga2002, files: raw/obs/*.hor}}", "covariates.obs.files: expected an existing file, found no file that matches raw/obs/*.hor; put it there or correct the path, relative to the cruise folder"),
    ("covariates: {echo: {format: table, files: raw/obs/lrv1.min, columns: {time: t, value: x}}}", "covariates.echo: expected for a table a name that the search does not use itself, found 'echo'; for example echo_logged"),
    ("covariates: {obs: {format: table, files: raw/obs/lrv1.min}}", "covariates.obs.columns: expected the headers of time and value, found nothing; add for example columns: {time: time_utc, value: current_mA}"),
    ("covariates: {a b: {format: iaga2002, files: raw/obs/*.min}}", "covariates.a b: expected 1 to 64 letters, digits, '_', '.' and '-', the first a letter or digit, found 'a b'; write for example EG4"),
    ("covariates: {supply: {format: table, files: raw/EG4/deep.csv}}", "covariates.supply.columns: expected the headers of time and value, found nothing; add for example columns: {time: time_utc, value: current_mA}"),
    ("covariates: {supply: {format: table, files: raw/EG4/deep.csv, columns: {time: t}}}", "covariates.supply.columns.value: expected the header of the column that holds the series, found nothing; add for example value: current_mA"),
    ("covariates: {obs: {format: iaga2002, files: raw/obs/*.min, unit: nT}}", "covariates.obs.unit: expected this key only with format table, found it with format iaga2002; delete it or correct the format"),
    ("    delimiter: ';'", "instruments.top.delimiter: expected this key only with format table or acm_table or mmp_acm, found it with format pd0; delete it or correct the format"),
    ("    delimiter: '|'", "instruments.top.delimiter: expected comma, semicolon, tab or blank, found '|'; write for example delimiter: semicolon"),
    ("    time_format: '%H:%M'", "instruments.top.time_format: expected a strptime format such as '%d/%m/%Y %H:%M', or epoch, epoch_ms, datenum, decimal_year or excel, found '%H:%M'; write year, month and day, for example '%d/%m/%Y %H:%M'"),
    ("    timezone: CET", "instruments.top.timezone: expected UTC or an offset such as '+02:00', found 'CET'; write for example timezone: '+02:00'"),
    ("    missing: [[1]]", "instruments.top.missing: expected a list of numbers or texts that stand for nothing, found a list; write for example missing: [-99.9, ----]"),
    ("    skip_rows: -1", "instruments.top.skip_rows: expected a whole number from 0 to 100000 of lines above the header, found -1; write for example skip_rows: 3"),
    ("    format: PD0", "instruments.top.format: expected pd0, table, acm_table, mmp_acm, netcdf, rdi_text, pd12 or nortek, found 'PD0'; write for example format: pd0"),
    ("    format: tabel", "instruments.top.format: expected pd0, table, acm_table, mmp_acm, netcdf, rdi_text, pd12 or nortek, found 'tabel'; write table"),
    ("    files: raw/EG4/no.000", "instruments.top.files: expected an existing file, found no file raw/EG4/no.000; put it there or correct the path, relative to the cruise folder"),
    ("    files: raw/EG4/*.001", "instruments.top.files: expected an existing file, found no file that matches raw/EG4/*.001; put it there or correct the path, relative to the cruise folder"),
    ("    files: raw/EG4", "instruments.top.files: expected a file, found the folder raw/EG4; write raw/EG4/* for all files in it"),
    ("    files: []", "instruments.top.files: expected at least one file, found an empty list; write for example files: raw/EG4/top.000"),
    ("    files: /etc/passwd", "instruments.top.files: expected a path inside the cruise folder, relative to it, found '/etc/passwd'; copy or link the file into the cruise folder and write its path from there"),
    ("    files: ~/top.000", "instruments.top.files: expected a path inside the cruise folder, relative to it, found '~/top.000'; copy or link the file into the cruise folder and write its path from there"),
    ("    files: raw/../../top.000", "instruments.top.files: expected a path inside the cruise folder, relative to it, found 'raw/../../top.000'; copy or link the file into the cruise folder and write its path from there"),
    ("    files: C:\\top.000", "instruments.top.files: expected a path inside the cruise folder, relative to it, found 'C:\\\\top.000'; copy or link the file into the cruise folder and write its path from there"),
    ("    files: 7", "instruments.top.files: expected a path, a list of paths or a glob, relative to the cruise folder, found 7; write it in quotes: '7'"),
    ("    depth: -100", "instruments.top.depth: expected metres from 0 to 12000, found -100; write it positive, in metres"),
    ("    depth: 1000", "instruments.top.depth: expected metres from 0 to the water depth, 894, found 1000; correct one of the two"),
    ("    orientation: upward", "instruments.top.orientation: expected up or down, found 'upward'; write for example orientation: up"),
    ("    sphere: false", "instruments.top.sphere: expected true, or a name that all records in one sphere or frame carry, found false; write for example sphere: sphere3"),
    ("    sphere_distance_m: [0.6, 0.4]", "instruments.top.sphere_distance_m: expected a distance in metres, or [from, to], found a list; write for example sphere_distance_m: [0.4, 0.6]"),
    ("    heading: 3", "instruments.top.heading: expected a key out of format, files, depth, orientation, declination_applied, heading_alignment, sound_speed, clock_offset_seconds, clock_drift_seconds, pressure_offset, direction_reference, exclude, compass, sphere, compass_sigma_deg, compass_iron_nT, kind, parts, sphere_distance_m, fit, attributes, columns, pressure_files, start_offset_seconds, bin_size, first_bin, flags, delimiter, decimal, time_format, timezone, missing, skip_rows, found the unknown 'heading'; delete it, or indent it below the key that it belongs to"),
    ("    sound_speed: {salinity: 43}", "instruments.top.sound_speed: expected auto, keep, or {salinity: 0 to 42}, found a mapping; write for example sound_speed: {salinity: 35}"),
    ("    declination_applied: {heading: 3}", "instruments.top.declination_applied: expected degrees from -180 to 180, or {heading: degrees, velocity: degrees}, found heading; write both, for example {heading: 0, velocity: -17.4}"),
    ("    declination_applied: {heading: 3, velocity: 181}", "instruments.top.declination_applied: expected degrees from -180 to 180, or {heading: degrees, velocity: degrees}, found a mapping; write for example declination_applied: 0"),
    ("    format: netcdf\n    flags: {good: [1], bad: ['1']}", "instruments.top.flags: expected each meaning once, found '1' twice; delete one of the two"),
    ("    format: netcdf\n    flags: {}", "instruments.top.flags: expected good, bad or unchecked, found none of them; write for example {bad: [side_lobe]}"),
    ("    bin_size: 16", "instruments.top.bin_size: expected this key only with format pd12, found it with format pd0; delete it or correct the format"),
    ("    format: netcdf\n    columns: {speed: s, direction: d}", "instruments.top.columns.speed: expected this role only with tables, found it with format netcdf; delete it"),
    ("    format: mmp_acm\n    columns: {range: r}", "instruments.top.columns.range: expected this role only with format netcdf, found it with format mmp_acm; delete it"),
    ("    pressure_offset: 2 dbar", "instruments.top.pressure_offset: expected dbar from -12000 to 12000, found '2 dbar'; write a number with a point, without quotes, unit or leading zeros"),
    ("    exclude: {from: 2007-10-01, to: 2007-10-02}", "instruments.top.exclude: expected a list of windows, found a mapping; write for example exclude: [{from: 2007-10-01, to: 2007-10-02, why: fouled}]"),
    ("    exclude: [2007-10-01]", "instruments.top.exclude[0]: expected a mapping, found '2007-10-01'; write below it keys out of from, to, why"),
    ("    exclude: [{from: 2007-10-01}]", "instruments.top.exclude[0].to: expected a date or UTC time from 1980 to 2100, found nothing; add for example to: 2007-10-02T00:00:00Z"),
    ("    exclude: [{from: 2009-01-01, to: 2009-01-02}]", "instruments.top.exclude[0]: expected a window within the deployment, 2007-09-04T00:00:00Z to 2008-10-04T00:00:00Z, found 2009-01-01T00:00:00Z to 2009-01-02T00:00:00Z; correct or delete it"),
    ("    exclude: [{from: 2007-10-02, to: 2007-10-01}]", "instruments.top.exclude[0].to: expected a time after from, 2007-10-02T00:00:00Z, found 2007-10-01T00:00:00Z; correct one of the two"),
    ("    direction_reference: grid", "instruments.deep.direction_reference: expected magnetic or true, found 'grid'; write for example direction_reference: magnetic"),
]  # fmt: skip

BAD_COLUMNS = [
    ("{depth: d, east: u, north: v}", "columns.time: expected the header of the time column, found nothing; add for example time: time_utc"),
    ("{date: d, east: u, north: v}", "columns.clock: expected date and clock together, found date alone; add clock, or write time: where one column holds both"),
    ("{time: t, date: d, clock: c, east: u, north: v}", "columns.time: expected time, or date and clock apart, found clock and date beside it; keep one of the two ways"),
    ("{time: t, east: u}", "columns.north: expected east+north together, found east without it; add for example north: name_in_the_header"),
    ("{time: t, x: u, y: v}", "columns.heading: expected x+y+heading together, found x and y without it; add for example heading: name_in_the_header"),
    ("{time: t}", "columns: expected exactly one of east+north, speed+direction and x+y+heading, found none of them; add for example east: u_cm_s and north: v_cm_s"),
    ("{time: t, east: u, north: v, speed: s, direction: d}", "columns: expected exactly one of east+north, speed+direction and x+y+heading, found east+north and speed+direction; keep one of them"),
    ("{time: t, east: u, north: u}", "columns.north: expected a column of its own, found 'u', which east has already; correct one of the two"),
    ("{time: t, east: 1, north: v}", "columns.east: expected the header of a column (speed), found 1; write it in quotes: '1'"),
    ("{time: t, east: u, north: v, scale: 0}", "columns.scale: expected a factor to m/s above 0, at most 1000, found 0; write for example scale: 0.01"),
    ("{time: t, east: u, north: v, tilt: w}", "columns.tilt: expected a key out of time, date, clock, depth, pressure, east, north, speed, direction, x, y, heading, tilt_x, tilt_y, temperature, flag, range, scale, found the unknown 'tilt'; write tilt_y"),
    ("[time_utc, u, v]", "columns: expected a mapping, found a list; write below it keys out of time, date, clock, depth, pressure, east, north, speed, direction, x, y, heading, tilt_x, tilt_y, temperature, flag, range, scale"),
]  # fmt: skip

BAD_FILES = [
    ("", "expected keys with values, found an empty file; write for example name: EG4"),
    ("# nothing yet\n", "expected keys with values, found an empty file; write for example name: EG4"),
    ("- name: EG4\n", "expected keys with values, found a list; write for example name: EG4"),
    ("EG4", "expected keys with values, found a single value; write for example name: EG4"),
    ("name: EG4\nname: EG5\n", "line 2, column 1: expected every key once, found 'name' again, first in line 1; delete one of the two"),
    ("fit: {method: exact, method: exact}\n", "line 1, column 22: expected every key once, found 'method' again, first in line 1; delete one of the two"),
    ("a: &x 1\n", "line 1, column 4: expected plain values without anchors, found &x; write the value out in full"),
    ("a: *x\n", "line 1, column 4: expected plain values without aliases, found *x; write the value out in full"),
    ("a: !!python/object:os.system x\n", "line 1, column 4: expected plain values without tags, found the tag tag:yaml.org,2002:python/object:os.system; delete the tag"),
    ("? [a, b]\n: 1\n", "line 1, column 3: expected a word as key, found a list or mapping; check braces and colons"),
    ("fit:\n\tmethod: exact\n", "line 2, column 1: expected YAML, found a mistake of form (found character that cannot start any token); check indentation, colons, quotes and brackets"),
    ("name: 'EG4\n", "line 2, column 1: expected YAML, found a mistake of form (found unexpected end of stream); check indentation, colons, quotes and brackets"),
    ("name:EG4\nlatitude: 1\n", "line 2, column 9: expected YAML, found a mistake of form (mapping values are not allowed in this context); check indentation, colons, quotes and brackets"),
    ("name: EG4\n---\nname: EG5\n", "line 2, column 1: expected YAML, found a mistake of form (but found another document); check indentation, colons, quotes and brackets"),
    ("name: EG4\n  latitude: 1\n", "line 2, column 11: expected YAML, found a mistake of form (mapping values are not allowed in this context); check indentation, colons, quotes and brackets"),
    ("a:\n    b: 1\n  c: 2\n", "line 3, column 3: expected YAML, found a mistake of form (did not find expected key); check indentation, colons, quotes and brackets"),
    ("fit: {method: exact\nname: a\n", "line 2, column 5: expected YAML, found a mistake of form (did not find expected ',' or '}'); check indentation, colons, quotes and brackets"),
    ("name: EG4\nlatitude\nlongitude: 1\n", "line 3, column 1: expected YAML, found a mistake of form (could not find expected ':'); check indentation, colons, quotes and brackets"),
    ("name: @EG4\n", "line 1, column 7: expected YAML, found a mistake of form (found character that cannot start any token); check indentation, colons, quotes and brackets"),
    ("a: " + "[" * 100_000, "line 1, column 23: expected mappings and lists a few levels deep, found deeper nesting than 20 levels; check the brackets and indentation"),
    ("name: EG4\nship: \x07\n", "line 2: expected printable text, found a control character; delete it"),
    ('name: "\\ud800"\n', "line 1, column 10: expected YAML, found a mistake of form (found invalid Unicode character escape code); check indentation, colons, quotes and brackets"),
    ('"a\\0": 1\n', "line 1, column 1: expected printable text, found the control character 0x00; delete it"),
    (b"name: Gr\xf6nland\n", "expected UTF-8 text, found other bytes at 8; save the file as UTF-8"),
    ("name: EG4\n".encode("utf-16"), "expected UTF-8 text, found other bytes at 0; save the file as UTF-8"),
    ("#" * 1_000_001, "expected at most 1000000 bytes, found 1000001; check that it is the YAML file and not data"),
    ("<<: {name: EG4}\n", "<<: expected a key out of name, latitude, longitude, water_depth, start, end, declination, compromised, reference, instruments, attributes, fit, diagnose, confirmed, product, quality, covariates, found the unknown '<<'; delete it, or indent it below the key that it belongs to"),
]  # fmt: skip

BAD_OPTIONS = [
    ("demonstration: 1", "demonstration: expected true or false, found 1; write for example demonstration: false"),
    ("figures: {formats: [[png]]}", "figures.formats: expected a list of png and pdf, found a list; write for example formats: [png, pdf]"),
    ("supersedes: [a.zip, b.zip]", "supersedes: expected one ZIP, relative to the cruise folder, found 2; write for example supersedes: deposits/v1.zip"),
    ("seed: 1.5", "seed: expected a whole number from 0 to 4294967295, found 1.5; write for example seed: 2007"),
    ("overlap: {bins: 0}", "overlap.bins: expected a whole number from 1 to 255, found 0; write for example bins: 2"),
    ("overlap: {max_minuts: 20}", "overlap.max_minuts: expected a key out of max_minutes, max_metres, bins, predict, grid_minutes, grid_tolerance_minutes, found the unknown 'max_minuts'; write max_minutes"),
    ("overlap: {grid_minutes: 0}", "overlap.grid_minutes: expected minutes above 0, at most 1440, found 0; write for example grid_minutes: 60"),
    ("fit: {method: calibration, name: aqd}", "fit.method: expected exact or von_appen for a whole cruise, found 'calibration'; write it in the mooring's own file"),
    ("diagnose: {prior_odds: 0}", "diagnose.prior_odds: expected odds above 0, to 1000, found 0; write for example prior_odds: 1"),
    ("diagnose: {surrogates: -1}", "diagnose.surrogates: expected a whole number from 0 to 9999, found -1; write for example surrogates: 199"),
    ("diagnose: {min_effect_deg: -1}", "diagnose.min_effect_deg: expected degrees from 0 to 180, found -1; write for example min_effect_deg: 0.5"),
    ("moorings: config/mooring", "moorings: expected a folder with files NAME.yaml, found no folder config/mooring; put the mooring files there, or write moorings: [] where the cruise has none"),
    ("moorings: raw", "moorings: expected a folder with files NAME.yaml, found none in raw; put the mooring files there, or write moorings: [] where the cruise has none"),
    ("moorings: [config/moorings/X.yaml]", "moorings: expected existing mooring files, found no file config/moorings/X.yaml; put it there or correct the path, relative to the cruise folder"),
    ("moorings: {a: b}", "moorings: expected a folder of mooring files or a list of them, found a mapping; write for example moorings: config/moorings"),
    ("moorings: ../other", "moorings: expected a path inside the cruise folder, relative to it, found '../other'; copy or link the file into the cruise folder and write its path from there"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "expected"), BAD_LINES, ids=[line.strip() for line, _ in BAD_LINES])
def test_invalid_line_in_a_mooring_file_is_reported(cruise: Path, line: str, expected: str) -> None:
    write(cruise, MOORING_FILE, with_line(line))
    assert message(cruise) == f"{MOORING_FILE}: {expected}"


def test_raw_file_name_with_braces_is_refused(cruise: Path) -> None:
    write(cruise, "raw/obs/{lrv3}.min", "")
    found = "covariates.declination_observatory.files: expected a path without braces"
    assert message(cruise) == f"{MOORING_FILE}: {found}, found 'raw/obs/{{lrv3}}.min'; rename the file"


@pytest.mark.parametrize(("columns", "expected"), BAD_COLUMNS, ids=[columns for columns, _ in BAD_COLUMNS])
def test_invalid_columns_are_reported(cruise: Path, columns: str, expected: str) -> None:
    write(cruise, MOORING_FILE, edited(MOORING, COLUMNS, columns))
    assert message(cruise) == f"{MOORING_FILE}: instruments.deep.{expected}"


@pytest.mark.parametrize(("content", "expected"), BAD_FILES, ids=[repr(content[:30]) for content, _ in BAD_FILES])
def test_invalid_yaml_file_is_refused(cruise: Path, content: str | bytes, expected: str) -> None:
    write(cruise, MOORING_FILE, content)
    assert message(cruise) == f"{MOORING_FILE}: {expected}"


@pytest.mark.parametrize(("line", "expected"), BAD_OPTIONS, ids=[line for line, _ in BAD_OPTIONS])
def test_invalid_cruise_option_is_reported(cruise: Path, line: str, expected: str) -> None:
    write(cruise, "config/config.yaml", line + "\n")
    assert message(cruise) == f"config/config.yaml: {expected}"


BAD_INSTRUMENTS = [
    ("format: pd12,", "top.orientation: expected up or down, which pd12 does not tell, found nothing; add for example orientation: up"),
    ("format: pd12, orientation: up, bin_size: 16,", "top.first_bin: expected metres above 0, at most 1000, which pd12 does not tell, found nothing; add for example first_bin: 24.7"),
    ("format: table, columns: {time: t, east: u, north: v},", "top.columns: expected a depth or pressure column where the instrument has no depth, found neither; add depth: 120 to the instrument, or depth: depth_m to its columns"),
    ("format: pd0, columns: {time: t},", "top.columns: expected this key only with format table or acm_table or mmp_acm or netcdf, found it with format pd0; delete it or correct the format"),
    ("format: pd0, pressure_files: raw/EG4/deep.csv,", "top.pressure_files: expected this key only with format mmp_acm, found it with format pd0; delete it or correct the format"),
    ("format: pd0, start_offset_seconds: 4,", "top.start_offset_seconds: expected this key only with format mmp_acm, found it with format pd0; delete it or correct the format"),
    ("format: mmp_acm, heading_alignment: 4,", "top.heading_alignment: expected this key only with format pd0 or netcdf, found it with format mmp_acm; delete it or correct the format"),
    ("format: netcdf, sound_speed: keep,", "top.sound_speed: expected this key only with format pd0, found it with format netcdf; delete it or correct the format"),
    ("format: pd0, flags: {good: [1]},", "top.flags: expected this key only with format table or acm_table or netcdf, found it with format pd0; delete it or correct the format"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "expected"), BAD_INSTRUMENTS, ids=[keys for keys, _ in BAD_INSTRUMENTS])
def test_invalid_keys_of_a_format_are_reported(cruise: Path, keys: str, expected: str) -> None:
    write(cruise, MOORING_FILE, SHORTEST.replace("format: pd0,", keys))
    assert message(cruise) == f"{MOORING_FILE}: instruments.{expected}"


@pytest.mark.parametrize(("keys", "declared"), [("", False), (" sphere: true,", True), (" sphere: s1,", True),
                                               (" sphere_distance_m: 0.5,", True)])  # fmt: skip
def test_iron_is_declared_by_a_sphere_or_its_distance(cruise: Path, keys: str, declared: bool) -> None:
    write(cruise, MOORING_FILE, SHORTEST.replace("format: pd0,", f"format: pd0,{keys}"))
    assert Moorings(config.load_cruise(cruise)).fit("M1")["sphere"] is declared


def test_declination_applied_may_differ_for_heading_and_velocity(cruise: Path) -> None:
    both = "declination_applied: {heading: 0, velocity: -17.4}"
    for form, taken in (("pd0", True), ("rdi_text", False)):
        write(cruise, MOORING_FILE, SHORTEST.replace("format: pd0,", f"format: {form}, {both},"))
        of = Moorings(config.load_cruise(cruise))
        given, inside = of.read("M1", "top"), {"heading": 0.0, "velocity": -17.4}
        assert of.overlap("M1")["place"]["applied"] == {"top (velocity)": -17.4}
        assert given["deployment"]["declination_applied"] == (0.0 if taken else inside)
        assert given["reader"].get("declination_applied") == (inside if taken else None)
    columns = "depth: 10, columns: {time: t, x: u, y: v, heading: h}"
    write(cruise, MOORING_FILE, SHORTEST.replace("format: pd0,", f"format: acm_table, {columns}, {both},"))
    assert "declination_applied: expected one number, as these velocities are turned by the headings" in message(cruise)


def test_missing_config_file_is_reported(tmp_path: Path) -> None:
    assert message(tmp_path) == (
        f"config/config.yaml: expected this file in {tmp_path}, found none; "
        "write one, for example with the line moorings: config/moorings"
    )


def test_duplicate_mooring_name_is_refused(cruise: Path) -> None:
    write(cruise, "config/moorings/copy.yaml", MOORING)
    assert message(cruise) == (
        "config/moorings/copy.yaml: name: expected a name of its own, found 'EG4', "
        "which config/moorings/EG4.yaml has already; rename one of the two"
    )


def test_damaged_yaml_is_read_or_refused_in_one_line(cruise: Path) -> None:
    rng = random.Random(2007)
    read, refused = 0, []
    for _ in range(100):
        damaged = bytearray(MOORING.encode())
        for _ in range(rng.randint(1, 4)):
            place = rng.randrange(len(damaged))
            end = place + rng.randint(0, 3)
            damaged[place:end] = rng.choice([b"", b":", b"[", b"\t", b"\n", b"'", b"\xff", b"9"])
        write(cruise, MOORING_FILE, bytes(damaged))
        try:
            read += len(config.load_cruise(cruise).moorings)
        except InputError as error:
            refused.append(str(error))
    assert [line for line in refused if "\n" in line or len(line) > 580] == []
    assert read + len(refused) == 100
    assert min(read, len(refused)) > 15  # damage is often within a comment


def test_long_values_are_truncated_in_messages(cruise: Path) -> None:
    write(cruise, MOORING_FILE, with_line("latitude: " + "x" * 5000))
    assert len(message(cruise)) < 250
    write(cruise, MOORING_FILE, with_line("x" * 1000 + ": 1"))
    assert len(message(cruise)) < 500


def test_instrument_may_share_its_name_with_a_key(cruise: Path) -> None:
    write(cruise, MOORING_FILE, SHORTEST.replace("top: {", "depth: {orientation: left, "))
    assert message(cruise) == (
        f"{MOORING_FILE}: instruments.depth.orientation: expected up or down, found 'left'; "
        "write for example orientation: up"
    )


@pytest.mark.parametrize("name", [*schema.RESERVED, "Logs", "RO-Crate-metadata.json"])
def test_reserved_mooring_names_are_refused(cruise: Path, name: str) -> None:
    write(cruise, MOORING_FILE, with_line(f"name: {name}"))
    assert "name: expected a name other than calibrations" in message(cruise)


def test_mooring_names_differing_only_in_case_are_refused(cruise: Path) -> None:
    write(cruise, "config/moorings/M1.yaml", SHORTEST)
    write(cruise, "config/moorings/m1.yaml", SHORTEST.replace("M1", "m1"))
    assert "found 'm1', which config/moorings/M1.yaml has already in other letters" in message(cruise)


SECOND = SHORTEST.replace("name: M1", "name: M2").replace("top.000}", "top.000, compass: wh1}")


BAD_COMPASSES = [
    (SECOND, "instruments.top.compass: expected a compass that is in one place from 2007-09-04T00:00:00Z to 2008-10-04T00:00:00Z, found wh1 at EG4 (top), 2007-09-04T00:00:00Z to 2008-10-04T00:00:00Z; correct the dates, or give one of the two compasses another name"),
    (SECOND.replace("wh1", "WH1"), "instruments.top.compass: expected a name that no other has in other letters, found 'WH1', and calibration aqd has wh1; write both alike, or rename one"),
    (SECOND.replace("M2", "aqd"), "instruments.top.compass: expected another name of the mooring than of the compass's calibration, found aqd for both; rename one of the two"),
    (SECOND + "fit: {method: calibration, name: aqd}\n", "fit.method: expected another method beside compass: wh1, by which calibrations of it come in already, found 'calibration'; delete fit here, and write compass: wh1 in the calibration's file"),
]  # fmt: skip


@pytest.mark.parametrize(("second", "expected"), BAD_COMPASSES)
def test_conflicting_uses_of_a_compass_are_refused(cruise: Path, second: str, expected: str) -> None:
    write(cruise, MOORING_FILE, MOORING.replace("    depth: 100 ", "    compass: wh1\n    depth: 100 "))
    write(cruise, "config/moorings/M2.yaml", second)
    place = "latitude: 1\nlongitude: 1\ndate: 2001-01-01\n"
    write(cruise, "config/calibrations/aqd.yaml", f"kind: platform\nfile: raw/EG4/top.000\ncompass: wh1\n{place}")
    assert message(cruise) == f"config/moorings/M2.yaml: {expected}"
    later = SECOND.replace("end: 2008-10-04", "end: 2008-12-04").replace("start: 2007-09-04", "start: 2008-10-04")
    write(cruise, "config/moorings/M2.yaml", later)
    assert config.load_cruise(cruise).moorings["M2"].instruments["top"].compass == "wh1"


@pytest.mark.parametrize("name", [b"a\xff.000", b"a\n.000", "a\u202e.000".encode()])
def test_unprintable_file_names_are_refused(cruise: Path, name: bytes) -> None:
    (Path(os.fsdecode(os.fsencode(cruise) + b"/raw/EG4/" + name))).touch()
    write(cruise, MOORING_FILE, edited(MOORING, "raw/EG4/top.000", "raw/EG4/*.000"))
    said = message(cruise)
    assert "files: expected a path in UTF-8 without control characters, found 'raw/EG4/a" in said
    said.encode()
    write(cruise, MOORING_FILE, MOORING)
    (Path(os.fsdecode(os.fsencode(cruise) + b"/config/moorings/" + name + b".yaml"))).touch()
    assert "config/moorings: expected names in UTF-8 without control characters" in message(cruise)


def test_json_schemas_match_models_and_accept_all_configurations() -> None:
    made = json_schema.schemas()
    assert {path.name: path.read_text() for path in (ROOT / json_schema.FOLDER).iterdir()} == made, "run: make schema"
    folders = [ROOT / "config", *ROOT.glob("examples/*/config")]
    kinds = {"config": "config.yaml", "mooring": "moorings/*.yaml", "calibration": "calibrations/*.yaml"}
    for kind, pattern in kinds.items():
        check = jsonschema.Draft202012Validator(json.loads(made[f"{kind}.json"]))
        for path in (path for folder in folders for path in folder.glob(pattern)):
            check.validate(content := json.loads(json.dumps(yaml.safe_load(path.read_text()), default=str)))
            assert not check.is_valid(content | {"lattitude": 1}), path
    assert check.is_valid(content) and not check.is_valid(content | {"kind": "another"})
