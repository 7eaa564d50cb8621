"""Would catch a file of ../shared/data/wild, or one like it, that is not read as its words say or refused.

Reading settles two components to better than half of their last digit, 5e-5 m/s; angles of swings to 0.3 degrees, as
their courses are rounded to 0.1 degrees and their compass to 0.1 degrees over 180 headings.
"""

from pathlib import Path

import netCDF4
import numpy as np
import pytest

from compasslib import readers
from compasslib.calibrations import observatory, swing
from compasslib.cli import main
from compasslib.config.schema import Instrument
from compasslib.errors import InputError
from compasslib.readers import iaga2002
from tests.world.pd0_encoder import ensemble
from tests.world.sea import real

UP = {"orientation": "up", "direction_reference": "magnetic"}
TRUE_UP = UP | {"direction_reference": "true"}
NAMED = {"bad": ["compass_error", "side_lobe", "sensor_broken", "2"]}
UNKNOWN = "UCUR_QC: the meaning of the flags low_percent_good (8 samples), side_lobe"
CM_S = {"time": "time", "east": "east (cm/s)", "north": "north (cm/s)", "heading": "heading (deg)"}
ODV = {"time": "time_ISO8601", "east": "EWCT [Metres per second]", "north": "NSCT [Metres per second]"}
BY_HAND = {"time": "time", "east": "u", "north": "v"}
SIX = {"columns": {"time": ["Year", "Month", "Day", "Hour", "Minute", "Second"], "east": "East (m/s)",
       "north": "North (m/s)"}}  # fmt: skip
FIRST = (0.0320, 0.0161)  # E[0], N[0] of the series that most files of the second table hold
# File, format, settings, words of the refusal or of a warning, number of velocities with each flag, E[0] and N[0].
FILES = [
    ("netcdf_flag_words_good.nc", "netcdf", TRUE_UP, UNKNOWN, {0: 8, 1: 8, 3: 32}, None),
    ("netcdf_flag_words_good.nc", "netcdf", TRUE_UP | {"flags": NAMED}, "", {0: 8, 1: 8, 4: 32}, None),
    ("netcdf_flags_per_time.nc", "netcdf", TRUE_UP, "", {1: 72, 4: 72}, None),
    ("netcdf_seadatanet_flag0.nc", "netcdf", TRUE_UP, "", {0: 48}, None),
    ("netcdf_scalar_ancillary.nc", "netcdf", TRUE_UP, "", {1: 48}, None),
    ("netcdf_scalar_ancillary.nc", "netcdf", UP, "-17.37 degrees of declination were taken out", {1: 48}, None),
    ("netcdf_time_offset_one_digit.nc", "netcdf", TRUE_UP, "", None, None),
    ("imos_aggregated_rows.nc", "netcdf", TRUE_UP, "series of one instrument, found 3 in one", {}, None),
    ("mhkit_ea45.nc", "netcdf", UP, "give heading_alignment", {}, None),
    ("mhkit_ea45.nc", "netcdf", {"heading_alignment": 45.0}, "45 degrees was added", {1: 1024, 9: 96}, None),
    ("mhkit_vel_avg.nc", "netcdf", {}, "", {1: 144}, None),
    ("sig100_raw_avg_8.ad2cp", "nortek", {}, "", None, None),
    ("h_awac_two_beams.wpr", "nortek", {}, "expected 3 slanted beams, found 2 beams, which are level", {}, None),
    ("pd0_hour_means.000", "pd0", {}, "the mean of 3600 s from its time on: its middle is 1800 s", None, None),
    ("acm_sio_escapes.dat", "mmp_acm", {"pressure_files": ()}, "", None, None),
    ("netcdf_xyz_frame.nc", "netcdf", TRUE_UP, "turned to east and north by the heading alone", {1: 100}, FIRST),
    ("netcdf_xyz_frame.nc", "netcdf", {}, "write orientation: up or down", {}, None),
    ("table_unit_in_header_cm_s.csv", "table", {"columns": CM_S}, "multiplied by 0.01", {1: 149}, FIRST),
    ("table_unit_in_header_cm_s.csv", "table", {"columns": CM_S | {"scale": 1.0}}, "correct scale", {}, None),
    ("pd0_beam_angle_byte_3.000", "pd0", {}, "28 of 28 ensembles", {1: 330, 9: 6}, (0.3257, -0.1634)),
    ("netcdf_north_not_said.nc", "netcdf", UP, "does not say which north", {1: 40}, FIRST),
    ("netcdf_flag_meanings_list.nc", "netcdf", TRUE_UP, "", {1: 20, 4: 20}, FIRST),
    ("netcdf_flag_meanings_list.nc", "netcdf", TRUE_UP | {"flags": {"bad": ["good value"]}}, "", {4: 40}, None),
    ("netcdf_heading_cdegrees.nc", "netcdf", TRUE_UP, "", {1: 100}, FIRST),
    ("netcdf_speed_direction.nc", "netcdf", TRUE_UP, "", {1: 100}, FIRST),
    ("netcdf_speed_direction.nc", "netcdf", UP, "found true north by HCDT's reference", {}, None),
    ("netcdf_oceancontour_groups.nc", "netcdf", TRUE_UP, "", {1: 80}, FIRST),
    ("netcdf_oceancontour_groups.nc", "ocean_contour", TRUE_UP, "", {1: 80}, FIRST),
    ("netcdf_oceancontour_groups.nc", "ocean_contour", UP, "-17.00 degrees of declination", {1: 80}, (0.0353, 0.0060)),
    ("netcdf_oceancontour_groups.nc", "ocean_contour", {}, "write orientation: up or down", {}, None),
    ("table_six_time_columns.csv", "table", SIX, "", {1: 149}, FIRST),
    ("table_six_time_columns.csv", "table", {"columns": SIX["columns"] | {"time": "Year"}},
     "list the columns of the time: time: [YEAR, MONTH", {}, None),
    ("table_numpy_hash_header.csv", "table", {"columns": BY_HAND}, "", {1: 119}, FIRST),
    ("aquadopp_ascii.dat", "nortek", {}, "Nortek's conversion, which has no header; give its .hdr too", {}, None),
    ("aquadopp_ascii.dat", "table", {"columns": BY_HAND}, "Nortek's conversion, which has no header", {}, None),
    ("aquadopp_ascii.dat", "table", {"columns": {"time": [3, 1, 2, 4, 5, 6], "east": 9, "north": 10}}, "", {1: 120},
     (0.032, 0.016)),
    ("odv_timeseries.txt", "odv", {}, "", {1: 70, 4: 70}, FIRST),
    ("odv_timeseries.txt", "table", {"columns": ODV}, "flags stand in QV:SEADATANET", {1: 140}, FIRST),
    ("aanderaa_rcm8_raw.Asc", "table", {"columns": BY_HAND}, "found raw counts of an Aanderaa logger", {}, None),
]  # fmt: skip


