"""Would catch values lost on the way through a file, half-written files, a damaged file not told as one."""

import dataclasses
import json
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from compasslib import angles
from compasslib.archive import attributes as archive_attributes
from compasslib.archive import files, netcdf, variables
from compasslib.archive.attributes import Site
from compasslib.archive.files import read_json, write_json
from compasslib.errors import InputError
from compasslib.preparation.quality import MASKS
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_BAD, PROBABLY_GOOD, PROFILES, join_records, take
from tests.world.products import (
    PROCESSING,
    SITE,
    USUAL,
    make_pairs,
    make_product,
    make_record,
    measured,
    product_of,
    write,
)

CONTRACT = [
    *("TIME", "HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY", "DEVIATION", "DECLINATION"),
    *("UCUR", "VCUR", "UCUR_RECORDED", "VCUR_RECORDED", "DEPTH", "PITCH", "ROLL"),
]
OVERLAP = [
    *("TIME", "HEADING", "PITCH", "ROLL", "UPPER_UCUR", "UPPER_VCUR", "LOWER_UCUR", "LOWER_VCUR", "LOWER_HEADING"),
    *("REFERENCE_INDEX", "UPPER_DEPTH", "LOWER_DEPTH", "SEPARATION_MINUTES", "SEPARATION_METRES", "DECLINATION"),
]


def same(one: object, other: object, *, rtol: float = 0.0, atol: float = 0.0) -> None:
    for field in dataclasses.fields(one):  # type: ignore[arg-type]
        a, b = getattr(one, field.name), getattr(other, field.name)
        if not isinstance(a, np.ndarray):
            assert a == b, field.name
            continue
        assert a.dtype == b.dtype and a.shape == b.shape, field.name
        # Two-dimensional variables are stored as float32, with seven digits.
        loose = rtol if a.ndim == 2 and a.dtype.kind == "f" else 0.0
        np.testing.assert_allclose(b, a, rtol=loose, atol=atol if loose else 0.0, equal_nan=True, err_msg=field.name)


@pytest.fixture(scope="module")
def corrected_nc(tmp_path_factory):
    return write(tmp_path_factory.mktemp("archive") / "corrected.nc")


# ----------------------------------------------------------------------------------------------------------------- JSON
def test_json_keeps_order_rounds_and_writes_null_for_nonfinite(tmp_path):
    data = {
        "z": np.float64(1 / 3),
        "a": [np.nan, np.inf, -np.inf, 1e-300],
        "array": np.array([[1.0, np.nan], [2.0, 3.0]]),
        "numpy": (np.int8(4), np.bool_(True), np.float32(0.5)),
        "none": None,
        5: tmp_path.relative_to(tmp_path),
    }
    write_json(tmp_path / "new" / "a.json", data)
    text = (tmp_path / "new" / "a.json").read_text()
    assert text.endswith("}\n") and text.startswith('{\n "z": 0.3333333333,\n "a": [')
    back = read_json(tmp_path / "new" / "a.json")
    assert list(back) == ["z", "a", "array", "numpy", "none", "5"]
    assert back["a"] == [None, None, None, 1e-300] and back["array"] == [[1.0, None], [2.0, 3.0]]
    assert back["numpy"] == [4, True, 0.5] and back["none"] is None and back["5"] == "."
    write_json(tmp_path / "again.json", back)
    assert (tmp_path / "again.json").read_text() == text


@pytest.mark.parametrize("content", [b'{"a": 1', b"", b"\xff\xfe\x00", None])
def test_damaged_json_is_reported_in_one_line(tmp_path, content):
    path = tmp_path / "deviation.json"
    if content is not None:
        path.write_bytes(content)
    message = r"deviation\.json: expected a JSON file, found .*; run the cruise again, or restore it"
    with pytest.raises(InputError, match=message):
        read_json(path)


