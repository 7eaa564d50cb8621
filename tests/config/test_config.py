"""Would catch a key of a cruise that is ignored, or a mistake in one without a line that names its place."""

# ruff: noqa: E501, RUF100 - messages are compared as printed, on one line

import json
import os
import re
from datetime import UTC, datetime
from pathlib import Path

import jsonschema
import pytest
import yaml

from compasslib import readers
from compasslib.config import calibrations, schema, section
from compasslib.config import cruise as config
from compasslib.errors import InputError
from compasslib.stages.settings import Moorings

ROOT = Path(__file__).resolve().parents[2]
MOORING_FILE = "config/moorings/EG4.yaml"

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
    exclude: []                 # [{from: ..., to: ..., why: ...}]: known-bad windows, flagged 4, not used
    attributes: {serial_number: ...}
  deep:
    format: table
    files: raw/EG4/deep.csv
    depth: 120
    columns: {time: time_utc, depth: depth_m, east: u_cm_s, north: v_cm_s, scale: 0.01}
    direction_reference: magnetic   # magnetic | true; default magnetic for every format
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


def rows(table: str) -> list[tuple[str, str]]:
    """Split the rows of a table ``line -> place that the message names``."""
    parts = (row.rpartition(" -> ") for row in table.strip("\n").split("\n"))
    return [(line.replace(r"\n", "\n"), place) for line, _, place in parts]


def assert_refused(root: Path, place: str) -> None:
    """Assert that the one line names file and place, what was expected and found, and what to do."""
    said = message(root)
    assert re.fullmatch(rf"{re.escape(place.removesuffix(': '))}: expected .+, found .+; .+", said), said


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


def test_eight_keys_are_enough(cruise: Path) -> None:
    """The defaults stand in the JSON schemas, which a test below compares with the models."""
    write(cruise, "config/config.yaml", "{}")
    write(cruise, MOORING_FILE, SHORTEST)
    mooring = config.load_cruise(cruise).moorings["M1"]
    assert (mooring.start_s, mooring.end_s, mooring.affected) == (1188864000.0, 1223078400.0, ("top",))
    assert (mooring.reference, mooring.fit.method, mooring.declination) == ((), "exact", "auto")


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
    assert columns and columns.model_dump(exclude_none=True) == {"date": "d", "clock": "c", "value": "A"}


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
    assert (own.diagnose.enabled, own.diagnose.apply, own.diagnose.min_effect_deg) == (False, False, 2.0)
    assert (general.diagnose.enabled, general.diagnose.apply, general.diagnose.min_effect_deg) == (True, False, 2.0)


@pytest.mark.parametrize(("given", "drawn"), [("[]", ()), ("[pdf]", ("png", "pdf")), ("[png]", ("png",))])
def test_figures_are_drawn_in_the_formats_that_are_listed(cruise: Path, given: str, drawn: tuple[str, ...]) -> None:
    """Of an empty list none; otherwise PNG too, which the report shows."""
    write(cruise, "config/config.yaml", f"figures: {{formats: {given}}}\n")
    assert config.load_cruise(cruise).options.figures.formats == drawn


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


DATES = """\
2007-09-04 -> 0
'2007-09-04' -> 0
2007-09-04T06:00:00Z -> 6
2007-09-04 06:00:00 -> 6
2007-09-04T06:00:00.000 UTC -> 6
2007-09-04T06:00:00+02:00 -> 4
2007-09-04T06:00:00-0330 -> 9.5
"2007-09-04T06:00Z" -> 6
"""


@pytest.mark.parametrize(("written", "hours"), rows(DATES))
def test_dates_are_read_in_every_form(cruise: Path, written: str, hours: str) -> None:
    write(cruise, MOORING_FILE, with_line(f"start: {written}"))
    assert config.load_cruise(cruise).moorings["EG4"].start_s == 1188864000.0 + 3600 * float(hours)


@pytest.mark.parametrize(("written", "value"), rows("1e-2 -> 0.01\n.01 -> 0.01\n+1. -> 1\n2.5E-1 -> 0.25\n3 -> 3"))
def test_numbers_are_read_in_every_form(cruise: Path, written: str, value: str) -> None:
    write(cruise, MOORING_FILE, edited(MOORING, "scale: 0.01", f"scale: {written}"))
    columns = config.load_cruise(cruise).moorings["EG4"].instruments["deep"].columns
    assert columns and columns.scale == float(value)


def test_attributes_that_look_like_other_types_stay_text(cruise: Path) -> None:
    texts = "{a: 2007-09-04, b: 0123, c: 12:30, d: no, e: 1e5, f: 123456789012345678901, g: 0x1F, h: .inf, i: 1_0}"
    write(cruise, MOORING_FILE, SHORTEST + f"attributes: {texts}\n")
    given = config.load_cruise(cruise).moorings["M1"].attributes
    assert list(given.values()) == re.findall(r": ([^,}]+)", texts)