@pytest.mark.parametrize(("name", "form", "settings", "said", "flags", "first"), FILES)
def test_wild_file_is_read_as_its_words_say_or_refused(name, form, settings, said, flags, first):
    path, settings = real(f"wild/{name}"), UP | {"orientation": None} | settings
    if flags == {}:
        with pytest.raises(InputError) as error:
            readers.read(form, [path], settings)
        assert said in str(error.value) and "\n" not in str(error.value)
        return
    record = readers.read(form, [path], settings)
    counted = zip(*np.unique(record.quality, return_counts=True), strict=True)
    assert flags is None or {int(flag): int(n) for flag, n in counted} == flags
    warnings = " ".join(record.warnings)
    assert said in warnings and ("not known" in warnings) == ("meaning" in said)
    if first:
        assert (record.east[0, 0], record.north[0, 0]) == pytest.approx(first, abs=5e-5)


def test_times_and_headings_of_wild_files():
    def read(name, form="netcdf", **settings):
        return readers.read(form, [real(f"wild/{name}")], UP | settings)

    assert np.isfinite(read("mhkit_vel_avg.nc").heading_deg).all()
    time = read("netcdf_time_offset_one_digit.nc", direction_reference="true").time_s[0]
    assert np.datetime64(int(time), "s") == np.datetime64("1992-10-08T21:15:42")
    assert read("netcdf_heading_cdegrees.nc", declination_applied=0.0).heading_deg[0] == pytest.approx(90.34)
    pings = read("sig100_raw_avg_8.ad2cp", "nortek", orientation=None)
    assert np.allclose(np.diff(pings.time_s), 1.0, atol=1e-3) and pings.warnings == ()
    scans = read("acm_sio_escapes.dat", "mmp_acm", pressure_files=())
    # Three profiles of 39, 42 and 36 scans by their frame lengths; the first scan of each is aliased and dropped.
    assert len(scans.time_s) == 38 + 41 + 35 and scans.counts["damaged_rows"] == 0
    assert np.abs(np.hypot(scans.east, scans.north)).max() < 0.2
    ends = scans.time_s[[0, -1]].astype("datetime64[s]")
    assert ends.astype(str).tolist() == ["2013-07-30T11:03:36", "2013-07-31T08:57:46"]