# ------------------------------------------------------------------------------------------------------- atomic writing
def test_failed_write_keeps_the_previous_file(tmp_path):
    write_json(tmp_path / "a.json", {"old": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"new": object()})
    assert read_json(tmp_path / "a.json") == {"old": 1}

    write(tmp_path / "a.nc")
    before = (tmp_path / "a.nc").read_bytes()
    short = dataclasses.replace(make_product(), deviation_deg=np.zeros(7))
    with pytest.raises((IndexError, ValueError)):
        write(tmp_path / "a.nc", short)
    with pytest.raises((IndexError, ValueError)):
        netcdf.write_pairs(tmp_path / "b.nc", dataclasses.replace(make_pairs(), roll_deg=np.zeros(7)))
    assert (tmp_path / "a.nc").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.json", "a.nc"]


@pytest.mark.parametrize("read", [netcdf.read_record, netcdf.read_pairs, netcdf.read_corrected])
@pytest.mark.parametrize("damage", ["absent", "text", "truncated", "another"])
def test_damaged_netcdf_is_reported_in_one_line(tmp_path, corrected_nc, read, damage):
    path = tmp_path / "damaged.nc"
    if damage == "text":
        path.write_text("TIME,HEADING\n")
    if damage == "truncated":
        path.write_bytes(corrected_nc.read_bytes()[:20000])
    if damage == "another":
        with netCDF4.Dataset(path, "w") as nc:
            nc.createDimension("TIME", 3)
    with pytest.raises(InputError, match=r"damaged\.nc: expected a whole netCDF file that this program wrote, found "):
        read(path)


@pytest.mark.parametrize("error", [ValueError, KeyError, AttributeError])
def test_programming_error_is_not_reported_as_damage(corrected_nc, error):
    with pytest.raises(error, match="a mistake"), files.open_netcdf(corrected_nc):
        raise error("a mistake")


# -------------------------------------------------------------------------------------------------------- round trips
@pytest.mark.parametrize(("n", "m"), [(200, 6), (0, 6), (5, 0)])
def test_record_round_trip(tmp_path, n, m):
    record = make_record(n, m, looks_up=np.bool_(False), direction_reference="true")
    netcdf.write_record(tmp_path / "r.nc", record)
    back = netcdf.read_record(tmp_path / "r.nc")
    same(record, take(back, slice(None)), rtol=2.0**-24)
    np.testing.assert_array_equal(take(back, np.arange(n)[::3]).east, np.asarray(back.east)[::3])
    # A second round trip is exact.
    netcdf.write_record(tmp_path / "r2.nc", back)
    same(take(back, slice(None)), take(netcdf.read_record(tmp_path / "r2.nc"), slice(None)))


@pytest.mark.parametrize(
    ("biases", "expected"),
    [
        ({}, {"r": 0.0}),
        ({"heading_bias_deg": 3.0}, {"r": 3.0}),
        ({"heading_bias_deg": 3.0, "velocity_bias_deg": 0.0}, {"r (headings)": 3.0, "r (velocities)": 0.0}),
    ],
)
def test_heading_and_velocity_declinations_are_stored_separately(tmp_path, biases, expected):
    netcdf.write_record(tmp_path / "r.nc", make_record(**biases))
    assert netcdf.read_applied_declinations([tmp_path / "r.nc"]) == expected


def test_extra_channels_round_trip(tmp_path):
    turbidity = np.append(np.arange(199.0), np.nan)
    record = make_record(channels={"turbidity": turbidity}, channel_units={"turbidity": "NTU"})
    netcdf.write_record(tmp_path / "r.nc", record)
    back = netcdf.read_record(tmp_path / "r.nc")
    assert back.channel_units == {"turbidity": "NTU"} and list(back.channels) == ["turbidity"]
    np.testing.assert_array_equal(back.channels["turbidity"], turbidity)
    np.testing.assert_array_equal(take(back, slice(198, None)).channels["turbidity"], [198.0, np.nan])


def test_profile_variables_round_trip_and_can_be_sliced(tmp_path):
    record = make_record(**measured())
    few = record.profiles["echo"].astype(np.int16)
    few[3] = -1  # missing, as where an ensemble lacks the block
    record = dataclasses.replace(record, profiles={**record.profiles, "echo": few})
    netcdf.write_record(tmp_path / "r.nc", record)
    assert netcdf.read_record(tmp_path / "r.nc").profiles == {}  # large, and needed by few stages
    back = dataclasses.replace(record, profiles=netcdf.read_profiles(tmp_path / "r.nc"))
    some = take(back, slice(2, 7))
    assert list(some.profiles) == list(PROFILES)
    for name, values in record.profiles.items():
        np.testing.assert_array_equal(some.profiles[name], values[2:7], err_msg=name)
        assert some.profiles[name].dtype.kind == values.dtype.kind


