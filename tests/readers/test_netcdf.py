"""Would catch a layout of other software misread: names, norths, units, flags, times, dimensions."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest

from compasslib import angles, readers
from compasslib.errors import InputError
from compasslib.readers.pd0 import currents
from compasslib.readers.times import Unreadable, parse_origin
from compasslib.readers.vocabulary import MEANINGS, flag_of
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_BAD, PROBABLY_GOOD, Record
from tests.world import netcdf_layouts as layouts
from tests.world.netcdf_layouts import DECLINATION, M, N
from tests.world.products import make_product, measured, write
from tests.world.sea import SHARED, mhkit

SILENT = {"columns": None, "orientation": None, "declination_applied": None, "direction_reference": "magnetic"}


def read(*paths: Path, **settings: Any) -> Record:
    return readers.read("netcdf", paths, SILENT | settings)


def refused(path: Path, **settings: Any) -> str:
    with pytest.raises(InputError) as error:
        read(path, **settings)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    return str(error.value)


@contextlib.contextmanager
def layout(tmp_path: Path, name: str) -> Iterator[netCDF4.Dataset]:
    """Yield a file of a layout, open for modification."""
    path = tmp_path / "a.nc"
    layouts.write(path, name)
    with netCDF4.Dataset(path, "a") as nc:
        yield nc


def close(found: np.ndarray, expected: np.ndarray, tolerance: float = 1e-6) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("name", ["imos_magnetic", "imos_true", "epic", "stglib"])
def test_record_is_recovered_from_each_layout(tmp_path, name):
    truth = layouts.write(tmp_path / "a.nc", name)
    record = read(tmp_path / "a.nc")
    close(record.time_s, truth.time_s, 1e-4)  # time is stored as days in float64
    for field in ("east", "north", "pitch_deg", "roll_deg", "temperature_c"):
        close(getattr(record, field), getattr(truth, field))
    close(record.bin_range_m, np.broadcast_to(truth.range_m, truth.east.shape))
    assert np.nanmax(np.abs(angles.difference(record.heading_deg, truth.heading_deg))) < 5e-5  # float32
    assert np.isnan(record.heading_deg).tolist() == np.isnan(truth.heading_deg).tolist()
    close(record.pressure_dbar, truth.pressure_dbar, 1e-5)
    assert record.looks_up and record.direction_reference == "magnetic"
    assert record.heading_bias_deg == pytest.approx(0.0 if name == "imos_magnetic" else DECLINATION)
    assert record.quality[0, -1] == MISSING and record.heading_quality[1] == MISSING


def test_oceansites_north_flags_and_depths_are_used(tmp_path):
    truth = layouts.write(tmp_path / "a.nc", "oceansites")
    record = read(tmp_path / "a.nc", direction_reference="true")
    east, north, _ = truth.true()
    close(record.east, east)
    close(record.north, north)
    assert (record.quality[3, 2], record.quality[4, 2], record.quality[5, 2]) == (BAD, PROBABLY_GOOD, GOOD)
    close(record.bin_depth_m(), np.broadcast_to(100.0 - truth.range_m, east.shape), 1e-5)
    assert record.looks_up and record.direction_reference == "true" and np.isnan(record.heading_deg).all()
    assert not any("Headings" in line for line in record.warnings)  # the file has no headings that could be dropped


@pytest.mark.parametrize("name", ["RDI_withBT.000", "03160000.000", "adp_12.000"])
def test_mhkit_files_agree_with_the_pd0_reader(tmp_path, name, monkeypatch):
    monkeypatch.setattr(currents, "map_cells", lambda beams, *_: beams)  # dolfyn does not map the bins of tilted beams
    raw = SHARED / "pd0" / name
    if not raw.exists():
        pytest.skip(f"{raw} is not there")
    with mhkit() as dolfyn:
        data = dolfyn.read(str(raw), nens=100)
        if data.attrs["coord_sys"] != "earth":
            dolfyn.save(data, str(tmp_path / "beam.nc"))
            assert "rotate2" in refused(tmp_path / "beam.nc")
            dolfyn.rotate2(data, "earth")
        dolfyn.save(data, str(tmp_path / "a.nc"))
        if not data.attrs.get("declination"):
            dolfyn.set_declination(data, 11.0)
        dolfyn.save(data, str(tmp_path / "turned.nc"))
    silent = dict.fromkeys(("orientation", "declination_applied", "heading_alignment", "serial_number"))
    own = readers.read("pd0", [raw], silent)
    for file in ("a.nc", "turned.nc"):
        record = read(tmp_path / file)
        n = len(record.time_s)
        assert n >= 99 and (record.looks_up, record.beam_angle_deg) == (own.looks_up, own.beam_angle_deg)
        assert record.serial_number == own.serial_number
        assert (record.manufacturer, record.model) == (data.attrs["inst_make"], data.attrs["inst_model"])
        known = np.isfinite(record.east)  # dolfyn has no three-beam solution
        close(record.east[known], own.east[:n][known], 1e-5)
        close(record.north[known], own.north[:n][known], 1e-5)
        close(record.profiles["up"][known], own.profiles["up"][:n][known], 1e-5)
        assert set(record.profiles) == set(own.profiles)
        for key in {"echo", "correlation", "percent_good"} & set(own.profiles):
            np.testing.assert_array_equal(record.profiles[key], own.profiles[key][:n])
            assert record.profiles[key].dtype == np.uint8
        assert np.nanmax(np.abs(angles.difference(record.heading_deg, own.heading_deg[:n]))) < 1e-4
        for field in ("time_s", "pitch_deg", "roll_deg", "depth_m", "temperature_c", "bin_range_m"):
            close(getattr(record, field), getattr(own, field)[:n], 1e-4)
        told = np.isfinite(record.pressure_dbar)  # MHKiT writes pressures below that of air as 4294967 dbar
        close(record.pressure_dbar[told], own.pressure_dbar[:n][told], 1e-4)


def test_own_product_is_read_back_as_its_record(tmp_path):
    product = make_product(60, 4, **measured(60, 4))
    write(tmp_path / "a.nc", product)
    record, own = read(tmp_path / "a.nc"), product.record
    east, north = angles.turn(product.east_recorded, product.north_recorded, -product.declination_deg[:, None])
    close(record.east, east, 2e-6)
    close(record.north, north, 2e-6)
    close(record.time_s, own.time_s, 1e-4)
    close(record.bin_depth_m(), own.bin_depth_m(), 1e-4)
    assert record.looks_up == own.looks_up
    close(record.pressure_dbar, own.pressure_dbar, 1e-9)
    for key, values in own.profiles.items():
        np.testing.assert_array_equal(record.profiles[key], values)
    np.testing.assert_allclose(angles.difference(record.heading_deg, own.heading_deg), 0.0, atol=1e-9)
    assert (record.quality == MISSING).tolist() == (np.isnan(product.east_recorded)).tolist()
    kept = read(tmp_path / "a.nc", direction_reference="true", columns={"east": "UCUR", "north": "VCUR"})
    close(kept.east, product.east, 2e-6)


def test_imos_beam_counts_are_read_and_unclear_variables_dropped(tmp_path):
    layouts.write(tmp_path / "a.nc", "imos_magnetic")
    counts = np.arange(N * M * 4).reshape(N, M, 4) % 200
    counts[5, 2, 1] = -1
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        for beam in range(4):
            made = nc.createVariable(f"ABSIC{beam + 1}", "i2", ("TIME", "HEIGHT_ABOVE_SENSOR"), fill_value=-1)
            made[:] = counts[..., beam]
        nc.createVariable("WCUR", "f4", ("TIME", "HEIGHT_ABOVE_SENSOR")).units = "furlong fortnight-1"
        nc.createVariable("CMAG1", "f4", ("TIME", "HEIGHT_ABOVE_SENSOR"))[:] = 1.0
    record = read(tmp_path / "a.nc")
    assert list(record.profiles) == ["echo"]
    np.testing.assert_array_equal(record.profiles["echo"], counts)


NORTHS = [  # layout, attributes deleted or added, settings, text of the refusal or rotation of velocities in degrees
    ("oceansites", (), {}, "direction_reference: true"),
    ("oceansites", (), {"declination_applied": DECLINATION}, 0.0),
    ("imos_magnetic", (), {"direction_reference": "true"}, "direction_reference: magnetic"),
    ("imos_magnetic", (), {"declination_applied": 5.0}, "delete declination_applied"),
    ("imos_true", (), {"direction_reference": "true"}, DECLINATION),
    ("imos_true", (), {"direction_reference": "true", "declination_applied": 5.0}, "delete one of the two"),
    ("epic", ("magnetic_variation_applied",), {}, 0.0),
    ("epic", ("magnetic_variation_applied",), {"declination_applied": DECLINATION}, 0.0),
    ("epic", (), {"declination_applied": 0}, DECLINATION),
    ("epic", ("magnetic_variation_applied", "magnetic_variation"), {}, "write declination_applied: -17.4 where the"),
    ("stglib", ("history",), {}, "direction_reference: true"),
]


@pytest.mark.parametrize(("name", "without", "settings", "expected"), NORTHS)
def test_north_reference_is_determined_or_refused(tmp_path, name, without, settings, expected):
    with layout(tmp_path, name) as nc:
        for attribute in without:
            if attribute in nc.ncattrs():
                nc.delncattr(attribute)
            else:
                nc.setncattr(attribute, DECLINATION)
    if isinstance(expected, str):
        assert expected in refused(tmp_path / "a.nc", **settings)
        return
    record, truth = read(tmp_path / "a.nc", **settings), layouts.truth()
    untold = bool(without) and not settings
    east, _ = angles.turn(truth.east, truth.north, DECLINATION if untold else expected)
    close(record.east, east)
    assert untold == any("does not say which north" in line for line in record.warnings)
    assert (record.direction_reference == "true") == (settings.get("direction_reference") == "true")


def test_headings_with_unknown_declination_are_dropped_and_reported(tmp_path):
    with layout(tmp_path, "stglib") as nc:
        nc.delncattr("history")
    record = read(tmp_path / "a.nc", direction_reference="true")
    assert np.isnan(record.heading_deg).all() and (record.heading_quality == MISSING).all()
    assert any("declination_applied: DEGREES" in line for line in record.warnings)


@pytest.mark.parametrize(("units", "factor"), [("m/s", 1.0), ("cm s-1", 100.0), ("mm/s", 1000.0)])
def test_velocity_units_and_order_of_dimensions_are_handled(tmp_path, units, factor):
    truth = layouts.truth()
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        layouts.dimensions(nc, station=1, range=layouts.M, time=layouts.N)
        layouts.put(nc, "time", ("time",), truth.time_s / 60.0, units="minutes since 1970-01-01")
        layouts.put(nc, "range", ("range",), truth.range_m[::-1], units="m")
        for name, values in (("UCUR_MAG", truth.east), ("VCUR_MAG", truth.north)):
            layouts.put(nc, name, ("range", "station", "time"), factor * values[:, ::-1], -9e9, units=units)
    assert "orientation: up or down" in refused(tmp_path / "a.nc")
    record = read(tmp_path / "a.nc", orientation="down")
    close(record.east, truth.east)  # bins are sorted by range, whatever their order in the file
    close(record.bin_range_m[0], truth.range_m)
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        nc["UCUR_MAG"].units = "knots"
    assert "units such as" in refused(tmp_path / "a.nc", orientation="down")


def test_packed_values_are_unpacked_and_those_out_of_range_missing(tmp_path):
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        layouts.dimensions(nc, time=4)
        layouts.put(nc, "time", ("time",), np.arange(4.0), units="hours since 2007-09-04")
        for name in ("UCUR_MAG", "VCUR_MAG"):
            variable = nc.createVariable(name, "i2", ("time",), fill_value=-999)
            variable.set_auto_maskandscale(False)
            packing = {"scale_factor": 0.001, "add_offset": 0.5, "valid_min": np.int16(-400)}
            variable.setncatts({"units": "m s-1"} | packing)
            variable[:] = [100, -999, -401, -400]
    record = read(tmp_path / "a.nc")
    np.testing.assert_allclose(record.east[:, 0], [0.6, np.nan, np.nan, 0.1], atol=1e-12)
    assert record.quality.ravel().tolist() == [GOOD, MISSING, MISSING, GOOD]


def test_flags_without_meanings_are_those_of_oceansites_and_reported(tmp_path):
    with layout(tmp_path, "imos_magnetic") as nc:
        for name in ("UCUR_MAG_quality_control", "VCUR_MAG_quality_control"):
            nc[name].delncattr("flag_values")
            nc[name].delncattr("flag_meanings")
            nc[name][9, :] = [1, 2, 3, 4, 9]
    record = read(tmp_path / "a.nc")
    assert record.quality[9].tolist() == [GOOD, PROBABLY_GOOD, PROBABLY_BAD, BAD, MISSING]
    assert any("what its flags mean" in line for line in record.warnings)


def test_column_map_takes_precedence_over_names(tmp_path):
    truth = layouts.truth()
    with layout(tmp_path, "imos_magnetic") as nc:
        nc.renameVariable("UCUR_MAG", "along")
        nc.renameVariable("HEADING_MAG", "compass")
    assert "columns: {east: NAME}" in refused(tmp_path / "a.nc")
    assert "'across'" in refused(tmp_path / "a.nc", columns={"east": "across"})
    record = read(tmp_path / "a.nc", columns={"east": "along", "heading": "compass", "scale": 1.0})
    close(record.east, truth.east)
    assert np.isfinite(record.heading_deg).sum() == layouts.N - 1


def test_standard_names_take_precedence_and_duplicates_are_refused(tmp_path):
    truth = layouts.truth()
    with layout(tmp_path, "stglib") as nc:
        nc.renameVariable("u_1205", "along")
        layouts.put(nc, "u", ("z", "time"), 9.0 * truth.east, units="m s-1")
    close(read(tmp_path / "a.nc").east, truth.east)
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        layouts.put(nc, "again", ("z", "time"), truth.east, units="m s-1", standard_name="eastward_sea_water_velocity")
    assert "columns: {east: along}" in refused(tmp_path / "a.nc")


def test_point_current_meter_has_one_bin_and_its_depth(tmp_path):
    truth = layouts.truth()
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        layouts.dimensions(nc, TIME=layouts.N, DEPTH=1)
        layouts.put(nc, "TIME", ("TIME",), truth.time_s, units="seconds since 1970-01-01")
        layouts.put(nc, "DEPTH", ("DEPTH",), np.array([120.0]), units="m", standard_name="depth", positive="down")
        for name, values in (("UCUR_MAG", truth.east[:, 0]), ("VCUR_MAG", truth.north[:, 0])):
            layouts.put(nc, name, ("TIME", "DEPTH"), values, units="m/s")
    record = read(tmp_path / "a.nc")
    close(record.east, truth.east[:, :1])
    assert not record.bin_range_m.any() and (record.depth_m == 120.0).all()


def test_files_are_joined_in_time_and_different_bins_refused(tmp_path):
    truth = layouts.write(tmp_path / "a.nc", "imos_magnetic")
    with layout(tmp_path, "imos_magnetic") as nc:
        nc["TIME"][:] = nc["TIME"][:] + 10.0
    (tmp_path / "a.nc").rename(tmp_path / "b.nc")
    layouts.write(tmp_path / "a.nc", "imos_magnetic")
    both = read(tmp_path / "b.nc", tmp_path / "a.nc")
    close(both.time_s, np.concatenate([truth.time_s, truth.time_s + 864000.0]), 1e-4)
    write(tmp_path / "c.nc", make_product(60, 4))
    with pytest.raises(InputError, match="parts of one recording"):
        read(tmp_path / "a.nc", tmp_path / "c.nc")


def test_unreadable_files_are_refused_with_advice(tmp_path):
    path = tmp_path / "a.nc"
    path.write_bytes(b"not a netCDF file at all")
    assert "expected a netCDF file, found a text" in refused(path)
    with netCDF4.Dataset(path, "w") as nc:
        nc.createGroup("Data")
    assert "groups Data" in refused(path)
    with netCDF4.Dataset(path, "w") as nc:
        layouts.dimensions(nc, time=4)
    assert "columns: {time: NAME}" in refused(path)
    with layout(tmp_path, "imos_magnetic") as nc:
        nc.renameVariable("HEIGHT_ABOVE_SENSOR", "cells")
    assert "columns: {range: NAME}" in refused(path)
    with layout(tmp_path, "imos_magnetic") as nc:
        nc["TIME"].calendar = "360_day"
    assert "calendar 360_day" in refused(path)
    with layout(tmp_path, "imos_magnetic") as nc:
        nc["TIME"].units = "days since 1950-01-01 00:00:00 EST"
    assert "TIME: units: expected a date, a time of day and an offset from UTC" in refused(path)
    with layout(tmp_path, "epic") as nc:
        nc.renameVariable("time2", "other")
        nc["other"].units = "1"
    assert "time2" in refused(path)
    with layout(tmp_path, "epic") as nc:
        nc["time"][:] = nc["time"][:] - 2440000  # days since another date, as ADCPy's demonstration has them
    assert "time: expected times of 1950 to 2100, found the year -4673; name another variable" in refused(path)


def test_absolute_imos_pressure_and_orientation_of_the_metadata(tmp_path):
    with layout(tmp_path, "imos_magnetic") as nc:
        nc.renameVariable("PRES_REL", "PRES")
        nc["PRES"].standard_name = "sea_water_pressure"
    record = read(tmp_path / "a.nc")
    close(record.pressure_dbar, layouts.truth().pressure_dbar - 10.1325)
    down, said = read(tmp_path / "a.nc", orientation="down"), "The file says that it looked up; down counts"
    assert not down.looks_up and any(said in line for line in down.warnings)


def test_single_pings_and_averages_are_read_separately(tmp_path):
    truth = layouts.truth()
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        nc.setncatts({"coord_sys": "earth", "orientation": "up", "beam_angle": 20.0})
        layouts.dimensions(nc, dir=3, time=N, range=M, time_avg=N - 10, range_avg=M - 1)
        labels = nc.createVariable("dir", str, ("dir",))
        labels[:] = np.array(["E", "N", "U"], dtype=object)
        for suffix, n, m, sign in (("", N, M, 1.0), ("_avg", N - 10, M - 1, -1.0)):
            along, deep = f"time{suffix}", f"range{suffix}"
            layouts.put(nc, along, (along,), truth.time_s[:n] + 100.0 * (sign < 0), units="seconds since 1970-01-01")
            layouts.put(nc, deep, (deep,), truth.range_m[:m], units="m")
            layouts.put(nc, f"heading{suffix}", (along,), truth.heading_deg[:n], units="degree")
            flow = nc.createVariable(f"vel{suffix}", "f8", ("dir", deep, along))
            flow.units = "m s-1"
            flow[:] = sign * np.stack([truth.east.T, truth.north.T, truth.east.T])[:, :m, :n]
    record = read(tmp_path / "a.nc")
    assert record.east.shape == (N, M) and "columns: {time: time_avg} reads instead" in " ".join(record.warnings)
    for columns in ({"time": "time_avg"}, {"time": "time_avg", "east": "vel_avg"}):
        means = read(tmp_path / "a.nc", columns=columns)
        close(means.east, -truth.east[: N - 10, : M - 1])
        close(means.profiles["up"], means.east, 1e-6)
        assert np.isfinite(means.heading_deg).sum() == N - 11 and not any("instead" in line for line in means.warnings)


@pytest.mark.parametrize(
    "word", ["compass_error", "not_bad", "low_percent_good", "no_good", "passed_by", "goodness", "badly_missing"]
)
def test_flag_word_containing_a_known_word_is_unknown(word):
    assert flag_of("1", word, {}) is None
    assert {flag_of("1", known.upper(), {}) for known in MEANINGS} == {0, 1, 2, 3, 4, 9}


MASKS = [  # attributes, expected flag of each value, text that names an unknown value
    ({"flag_masks": [1, 2, 4], "flag_meanings": "suspect fail side_lobe"},
     {0: 0, 1: 3, 2: 4, 3: 4, 4: 3, 6: 4, 8: 3}, "side_lobe ("),
    ({"flag_masks": [1, 2], "flag_meanings": "good fail"}, {0: 3, 1: 1, 2: 4, 3: 4}, " 0 ("),
    ({"flag_masks": [1, 2, -128], "flag_meanings": "pass not_evaluated fail"}, {1: 1, 3: 0, -127: 4}, ""),
    ({"flag_masks": [3, 3, 3, 12, 12], "flag_values": [1, 2, 3, 4, 8], "flag_meanings": "pass suspect fail pass fail"},
     {5: 1, 6: 3, 7: 4, 9: 4, 1: 1, 13: 3, 0: 3}, " 13 ("),
    ({"flag_masks": "1b, 2b", "flag_meanings": "suspect fail"}, {1: 3, 2: 4, 0: 0}, ""),
    ({"flag_values": [0, 1, 2], "flag_meanings": "raw accepted rejected"}, {0: 3, 1: 3, 2: 3}, "raw ("),
    ({"flag_values": [1, 2], "flag_meanings": "good bad"}, {1: 1, 2: 4, 5: 3}, " 5 ("),
    ({"flag_values": [1, 2, 3, 4, 9], "flag_meanings": "PASS NOT_EVALUATED SUSPECT FAIL MISSING"},
     {1: 1, 2: 0, 3: 3, 4: 4, 9: 9}, ""),
    ({"flag_meanings": "good bad"}, {1: 3, 0: 3}, " 0 ("),
    ({"conventions": "Argo reference table 2"}, {1: 1, 4: 4, 8: 2, 6: 3}, " 6 ("),
    ({"sdn_conventions_urn": "SDN:L20::"}, {48: 0, 49: 1, 52: 4, 65: 3, 57: 9}, ""),
    ({"long_name": "WOCE quality flag"}, {1: 0, 2: 1, 3: 3}, ""),
]  # fmt: skip


@pytest.mark.parametrize(("attributes", "expected", "named"), MASKS)
def test_all_cf_flag_forms_are_read_and_unknown_flags_named(tmp_path, attributes, expected, named):
    with layout(tmp_path, "stglib") as nc:
        quality = nc.createVariable("u_1205_QC", "i1", ("time",))
        quality.setncatts({key: np.array(v, "i1") if isinstance(v, list) else v for key, v in attributes.items()})
        values = np.resize(np.array([*expected], "i1"), N)
        quality[:] = values
    record = read(tmp_path / "a.nc")
    assert record.quality[1:, 0].tolist() == [expected[int(value)] for value in values[1:]]
    said = [line for line in record.warnings if "is not known" in line]
    assert bool(said) == bool(named) and named in " ".join(said) and all("flags: {" in line for line in said)


def test_headings_are_known_by_the_standard_name_of_imos(tmp_path):
    """imos-toolbox writes CF's aliases platform_yaw_angle, platform_pitch_angle and platform_roll_angle."""
    with layout(tmp_path, "stglib") as nc:
        nc["Hdg_1215"].standard_name = "platform_yaw_angle"
    assert np.isfinite(read(tmp_path / "a.nc").heading_deg).any()