DRAFTS = [  # file, keys left to decide, words of the draft or of the line that leaves it out
    ("netcdf_north_not_said.nc", {"orientation", "direction_reference"}, ""),
    ("netcdf_xyz_frame.nc", {"orientation", "direction_reference"}, ""),
    ("mhkit_vel_avg.nc", set(), "direction_reference: magnetic  # as the files say"),
    ("netcdf_scalar_ancillary.nc", {"orientation"}, "-17.37, is taken out"),
    ("table_unit_in_header_cm_s.csv", {"direction_reference"}, "scale: 0.01"),
    ("table_numpy_hash_header.csv", {"direction_reference", "scale"}, "east: u"),
    ("seaguard_tab.txt", set(), "direction_reference: magnetic"),
    ("pd0_junk_before.000", {"declination_applied"}, "format: pd0"),
    ("swing_two_talkers.nmea", {"talker"}, "HC, AP send headings"),
    ("table_six_time_columns.csv", {"direction_reference"}, "time: [Year, Month, Day, Hour, Minute, Second]"),
    ("netcdf_speed_direction.nc", {"orientation"}, "direction_reference: 'true'  # as the files say"),
    ("netcdf_oceancontour_groups.nc", {"orientation"}, "format: ocean_contour"),
    ("aquadopp_ascii.dat", None, "give its .hdr too"),
    ("odv_timeseries.txt", {"direction_reference"}, "format: odv"),
    ("aanderaa_rcm8_raw.Asc", None, "raw counts of an Aanderaa logger; convert them"),
    ("nortek_pnors.nmea", None, "telemetry of a Nortek instrument"),
]


@pytest.mark.parametrize(("name", "open_keys", "said"), DRAFTS)
def test_init_asks_for_what_no_file_says(tmp_path, capsys, name, open_keys, said):
    failed = main(["init", str(real(f"wild/{name}")), "--into", str(tmp_path), "--name", "X"])
    drafted = [path.read_text() for path in tmp_path.glob("config/*/*.yaml")]
    assert said in "".join([*drafted, *capsys.readouterr()]) and bool(failed) == (open_keys is None)
    asked = {line.split(":")[0].strip() for text in drafted for line in text.splitlines() if ": DECIDE" in line}
    place = {"latitude", "longitude", "water_depth", "start", "end", "compromised", "depth"}
    assert asked - place == (open_keys or set())


def test_calibrations_of_wild_files():
    path = real("wild/swing_two_talkers.nmea")
    with pytest.raises(InputError, match=r"found those of AP \(180\) and HC \(180\); write talker: HC"):
        swing.calibrate([path], {"format": "nmea0183"})
    quick = {"format": "nmea0183", "max_turn_deg_s": 2.0}  # it turned by 1 degree a second, the compass by 1.2
    assert swing.calibrate([path], quick | {"talker": "HC"}).coefficients[1:3] == pytest.approx([-8, -4], abs=0.3)
    assert swing.calibrate([path], quick | {"talker": "AP"}).coefficients[1:3] == pytest.approx([0, 0], abs=0.3)
    found = swing.calibrate([real("wild/swing_hdg_holds_true.nmea")], {"format": "nmea0183"})
    assert "minus the declination of +10.7°" in found.warnings[0] and "declination: 0" in found.warnings[0]
    series = iaga2002.read([real("wild/iaga_variation_hdzf.min")])
    with pytest.raises(InputError, match="a variation about zero: the baseline is missing"):
        observatory.check_field(series, (series.latitude, series.longitude))


def netcdf(path: Path, first: dict, second: dict, of_file=(), names=("u", "v"), **series) -> Path:
    """Write a point meter whose components are 1 and 0 m/s under a heading of 30 degrees."""
    with netCDF4.Dataset(path, "w") as nc:
        nc.setncatts(dict(of_file))
        nc.createDimension("time", 4)
        columns = {
            "time": (3600.0 * np.arange(4), "seconds since 2019-01-01"),
            "heading": (np.full(4, 30.0), "degrees"),
        }
        columns |= {names[0]: (np.ones(4), "m/s"), names[1]: (np.zeros(4), "m/s")} | series
        for name, (values, unit) in columns.items():
            nc.createVariable(name, "f8", ("time",))[:] = values
            nc[name].setncatts({"units": unit} | {names[0]: first, names[1]: second}.get(name, {}))
    return path