def test_joined_records_keep_only_common_profiles():
    one, other = make_record(5, **measured(5)), make_record(7, **measured(7), time_s=1.2e9 + np.arange(7.0))
    less = {name: values for name, values in other.profiles.items() if name != "echo"}
    both = join_records([dataclasses.replace(other, profiles=less), one])
    assert sorted(both.profiles) == ["correlation", "error_velocity", "percent_good", "up"]
    np.testing.assert_array_equal(both.profiles["up"], np.concatenate([one.profiles["up"], less["up"]]))


@pytest.mark.parametrize("n", [50, 0])
def test_pairs_round_trip(tmp_path, n):
    pairs = make_pairs(n)
    netcdf.write_pairs(tmp_path / "overlap.nc", pairs, attributes={"history": "made"})
    same(pairs, netcdf.read_pairs(tmp_path / "overlap.nc"))
    with netCDF4.Dataset(tmp_path / "overlap.nc") as nc:
        assert sorted(nc.variables) == sorted(OVERLAP) and nc.history == "made"
        np.testing.assert_array_equal(nc["SEPARATION_METRES"][:], pairs.lower_depth_m - pairs.upper_depth_m)


@pytest.mark.parametrize("looks_up", [True, False])
@pytest.mark.parametrize(("n", "m"), [(200, 6), (1, 1)])
def test_product_round_trip(tmp_path, n, m, looks_up):
    product = make_product(n, m, looks_up=looks_up)
    back = netcdf.read_corrected(write(tmp_path / "c.nc", product))
    same(dataclasses.replace(product, record=back.record), back, rtol=1e-7)
    failed = np.where(product.heading_corrected_quality >= PROBABLY_BAD, MASKS["heading"], 0)
    expected = dataclasses.replace(
        product.record,
        east=product.east_recorded,
        north=product.north_recorded,
        supply_voltage=np.full(n, np.nan),
        direction_reference="true",
        beam_angle_deg=0.0,
        counts={},
        warnings=(),
        tests=np.repeat(failed[:, None], m, axis=1),
    )
    # Ranges are recovered as differences of float32 depths of up to 150 m.
    same(expected, back.record, rtol=1e-7, atol=1e-5)


# -------------------------------------------------------------------------------------------------------- specification
def test_product_has_the_specified_names_and_dimensions(corrected_nc):
    with netCDF4.Dataset(corrected_nc) as nc:
        assert {*CONTRACT, *(f"{name}_QC" for name in CONTRACT if name != "TIME")} <= set(nc.variables)
        assert nc["UCUR"].dimensions == nc["DEPTH"].dimensions == ("TIME", "BIN")
        assert nc["HEADING"].dimensions == ("TIME",)