def test_moorings_may_be_a_list_or_empty(cruise: Path) -> None:
    write(cruise, "other/Z.yaml", edited(MOORING, "name: EG4", "name: Z"))
    write(cruise, "config/config.yaml", f"moorings: [other/Z.yaml, {MOORING_FILE}]\n")
    assert list(config.load_cruise(cruise).moorings) == ["EG4", "Z"]
    write(cruise, "config/config.yaml", "moorings: []\n")
    assert config.load_cruise(cruise).moorings == {}


def test_demonstration_may_name_files_simulated_later(cruise: Path) -> None:
    write(cruise, "config/config.yaml", "demonstration: true\nseed: 7\n")
    write(cruise, MOORING_FILE, SHORTEST.replace("top.000", "later.000"))
    loaded = config.load_cruise(cruise)
    assert loaded.options.seed == 7
    assert loaded.moorings["M1"].instruments["top"].files == ("raw/EG4/later.000",)
    write(cruise, MOORING_FILE, SHORTEST.replace("top.000", "*.000"))
    assert "instruments.top.files: expected plain paths" in message(cruise)


def test_fit_by_calibration_requires_its_file_and_place(cruise: Path) -> None:
    write(cruise, MOORING_FILE, with_line("fit: {method: calibration, name: aqd}"))
    assert "fit.name: expected the file config/calibrations/aqd.yaml, found none" in message(cruise)
    platform = "kind: platform\nfile: raw/EG4/deep.csv\n"
    write(cruise, "config/calibrations/aqd.yaml", platform)
    assert "fit.name: expected latitude, longitude and date in config/calibrations/aqd.yaml" in message(cruise)
    write(cruise, "config/calibrations/aqd.yaml", platform + "latitude: 48.4\nlongitude: -4.5\ndate: 2022-09-29\n")
    assert config.load_cruise(cruise).moorings["EG4"].fit.name == ("aqd",)


def test_configuration_of_a_real_cruise_is_read() -> None:
    if not (folder := ROOT.parent / "shared/data/cruise_eh2").is_dir():
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
    options = "product: {daily: true, grid: {minutes: 60, step_m: auto}, flags: 1}\n"
    write(cruise, "config/config.yaml", CONFIG + options)
    write(cruise, MOORING_FILE, with_line("product: {grid: {step_m: 4, from_m: 20}}"))
    loaded = config.load_cruise(cruise)
    product = loaded.options.product
    assert product.grid and (product.grid.minutes, product.flags, product.daily) == (60.0, (1,), True)
    made = loaded.moorings["EG4"].product
    assert made.grid and (made.grid.step_m, made.grid.from_m, made.grid.minutes) == (4.0, 20.0, None)
    assert made.daily and made.flags == (1,)
    write(cruise, MOORING_FILE, with_line("product: {grid: false}"))
    assert config.load_cruise(cruise).moorings["EG4"].product.grid is None


# --- invalid input, in one line -------------------------------------------------------------------------------------