def named(first: str, second: str, attribute: str = "long_name") -> tuple[dict, dict]:
    return {attribute: first}, {attribute: second}


EAST = ("eastward velocity", "northward velocity")
XYZ = {"coordinate_system": "XYZ"}
FRAMES = [  # attributes of both components, of the file, E and N; None where it is refused
    (named(*EAST), {}, (1.0, 0.0)),
    (named(*EAST), XYZ, (1.0, 0.0)),  # what the instrument was set to, as stglib keeps it
    (({}, {}), {"coordinate_system": "WGS84"}, (1.0, 0.0)),
    (named("Velocity (Beam1|X|East)", "Velocity (Beam2|Y|North)"), {"coordinate_system": "ENU"}, (1.0, 0.0)),
    (named("gridded eastward velocity", "gridded northward velocity"), {}, (1.0, 0.0)),
    (({"long_name": "east", "comment": "from beam to earth; rotated by the declination"}, {}), {}, (1.0, 0.0)),
    (({}, {}), XYZ, (0.5, 0.866)),
    (named("XYZ", "XYZ", "coordinate_system"), {}, (0.5, 0.866)),
    (({}, {}), XYZ | {"instrument": "RDI Workhorse"}, None),
    (named("u along 36.5 degrees", "v along 126.5 degrees"), {}, (0.595, 0.804)),
    (named("positive towards 36.5 degrees", "positive towards 306.5 degrees"), {}, (0.595, 0.804)),
    (named("u along 36.5 degrees", "v across it"), {}, None),
    (named("velocity, 36.5 degrees counter-clockwise from east, along 53.5 degrees", "along 143.5 degrees"), {}, None),
    *((named(*pair), {}, None) for pair in (
        ("along-shore velocity", "cross-shore velocity"), ("X velocity, instrument frame", "Y velocity"),
        ("grid eastward velocity", "grid northward velocity"), ("barotropic grid_x", "barotropic grid_y"),
        ("velocity of beam 1", "velocity of beam 2"), ("velocity relative to ship, east", "north"),
        ("major axis velocity", "minor axis velocity"), ("rotated eastward velocity", "rotated northward velocity"),
        ("forward velocity", "starboard velocity"),
    )),
    (named("sea_water_x_velocity", "sea_water_y_velocity", "standard_name"), {}, None),
    (({"comment": "along-shore, 36.5 degrees from north"}, {}), {}, None),
    *((({}, {}), said, None) for said in (
        {"coordinate_system": "BEAM"}, {"coordinate_system": "instrument"}, {"coord_system": "ship"},
        {"rotation_angle": 36.5}, {"comment": "velocities rotated 36.5 degrees to along-shore"},
    )),
]  # fmt: skip


@pytest.mark.parametrize(("pair", "of_file", "expected"), FRAMES)
def test_frame_of_components_counts_by_its_words(tmp_path, pair, of_file, expected):
    path = netcdf(tmp_path / "a.nc", *pair, of_file)
    settings = UP | {"columns": {"east": "u", "north": "v"}}
    if expected is None:
        with pytest.raises(InputError, match="velocities: expected east and north, found") as error:
            readers.read("netcdf", [path], settings)
        assert "\n" not in str(error.value)
        return
    record = readers.read("netcdf", [path], settings)
    assert (record.east[0, 0], record.north[0, 0]) == pytest.approx(expected, abs=5e-4)


def test_components_of_the_instrument_are_levelled_and_flagged_by_their_heading(tmp_path):
    """Pitch 90: x points up and z, down for a compass that looks forward, backwards."""
    series = {"pitch": (np.full(4, 90.0), "degrees"), "w": (np.full(4, 0.5), "m/s")}
    series["heading"] = (np.array([0.0, 90.0, -999.0, 65535.0]), "degrees")
    record = readers.read("netcdf", [netcdf(tmp_path / "a.nc", {}, {}, XYZ, **series)], UP)
    assert record.east[:2, 0] == pytest.approx([0.0, -0.5], abs=1e-9)
    assert record.north[:2, 0] == pytest.approx([-0.5, 0.0], abs=1e-9)
    assert record.profiles["up"][:2, 0] == pytest.approx([1.0, 1.0])
    assert record.quality.ravel().tolist() == record.heading_quality.tolist() == [1, 1, 9, 9]
    assert "2 headings are no angles and count as missing" in " ".join(record.warnings)