def test_product_contains_the_measured_variables_only(tmp_path):
    product = make_product(**measured())
    record, told = product.record, PROCESSING | {"declination_source": "IGRF"}
    netcdf.write_corrected(tmp_path / "c.nc", product, site=SITE, attributes=USUAL, processing=told)
    with netCDF4.Dataset(tmp_path / "c.nc") as nc:
        for key, name in variables.PROFILES.items():
            values = nc[name][:].filled(np.nan) if nc[name].dtype.kind == "f" else nc[name][:]
            expected = record.profiles[key]
            np.testing.assert_array_equal(np.moveaxis(values, 0, 2) if values.ndim == 3 else values, expected)
        assert nc["ECHO_INTENSITY"].dimensions == ("BEAM", "TIME", "BIN") and nc["WCUR"].dimensions == ("TIME", "BIN")
        assert (nc["ERROR_VELOCITY_QC"][::5, 0] == MISSING).all() and nc["PERCENT_GOOD"].recorded_in == "earth"
        assert nc["UCUR_RECORDED"].sound_speed == nc["WCUR"].sound_speed == "kept"
        np.testing.assert_array_equal(nc["WCUR_QC"][:], record.quality)
        np.testing.assert_array_equal(nc["PRES"][:], record.pressure_dbar)
        left = angles.difference(nc["HEADING_CORRECTED"][:] + nc["DECLINATION"][:], nc["HEADING_TRUE"][:])
        assert np.abs(left).max() < 1e-9 and (nc["HEADING_TRUE_QC"][:] == nc["HEADING_CORRECTED_QC"][:]).all()
        for name in (name for name, entry in variables.CORRECTED.items() if entry.by_declination):
            assert nc[name].declination_model.startswith("IGRF-14")
            assert nc[name].declination_degrees.tolist() == [-17.5] * 2
            assert nc[name].declination_date == "2007-09-05T13:46:40Z/2007-09-08T08:06:40Z"
    with netCDF4.Dataset(write(tmp_path / "without.nc")) as nc:
        measured_only = {"PRES", *variables.PROFILES.values()}
        assert {*variables.CORRECTED} - {*nc.variables} == measured_only and "BEAM" not in nc.variables


def test_product_page_lists_every_variable():
    page = (Path(__file__).resolve().parents[2] / "docs/reference/product.md").read_text()
    for name, variable in variables.CORRECTED.items():
        assert f"| `{name}` | {', '.join(variable.dimensions) or '-'} | {variable.units or '-'} |" in page


def test_headings_stay_below_360_and_differ_by_the_deviation(tmp_path):
    nearly = np.array([359.9999999, 360.0, np.nextafter(360.0, 0.0), 0.0, 359.99999999999])
    product = make_product(5, 1, uncorrectable=0, heading_deg=nearly)
    with netCDF4.Dataset(write(tmp_path / "c.nc", product)) as nc:
        for name in ("HEADING", "HEADING_CORRECTED"):
            assert nc[name][:].min() >= 0.0 and nc[name][:].max() < 360.0
        left = angles.difference(nc["HEADING_CORRECTED"][:] - nc["HEADING"][:], nc["DEVIATION"][:])
    assert np.abs(left).max() < 0.001  # degrees, the specified tolerance


def test_flags_mark_missing_out_of_range_and_nominal_values(tmp_path):
    product = make_product(6, 1, uncorrectable=1, depth_m=np.full(6, 100.0))
    product.record.pitch_deg[1], product.record.roll_deg[2], product.record.heading_deg[3] = np.nan, 400.0, np.nan
    product.heading_corrected_deg[4], product.heading_corrected_quality[4] = np.nan, GOOD
    with netCDF4.Dataset(write(tmp_path / "c.nc", product)) as nc:
        assert nc["PITCH_QC"][:3].tolist() == [PROBABLY_GOOD, MISSING, PROBABLY_GOOD]
        assert nc["ROLL_QC"][:3].tolist() == [PROBABLY_GOOD, PROBABLY_GOOD, BAD]
        assert nc["HEADING_QC"][2:4].tolist() == [GOOD, MISSING]
        assert nc["HEADING_CORRECTED_QC"][:].tolist() == [BAD, GOOD, GOOD, GOOD, BAD, GOOD]
        for name in ("DECLINATION", "INSTRUMENT_DEPTH", "DEPTH"):
            assert (nc[f"{name}_QC"][:] == variables.NOMINAL).all()


@pytest.mark.parametrize(("looks_up", "depth_m"), [(True, 30.0), (False, 870.0)])  # in water of 894 m
def test_bins_outside_the_water_are_flagged_and_left_out_of_the_vertical_range(tmp_path, looks_up, depth_m):
    record = make_record(6, 6, looks_up=looks_up, depth_m=np.full(6, depth_m))
    product = product_of(record, np.zeros(6))
    with netCDF4.Dataset(write(tmp_path / "c.nc", product, site=dataclasses.replace(SITE, water_depth_m=894.0))) as nc:
        assert nc["DEPTH_QC"][0].tolist() == [variables.NOMINAL] * 3 + [BAD] * 3
        assert (nc["UCUR_QC"][0] == product.velocity_quality[0]).all()
        ends = nc.geospatial_vertical_min, nc.geospatial_vertical_max
    assert ends == ((6.0, 22.0) if looks_up else (878.0, 894.0))