BAD_LINES = r"""
product: {grid: {from_m: 90, to_m: 80}} -> product.grid.to_m
product: {flags: [1, 4]} -> product.flags
latitude: 95.3 -> latitude
latitude: 65,3 -> latitude
latitude: -> latitude
start: 04.09.2007 -> start
end: 2006-10-04 -> end
declination: IGRF -> declination
name: ../EG4 -> name
name: M1;touch x -> name
name: RO-Crate-metadata.json -> name
reference: bottom -> reference
reference: top -> reference
latitud: 65 -> latitud
fit: {method: exakt} -> fit.method
fit: exact -> fit
fit: {method: coefficients} -> fit.coefficients
fit: {method: coefficients, coefficients: {A: 1}} -> fit.coefficients
fit: {method: exact, model: exact} -> fit.model
fit: {method: coefficients, coefficients: {A: 0, B: 0, C: 0, D: 0, E: 0}, covariance: [[-1,0,0,0,0],[0,1,0,0,0],[0,0,1,0,0],[0,0,0,1,0],[0,0,0,0,1]]} -> fit.covariance
fit: {method: calibration} -> fit.name
attributes: {ship: [a, b]} -> attributes.ship
attributes: {Software_Version: 9} -> attributes.Software_Version
attributes: {a b: c} -> attributes
covariates: {obs: {format: iaga2002, files: raw/obs/*.hor}} -> covariates.obs.files
site: denmark_strait -> site
covariates: {echo: {format: table, files: raw/obs/lrv1.min, columns: {time: t, value: x}}} -> covariates.echo
covariates: {obs: {format: table, files: raw/obs/lrv1.min}} -> covariates.obs.columns
covariates: {obs: {format: iaga2002, files: raw/obs/*.min, unit: nT}} -> covariates.obs.unit
    delimiter: ';' -> instruments.top.delimiter
    time_format: '%H:%M' -> instruments.top.time_format
    timezone: CET -> instruments.top.timezone
    missing: [[1]] -> instruments.top.missing
    format: tabel -> instruments.top.format
    files: raw/EG4/no.000 -> instruments.top.files
    files: raw/EG4 -> instruments.top.files
    files: [] -> instruments.top.files
    files: /etc/passwd -> instruments.top.files
    files: raw/../../top.000 -> instruments.top.files
    files: C:\top.000 -> instruments.top.files
    files: 7 -> instruments.top.files
    depth: 1000 -> instruments.top.depth
    sphere: false -> instruments.top.sphere
    sphere_distance_m: [0.6, 0.4] -> instruments.top.sphere_distance_m
    heading: 3 -> instruments.top.heading
    sound_speed: {salinity: 43} -> instruments.top.sound_speed
    declination_applied: {heading: 3} -> instruments.top.declination_applied
    format: netcdf\n    columns: {x: s, y: d} -> instruments.top.columns.x
    exclude: {from: 2007-10-01, to: 2007-10-02} -> instruments.top.exclude
    exclude: [2007-10-01] -> instruments.top.exclude[0]
    exclude: [{from: 2007-10-01}] -> instruments.top.exclude[0].to
    exclude: [{from: 2009-01-01, to: 2009-01-02}] -> instruments.top.exclude[0]
    exclude: [{from: 2007-10-02, to: 2007-10-01}] -> instruments.top.exclude[0].to
    flags_by_hand: [{from: 2007-10-01, to: 2007-10-02, flag: 9, who: P, why: w}] -> instruments.top.flags_by_hand[0].flag
    depth_from: nobody -> instruments.top.depth_from
    direction_reference: grid -> instruments.deep.direction_reference
"""

BAD_COLUMNS = r"""
{depth: d, east: u, north: v} -> columns.time
{date: d, east: u, north: v} -> columns.time
{time: t, date: d, clock: c, east: u, north: v} -> columns.time
{time: t, east: u} -> columns
{time: t, east: u, north: u} -> columns.north
{time: t, x: u, y: v} -> columns
{time: t} -> columns
{time: t, east: 0, north: v} -> columns.east
{time: [t], east: u, north: v} -> columns.time
{time: t, east: u, north: v, tilt: w} -> columns.tilt
[time_utc, u, v] -> columns
"""

BAD_FILES = [
    ("", ""),
    ("- name: EG4\n", ""),
    ("EG4", ""),
    ("name: EG4\nname: EG5\n", "line 2, column 1"),
    ("a: *x\n", "line 1, column 4"),
    ("a: !!python/object:os.system x\n", "line 1, column 4"),
    ("? [a, b]\n: 1\n", "line 1, column 3"),
    ("fit:\n\tmethod: exact\n", "line 2, column 1"),
    ("name: 'EG4\n", "line 2, column 1"),
    ("name: EG4\n---\nname: EG5\n", "line 2, column 1"),
    ("a:\n    b: 1\n  c: 2\n", "line 3, column 3"),
    ("name: EG4\nship: \x07\n", "line 2"),
    (b"name: Gr\xf6nland\n", ""),
    ("name: EG4\n".encode("utf-16"), ""),
    ("<<: {name: EG4}\n", "<<"),
]

BAD_OPTIONS = r"""
demonstration: 1 -> demonstration
figures: {formats: [[png]]} -> figures.formats
supersedes: [a.zip, b.zip] -> supersedes
seed: 1.5 -> seed
overlap: {max_minuts: 20} -> overlap.max_minuts
fit: {method: calibration, name: aqd} -> fit.method
moorings: config/mooring -> moorings
moorings: [config/moorings/X.yaml] -> moorings
moorings: {a: b} -> moorings
moorings: ../other -> moorings
"""


@pytest.mark.parametrize(("line", "place"), rows(BAD_LINES))
def test_invalid_line_in_a_mooring_file_is_reported(cruise: Path, line: str, place: str) -> None:
    write(cruise, MOORING_FILE, with_line(line))
    assert_refused(cruise, f"{MOORING_FILE}: {place}")


def test_raw_file_name_with_braces_is_refused(cruise: Path) -> None:
    write(cruise, "raw/obs/{lrv3}.min", "")
    assert "files: expected a path without braces, found 'raw/obs/{lrv3}.min'; rename the file" in message(cruise)