@pytest.mark.parametrize(("unit", "raw"), [("radians", np.pi / 6), ("cdegrees", 3000.0), ("deci-degrees", 300.0)])
def test_headings_of_netcdf_are_converted_by_their_unit(tmp_path, unit, raw):
    path = netcdf(tmp_path / "a.nc", *named(*EAST), heading=(np.full(4, raw), unit))
    assert readers.read("netcdf", [path], UP).heading_deg == pytest.approx(np.full(4, 30.0))


TABLES = [  # headers of speed and direction, unit row, keys, factor to m/s or words of the refusal, direction, north
    ("s (cm/s)|d (deg true)", "", {}, 0.01, 90.0, "true"),
    ("s [Metres per second]|d", "", {}, 1.0, 90.0, "magnetic"),
    ("s|d", "mm s-1|deg M", {}, 0.001, 90.0, "magnetic"),
    ("s|d", "knots|°T", {}, 0.514444, 90.0, "true"),
    ("s_cm_s|d_rad", "", {}, 0.01, np.degrees(1.5), "magnetic"),
    ("s|d", "cm/s|radians", {"scale": 0.01}, 0.01, np.degrees(1.5), "magnetic"),
    ("s|d", "", {"scale": 0.001, "direction_reference": "true"}, 0.001, 90.0, "true"),
    ("s (cm/s)|d", "", {"scale": 1.0}, "found cm/s; correct scale", None, None),
    ("s|d", "cm/s|deg", {"scale": 1.0}, "found cm/s; correct scale", None, None),
    ("s|d (deg true)", "", {"direction_reference": "magnetic"}, "write direction_reference: 'true'", None, None),
    ("s|d", "m/s|deg magnetic", {"direction_reference": "true"}, "write direction_reference: 'magnetic'", None, None),
]


@pytest.mark.parametrize(("headers", "units", "keys", "factor", "direction", "north"), TABLES)
def test_unit_and_north_of_a_table_count(tmp_path, headers, units, keys, factor, direction, north):
    speed, towards = headers.split("|")
    row = f"2019-05-03,10,{1.5 if 'rad' in headers + units else 90}"
    rows = [f"t,{speed},{towards}", *[f"UTC,{units.replace('|', ',')}"] * bool(units), row]
    (tmp_path / "a.csv").write_text("\n".join([*rows, ""]))
    columns = {"time": "t", "speed": speed, "direction": towards, "scale": keys.get("scale")}
    settings = {"columns": columns, "direction_reference": keys.get("direction_reference")}
    if isinstance(factor, str):
        with pytest.raises(InputError) as error:
            readers.read("table", [tmp_path / "a.csv"], settings)
        assert factor in str(error.value)
        return
    record = readers.read("table", [tmp_path / "a.csv"], settings)
    assert np.hypot(record.east, record.north).item() == pytest.approx(10.0 * factor, rel=1e-5)
    assert np.degrees(np.arctan2(record.east, record.north)).item() % 360.0 == pytest.approx(direction)
    assert record.direction_reference == north
    assert ("multiplied" in " ".join(record.warnings)) == (factor != 1.0 and "scale" not in keys)


@pytest.mark.parametrize(("said", "found"), [({}, "true"), ({"direction_reference": "magnetic"}, "magnetic")])
def test_north_of_headers_stands_for_an_absent_key(said, found):
    columns = {"time": "t", "speed": "s", "direction": "d (deg true)"}
    settings = {"format": "table", "files": "raw/a.csv", "depth": 5, "columns": columns} | said
    assert Instrument.model_validate(settings).direction_reference == found  # the reader refuses the second


@pytest.mark.parametrize(
    ("bits", "byte", "angle", "said"), [(1, 20, 20, 0), (1, 3, 20, 1), (2, 20, 30, 1), (3, 25, 25, 0)]
)
def test_beam_angle_byte_counts_where_the_configuration_says_other(tmp_path, bits, byte, angle, said):
    data = b"".join(
        ensemble([[100, 200, 3, 2]] * 4, number=k + 1, fixed={"beam_angle": byte, "angle_bits": bits}) for k in range(9)
    )
    (tmp_path / "a.000").write_bytes(data)
    record = readers.read("pd0", [tmp_path / "a.000"], {})
    assert record.beam_angle_deg == angle
    assert sum("9 of 9 ensembles state another beam angle" in line for line in record.warnings) == said