def test_flags_of_all_variables_apply_and_orphans_are_reported(tmp_path):
    words = {"flag_values": np.array([1, 4], "i1"), "flag_meanings": "good_data bad_data"}
    with layout(tmp_path, "stglib") as nc:
        layouts.dimensions(nc, test=3)
        for at, name in enumerate(("time_QC", "P_1_qc", "Ptch_1216_QC", "lonely"), 7):
            layouts.put(nc, name, ("time",), np.where(np.arange(N) == at, 4, 1).astype("i1"), **words)
        tests = np.ones((N, 3), "i1")
        tests[11, 2] = 4
        layouts.put(nc, "tests", ("time", "test"), tests, **words)
        nc["u_1205"].ancillary_variables = "tests nothing_there z"
    record = read(tmp_path / "a.nc")
    assert np.flatnonzero((record.quality == BAD).all(axis=1)).tolist() == [7, 11]
    assert np.flatnonzero(record.heading_quality == BAD).tolist() == [7]
    assert np.isnan(record.pressure_dbar).nonzero()[0].tolist() == [8]
    assert np.isnan(record.pitch_deg).nonzero()[0].tolist() == [9]
    assert any("Flags lonely belong to no variable" in line for line in record.warnings)
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        layouts.dimensions(nc, other=4)
        layouts.put(nc, "apart", ("time", "other"), np.ones((N, 4), "i1"), **words)
        nc["u_1205"].ancillary_variables = "apart"
    assert "apart: expected flags along time, z" in refused(tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        layouts.put(nc, "all_in_one", ("time",), np.full(N, 4, "i1"), standard_name="aggregate_quality_flag", **words)
        nc["u_1205"].ancillary_variables = "apart all_in_one"
    assert (read(tmp_path / "a.nc").quality[1:] == BAD).all()


ORIGINS = [  # text after "since", calendar, UTC
    ("1992-10-8 15:15:42.5 -6:00", "standard", "1992-10-08T21:15:42.5"),
    ("1970-01-01 0", "standard", "1970-01-01"),
    ("2007-09-04T12:00:00.000 +0530", "standard", "2007-09-04T06:30"),
    ("2007-09-04 12:00 -330", "standard", "2007-09-04T15:30"),
    ("20070904 12 utc", "standard", "2007-09-04T12:00"),
    ("-4713-01-01T00:00:00Z", "julian", "-4713-11-24"),
    ("1970-01-01 00:00:00 EST", "standard", None),
    ("1970-01-01 00:00:00 +15:00", "standard", None),
    ("1970-02-30", "standard", None),
    ("1970-01-01 00:00:00 and more", "standard", None),
]


@pytest.mark.parametrize(("text", "calendar", "utc"), ORIGINS)
def test_time_origin_is_parsed_completely_or_refused(text, calendar, utc):
    if utc is None:
        with pytest.raises(Unreadable):
            parse_origin(text, calendar)
    else:
        assert parse_origin(text, calendar) == np.datetime64(utc, "ms").astype(np.int64) / 1e3


def test_several_bins_or_instruments_as_rows_of_one_series_are_refused(tmp_path):
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        layouts.dimensions(nc, OBSERVATION=N, INSTRUMENT=2)
        layouts.put(nc, "TIME", ("OBSERVATION",), np.arange(N) // 3 * 3600.0, units="seconds since 2007-09-04")
        layouts.put(nc, "DEPTH", ("OBSERVATION",), 20.0 + 4.0 * (np.arange(N) % 3), units="m")
        for name in ("UCUR_MAG", "VCUR_MAG"):
            layouts.put(nc, name, ("OBSERVATION",), np.linspace(0.0, 0.2, N), units="m s-1")
        layouts.put(nc, "count", ("INSTRUMENT",), np.array([20, 40]))
    assert "40 of 60 times repeated at another depth" in refused(tmp_path / "a.nc")
    for name, attribute, dimension in (("count", "sample", "OBSERVATION"), ("DEPTH", "instance", "INSTRUMENT")):
        with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
            nc[name].setncattr(f"{attribute}_dimension", dimension)
        assert f"found 2 in one, by {name}" in refused(tmp_path / "a.nc")
        with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
            nc[name].delncattr(f"{attribute}_dimension")


@pytest.mark.parametrize(
    ("attribute", "value"), [("heading_alignment", np.int16(4500)), ("heading_misalign_deg", 45.0)]
)
def test_heading_alignment_in_a_file_requires_a_setting(tmp_path, attribute, value):
    plain = layouts.write(tmp_path / "a.nc", "imos_magnetic")
    assert "expected one that is not 0" in refused(tmp_path / "a.nc", heading_alignment=45.0)
    with layout(tmp_path, "imos_magnetic") as nc:
        (nc["HEADING_MAG"] if attribute == "heading_alignment" else nc).setncattr(attribute, value)
    assert "found 45 degrees; give heading_alignment" in refused(tmp_path / "a.nc")
    for stated in (0.0, 45.0):
        record = read(tmp_path / "a.nc", heading_alignment=stated)
        assert np.nanmax(np.abs(angles.difference(record.heading_deg, plain.heading_deg + stated))) < 1e-4
        close(record.east, plain.east)


def test_headings_and_velocities_may_contain_different_declinations(tmp_path):
    truth = layouts.write(tmp_path / "a.nc", "epic")
    record = read(tmp_path / "a.nc", declination_applied={"heading": 3.0, "velocity": DECLINATION})
    close(record.east, truth.east)
    off = angles.difference(record.heading_deg, truth.heading_deg)
    close(off[np.isfinite(off)], np.full(N - 1, DECLINATION - 3.0), 1e-4)
    assert (record.heading_bias_deg, record.velocity_bias_deg) == (3.0, DECLINATION)
    with layout(tmp_path, "imos_true") as nc:
        nc["HEADING"].compass_correction_applied = 0.0  # the mooring file takes precedence over the attribute
    for stated, inside in (({"heading": 3.0, "velocity": DECLINATION}, 3.0), (DECLINATION, 0.0)):
        record = read(tmp_path / "a.nc", declination_applied=stated)
        off = angles.difference(record.heading_deg, truth.heading_deg)
        close(off[np.isfinite(off)], np.full(N - 1, DECLINATION - inside), 1e-4)
    layouts.write(tmp_path / "a.nc", "stglib")
    true = {"direction_reference": "true"}
    kept = read(tmp_path / "a.nc", **true, declination_applied={"heading": DECLINATION, "velocity": 0})
    off = angles.difference(kept.heading_deg, truth.heading_deg)
    close(off[np.isfinite(off)], np.zeros(N - 1), 1e-4)
    said = refused(tmp_path / "a.nc", **true, declination_applied={"heading": 0, "velocity": 5.0})
    assert "delete one of the two" in said


@pytest.mark.parametrize("of", ["UCUR_MAG", "UCUR_MAG_QC"])
def test_declared_size_is_checked_before_allocation(tmp_path, of):
    """Small files declare GiB in compressed, chunked variables that were never written."""
    path = tmp_path / "a.nc"
    with netCDF4.Dataset(path, "w") as nc:
        nc.createDimension("time", None)
        layouts.dimensions(nc, bin=1_000_000 if of == "UCUR_MAG" else 4, beam=300_000)
        nc.createVariable("time", "f8", ("time",)).units = "hours since 2007-09-04"
        nc["time"][:] = np.arange(2000.0)
        for name in ("UCUR_MAG", "VCUR_MAG"):
            nc.createVariable(name, "f4", ("time", "bin"), zlib=True, chunksizes=(10, 4)).units = "m s-1"
        if of == "UCUR_MAG_QC":
            nc.createVariable(of, "i1", ("time", "bin", "beam"), zlib=True, chunksizes=(10, 4, 100))
    assert path.stat().st_size < 40_000
    said = refused(path, orientation="up")
    assert f"{of}: expected arrays that take up to 1024 MB of memory, found" in said and "in 0.0 MB of files" in said


def test_declared_chunk_size_is_checked_before_allocation(tmp_path):
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        nc.createDimension("time", None)
        nc.createVariable("time", "i1", ("time",), zlib=True, chunksizes=(2**31,)).units = "hours since 2007-09-04"
        nc.createVariable("UCUR_MAG", "f4", ("time",))[:] = np.zeros(5)
    assert "found 2048 MB in 0.0 MB of files" in refused(tmp_path / "a.nc")


@pytest.mark.parametrize("size", [48, None])
def test_truncated_classic_file_is_refused(tmp_path, size):
    path, hours = tmp_path / "a.nc", np.arange(48.0)
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as nc:
        nc.createDimension("time", size)
        for name, unit, values in (
            ("time", "hours since 2007-09-04", hours),
            ("UCUR", "m/s", 0.1),
            ("VCUR", "m/s", 0.2),
        ):
            nc.createVariable(name, "f8", ("time",))[:] = np.broadcast_to(values, 48)
            nc[name].units = unit
    assert len(read(path).time_s) == 48
    path.write_bytes(path.read_bytes()[:-8])  # the library reads zeros there
    assert "it is truncated; copy it again" in refused(path)