@pytest.mark.parametrize(("columns", "place"), rows(BAD_COLUMNS))
def test_invalid_columns_are_reported(cruise: Path, columns: str, place: str) -> None:
    write(cruise, MOORING_FILE, edited(MOORING, COLUMNS, columns))
    assert_refused(cruise, f"{MOORING_FILE}: instruments.deep.{place}")


@pytest.mark.parametrize(("content", "place"), BAD_FILES, ids=[repr(content[:30]) for content, _ in BAD_FILES])
def test_invalid_yaml_file_is_refused(cruise: Path, content: str | bytes, place: str) -> None:
    write(cruise, MOORING_FILE, content)
    assert_refused(cruise, f"{MOORING_FILE}: {place}")


@pytest.mark.parametrize(("line", "place"), rows(BAD_OPTIONS))
def test_invalid_cruise_option_is_reported(cruise: Path, line: str, place: str) -> None:
    write(cruise, "config/config.yaml", line + "\n")
    assert_refused(cruise, f"config/config.yaml: {place}")


BAD_INSTRUMENTS = r"""
format: pd12, -> top.orientation
format: pd12, orientation: up, bin_size: 16, -> top.first_bin
format: table, columns: {time: t, east: u, north: v}, -> top.columns
format: pd0, columns: {time: t}, -> top.columns
format: netcdf, sound_speed: keep, -> top.sound_speed
"""


@pytest.mark.parametrize(("keys", "place"), rows(BAD_INSTRUMENTS))
def test_invalid_keys_of_a_format_are_reported(cruise: Path, keys: str, place: str) -> None:
    write(cruise, MOORING_FILE, SHORTEST.replace("format: pd0,", keys))
    assert_refused(cruise, f"{MOORING_FILE}: instruments.{place}")


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
    assert message(tmp_path).startswith(f"config/config.yaml: expected this file in {tmp_path}, found none; write one")


@pytest.mark.parametrize(("name", "also"), [("EG4", ""), ("eg4", " in other letters")])
def test_duplicate_mooring_name_is_refused(cruise: Path, name: str, also: str) -> None:
    """M1 and m1 are one folder on some file systems."""
    write(cruise, "config/moorings/copy.yaml", edited(MOORING, "name: EG4", f"name: {name}"))
    assert (
        f"copy.yaml: name: expected a name of its own, found '{name}', which {MOORING_FILE} has already{also};"
        in message(cruise)
    )


SECOND = SHORTEST.replace("name: M1", "name: M2").replace("top.000}", "top.000, compass: wh1}")


BAD_COMPASSES = [
    (SECOND, "instruments.top.compass: expected a compass that is in one place from 2007-09-04T00:00:00Z to 2008-10-04T00:00:00Z, found wh1 at EG4 (top), "),
    (SECOND.replace("M2", "aqd"), "instruments.top.compass: expected another name of the mooring than of the compass's calibration"),
    (SECOND + "fit: {method: calibration, name: aqd}\n", "fit.method: expected another method beside compass: wh1"),
]  # fmt: skip


@pytest.mark.parametrize(("second", "expected"), BAD_COMPASSES)
def test_conflicting_uses_of_a_compass_are_refused(cruise: Path, second: str, expected: str) -> None:
    write(cruise, MOORING_FILE, MOORING.replace("    depth: 100 ", "    compass: wh1\n    depth: 100 "))
    write(cruise, "config/moorings/M2.yaml", second)
    place = "latitude: 1\nlongitude: 1\ndate: 2001-01-01\n"
    write(cruise, "config/calibrations/aqd.yaml", f"kind: platform\nfile: raw/EG4/top.000\ncompass: wh1\n{place}")
    assert message(cruise).startswith(f"config/moorings/M2.yaml: {expected}")
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
    made = config.json_schemas()
    assert {path.name: path.read_text() for path in (ROOT / config.SCHEMAS).iterdir()} == made, "run: make schema"
    folders = [ROOT / "config", *ROOT.glob("examples/*/config")]
    kinds = {"config": "config.yaml", "mooring": "moorings/*.yaml", "calibration": "calibrations/*.yaml"}
    for kind, pattern in kinds.items():
        check = jsonschema.Draft202012Validator(json.loads(made[f"{kind}.json"]))
        for path in (path for folder in folders for path in folder.glob(pattern)):
            check.validate(content := json.loads(json.dumps(yaml.safe_load(path.read_text()), default=str)))
            assert not check.is_valid(content | {"lattitude": 1}), path
    assert check.is_valid(content) and not check.is_valid(content | {"kind": "another"})