def test_time_is_precise_to_ten_microseconds(tmp_path):
    record = make_record(4, 1, time_s=np.array([0.0, 1189000000.01, 1189000000.02, 4102444800.123]))
    product = dataclasses.replace(make_product(4, 1), record=record)
    back = netcdf.read_corrected(write(tmp_path / "c.nc", product))
    np.testing.assert_array_equal(back.record.time_s, record.time_s)


# ---------------------------------------------------------------------------------------------------------- attributes
# Attributes required by the OceanSITES 1.4 manual (GDAC), with their expected values.
OCEANSITES = {
    "site_code": "EG4",
    "Conventions": "CF-1.11, ACDD-1.3, OceanSITES-1.4",
    "geospatial_lat_max": 65.3333,
    "time_coverage_start": "2007-09-05T13:46:40Z",
    "time_coverage_end": "2007-09-08T08:06:40Z",
    "time_coverage_duration": "P2DT18H20M",
    "time_coverage_resolution": "PT20M",
    "date_created": "2026-01-02T03:04:05Z",
    "principal_investigator": "A. Fram",
    "cdm_data_type": "TimeSeriesProfile",
}


def test_attributes_required_by_oceansites_are_present(corrected_nc):
    with netCDF4.Dataset(corrected_nc) as nc:
        assert {name: nc.getncattr(name) for name in OCEANSITES} == OCEANSITES


def test_variables_have_sensor_vocabulary_and_standard_names(corrected_nc):
    with netCDF4.Dataset(corrected_nc) as nc:
        assert nc["UCUR"].sensor_serial_number == 1367 and nc["UCUR"].sensor_orientation == "upward"
        assert nc["UCUR"].sdn_uom_urn == "SDN:P06::UVAA" and "DECLINATION" not in nc["UCUR"].declination_comment
        of_currents = [name for name, v in nc.variables.items() if "water_velocity" in getattr(v, "standard_name", "")]
        assert not [name for name in of_currents if "RECORDED" in name] and {"UCUR", "VCUR"} <= {*of_currents}
        assert len({v.sdn_parameter_urn for v in (nc["UCUR"], nc["VCUR"], nc["DEPTH"], nc["TIME"])}) == 4


def test_user_attributes_override_all_but_derived_ones(tmp_path):
    derived = ("Conventions", "time_coverage_start", "history", "data_mode", "software_version", "Source_Files")
    wishes = {"title": "Mine", "source": "ship", "correction_coefficients": "{}"} | dict.fromkeys(derived, "mine")
    with netCDF4.Dataset(write(tmp_path / "c.nc", attributes=wishes)) as nc:
        assert (nc.title, nc.source, nc.data_mode) == ("Mine", "ship", "D")
        assert nc.Conventions == archive_attributes.CONVENTIONS
        assert nc.software_version == PROCESSING["software_version"] and "Source_Files" not in nc.ncattrs()
        assert nc.time_coverage_start == "2007-09-05T13:46:40Z" and nc.history == PROCESSING["history"]
        assert not {"creator_name", "license", "institution"} & {*nc.ncattrs()}
        assert json.loads(nc.correction_coefficients) == {"A": 0.1}


@pytest.mark.parametrize(("given_east", "kept"), [(-32.955, -32.955), (327.0, -33.0), (180.0, 180.0)])
def test_longitudes_are_signed(tmp_path, given_east, kept):
    site = Site("E G_4", 65.0, given_east)
    with netCDF4.Dataset(write(tmp_path / "c.nc", site=site)) as nc:
        assert nc["LONGITUDE"][...] == nc.geospatial_lon_min == kept
        assert nc.id == "OS_E-G-4_200709_D_compass-corrected"


@pytest.mark.parametrize(("seconds", "text"), [(0, "P0D"), (59.9999, "PT1M"), (34214400.25, "P396DT0.25S")])
def test_durations_are_iso_8601(seconds, text):
    assert archive_attributes.iso_duration(seconds) == text


# ------------------------------------------------------------------------------------------------------ other libraries
