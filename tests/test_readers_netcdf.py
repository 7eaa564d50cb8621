"""The netCDF reader: layouts of others, dolfyn's own files against the PD0 reader, our product, north, units, flags."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import netCDF4
import netcdf_layouts as layouts
import numpy as np
import pytest
from netcdf_layouts import DECLINATION, M, N
from sea import SHARED
from test_archive import make_product, measured, write

from compasslib import readers
from compasslib.core import angles
from compasslib.core.errors import InputError
from compasslib.core.records import BAD, GOOD, MISSING, NOT_CHECKED, PROBABLY_BAD, PROBABLY_GOOD, Record

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
    """Give a file of a layout, to be changed."""
    path = tmp_path / "a.nc"
    layouts.write(path, name)
    with netCDF4.Dataset(path, "a") as nc:
        yield nc


def close(found: np.ndarray, expected: np.ndarray, tolerance: float = 1e-6) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("name", ["imos_magnetic", "imos_true", "epic", "stglib"])
def test_what_was_measured_comes_back_from_each_layout(tmp_path, name):
    truth = layouts.write(tmp_path / "a.nc", name)
    record = read(tmp_path / "a.nc")
    close(record.time_s, truth.time_s, 1e-4)  # days in float64
    close(record.east, truth.east)
    close(record.north, truth.north)
    close(record.bin_range_m, np.broadcast_to(truth.range_m, truth.east.shape))
    assert np.nanmax(np.abs(angles.difference(record.heading_deg, truth.heading_deg))) < 5e-5  # float32
    assert np.isnan(record.heading_deg).tolist() == np.isnan(truth.heading_deg).tolist()
    close(record.pitch_deg, truth.pitch_deg)
    close(record.roll_deg, truth.roll_deg)
    close(record.pressure_dbar, truth.pressure_dbar, 1e-5)
    close(record.temperature_c, truth.temperature_c)
    assert record.looks_up and record.direction_reference == "magnetic"
    assert record.heading_bias_deg == pytest.approx(0.0 if name == "imos_magnetic" else DECLINATION)
    assert record.quality[0, -1] == MISSING and record.heading_quality[1] == MISSING


def test_oceansites_is_from_true_north_and_its_flags_and_depths_count(tmp_path):
    truth = layouts.write(tmp_path / "a.nc", "oceansites")
    record = read(tmp_path / "a.nc", direction_reference="true")
    east, north, _ = truth.true()
    close(record.east, east)
    close(record.north, north)
    assert (record.quality[3, 2], record.quality[4, 2], record.quality[5, 2]) == (BAD, PROBABLY_GOOD, GOOD)
    close(record.bin_depth_m(), np.broadcast_to(100.0 - truth.range_m, east.shape), 1e-5)
    assert record.looks_up and record.direction_reference == "true" and np.isnan(record.heading_deg).all()
    assert not any("Headings" in line for line in record.warnings)  # it has none to leave out


@pytest.mark.parametrize("name", ["RDI_withBT.000", "03160000.000", "adp_12.000"])
def test_what_mhkit_writes_is_what_the_pd0_reader_reads(tmp_path, name):
    dolfyn = pytest.importorskip("mhkit.dolfyn")
    raw = SHARED / "pd0" / name
    if not raw.exists():
        pytest.skip(f"{raw} is not there")
    logging.disable(logging.CRITICAL)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        data = dolfyn.read(str(raw), nens=300)
        if data.attrs["coord_sys"] != "earth":
            dolfyn.save(data, str(tmp_path / "beam.nc"))
            assert "rotate2" in refused(tmp_path / "beam.nc")
            dolfyn.rotate2(data, "earth")
        dolfyn.save(data, str(tmp_path / "a.nc"))
        if not data.attrs.get("declination"):
            dolfyn.set_declination(data, 11.0)
        dolfyn.save(data, str(tmp_path / "turned.nc"))
    logging.disable(logging.NOTSET)
    silent = dict.fromkeys(("orientation", "declination_applied", "heading_alignment", "serial_number"))
    own = readers.read("pd0", [raw], silent)
    for file in ("a.nc", "turned.nc"):
        record = read(tmp_path / file)
        n = len(record.time_s)
        assert n >= 299 and (record.looks_up, record.beam_angle_deg) == (own.looks_up, own.beam_angle_deg)
        assert record.serial_number == own.serial_number
        known = np.isfinite(record.east)  # dolfyn does not solve for currents from three beams
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
        told = np.isfinite(record.pressure_dbar)  # MHKiT writes one below that of air as 4294967 dbar
        close(record.pressure_dbar[told], own.pressure_dbar[:n][told], 1e-4)


def test_our_own_product_comes_back_as_the_record_it_was_made_of(tmp_path):
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


def test_counts_of_each_beam_are_found_by_imos_names_and_what_is_not_clear_is_left_out(tmp_path):
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


NORTHS = [  # layout, attributes dropped, settings, and what the line names, or how the velocities come out turned
    ("oceansites", (), {}, "direction_reference: true"),
    ("oceansites", (), {"declination_applied": DECLINATION}, 0.0),
    ("imos_magnetic", (), {"direction_reference": "true"}, "direction_reference: magnetic"),
    ("imos_magnetic", (), {"declination_applied": 5.0}, "delete declination_applied"),
    ("imos_true", (), {"direction_reference": "true"}, DECLINATION),
    ("imos_true", (), {"direction_reference": "true", "declination_applied": 5.0}, "delete one of the two"),
    ("epic", ("magnetic_variation_applied",), {}, 0.0),
    ("epic", ("magnetic_variation_applied",), {"declination_applied": DECLINATION}, 0.0),
    ("epic", (), {"declination_applied": 0}, DECLINATION),
    ("stglib", ("history",), {}, "direction_reference: true"),
]


@pytest.mark.parametrize(("name", "without", "settings", "expected"), NORTHS)
def test_the_north_is_told_or_refused(tmp_path, name, without, settings, expected):
    with layout(tmp_path, name) as nc:
        for attribute in without:
            nc.delncattr(attribute)
    if isinstance(expected, str):
        assert expected in refused(tmp_path / "a.nc", **settings)
        return
    record, truth = read(tmp_path / "a.nc", **settings), layouts.truth()
    untold = bool(without) and not settings
    east, _ = angles.turn(truth.east, truth.north, DECLINATION if untold else expected)
    close(record.east, east)
    assert untold == any("does not say which north" in line for line in record.warnings)
    assert (record.direction_reference == "true") == (settings.get("direction_reference") == "true")


def test_a_declination_without_a_word_whether_it_was_applied_is_refused(tmp_path):
    with layout(tmp_path, "epic") as nc:
        nc.delncattr("magnetic_variation_applied")
        nc.magnetic_variation = DECLINATION
    assert "write declination_applied: -17.4 where the directions hold it, 0 where" in refused(tmp_path / "a.nc")


def test_headings_by_an_untold_declination_are_left_out_and_it_is_said(tmp_path):
    with layout(tmp_path, "stglib") as nc:
        nc.delncattr("history")
    record = read(tmp_path / "a.nc", direction_reference="true")
    assert np.isnan(record.heading_deg).all() and (record.heading_quality == MISSING).all()
    assert any("declination_applied: DEGREES" in line for line in record.warnings)


@pytest.mark.parametrize(("units", "factor"), [("m/s", 1.0), ("cm s-1", 100.0), ("mm/s", 1000.0)])
def test_speeds_are_taken_by_their_units_in_any_order_of_dimensions(tmp_path, units, factor):
    truth = layouts.truth()
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        layouts.dimensions(nc, station=1, range=layouts.M, time=layouts.N)
        layouts.put(nc, "time", ("time",), truth.time_s / 60.0, units="minutes since 1970-01-01")
        layouts.put(nc, "range", ("range",), truth.range_m[::-1], units="m")
        for name, values in (("UCUR_MAG", truth.east), ("VCUR_MAG", truth.north)):
            layouts.put(nc, name, ("range", "station", "time"), factor * values[:, ::-1], -9e9, units=units)
    assert "orientation: up or down" in refused(tmp_path / "a.nc")
    record = read(tmp_path / "a.nc", orientation="down")
    close(record.east, truth.east)  # the nearest bin comes first, whatever the file's order
    close(record.bin_range_m[0], truth.range_m)
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        nc["UCUR_MAG"].units = "knots"
    assert "units such as" in refused(tmp_path / "a.nc", orientation="down")


def test_packed_values_and_those_out_of_range_are_unpacked_and_missing(tmp_path):
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as nc:
        layouts.dimensions(nc, time=4)
        layouts.put(nc, "time", ("time",), np.arange(4.0), units="hours since 2007-09-04")
        for name in ("UCUR_MAG", "VCUR_MAG"):
            variable = nc.createVariable(name, "i2", ("time",), fill_value=-999)
            variable.set_auto_maskandscale(False)
            variable.setncatts(
                {"units": "m s-1", "scale_factor": 0.001, "add_offset": 0.5, "valid_min": np.int16(-400)}
            )
            variable[:] = [100, -999, -401, -400]
    record = read(tmp_path / "a.nc")
    np.testing.assert_allclose(record.east[:, 0], [0.6, np.nan, np.nan, 0.1], atol=1e-12)
    assert record.quality.ravel().tolist() == [GOOD, MISSING, MISSING, GOOD]


@pytest.mark.parametrize(
    ("attributes", "flags"),
    [
        (
            {"flag_values": [1, 2, 3, 4, 9], "flag_meanings": "PASS NOT_EVALUATED SUSPECT FAIL MISSING"},
            [GOOD, NOT_CHECKED, PROBABLY_BAD, BAD, MISSING],
        ),
        ({}, [GOOD, PROBABLY_GOOD, PROBABLY_BAD, BAD, MISSING]),
    ],
)  # fmt: skip
def test_flags_are_taken_by_their_meanings(tmp_path, attributes, flags):
    with layout(tmp_path, "imos_magnetic") as nc:
        for name in ("UCUR_MAG_quality_control", "VCUR_MAG_quality_control"):
            nc[name].delncattr("flag_values")
            nc[name].delncattr("flag_meanings")
            nc[name].setncatts({key: np.array(v, "i1") if isinstance(v, list) else v for key, v in attributes.items()})
            nc[name][9, :] = [1, 2, 3, 4, 9]
    record = read(tmp_path / "a.nc")
    assert record.quality[9].tolist() == flags
    assert any("what its flags mean" in line for line in record.warnings) == (not attributes)


def test_the_column_map_counts_before_names(tmp_path):
    truth = layouts.truth()
    with layout(tmp_path, "imos_magnetic") as nc:
        nc.renameVariable("UCUR_MAG", "along")
        nc.renameVariable("HEADING_MAG", "compass")
    assert "columns: {east: NAME}" in refused(tmp_path / "a.nc")
    assert "'across'" in refused(tmp_path / "a.nc", columns={"east": "across"})
    record = read(tmp_path / "a.nc", columns={"east": "along", "heading": "compass", "scale": 1.0})
    close(record.east, truth.east)
    assert np.isfinite(record.heading_deg).sum() == layouts.N - 1


def test_standard_names_count_before_names_that_look_right_and_two_are_asked_about(tmp_path):
    truth = layouts.truth()
    with layout(tmp_path, "stglib") as nc:
        nc.renameVariable("u_1205", "along")
        layouts.put(nc, "u", ("z", "time"), 9.0 * truth.east, units="m s-1")
    close(read(tmp_path / "a.nc").east, truth.east)
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as nc:
        layouts.put(nc, "again", ("z", "time"), truth.east, units="m s-1", standard_name="eastward_sea_water_velocity")
    assert "columns: {east: along}" in refused(tmp_path / "a.nc")


def test_a_point_meter_has_one_bin_and_its_depth(tmp_path):
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


def test_two_files_are_joined_in_order_of_time_and_other_bins_are_refused(tmp_path):
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


def test_what_cannot_be_read_is_refused_in_a_line_that_says_what_to_do(tmp_path):
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
    with layout(tmp_path, "epic") as nc:
        nc.renameVariable("time2", "other")
        nc["other"].units = "1"
    assert "time2" in refused(path)


def test_orientation_is_checked_against_the_file(tmp_path):
    layouts.write(tmp_path / "a.nc", "imos_magnetic")
    record = read(tmp_path / "a.nc", orientation="down")
    assert not record.looks_up and any(
        "The file says that it looked up; down counts" in line for line in record.warnings
    )


def test_the_absolute_pressure_of_imos_loses_the_atmosphere(tmp_path):
    with layout(tmp_path, "imos_magnetic") as nc:
        nc.renameVariable("PRES_REL", "PRES")
        nc["PRES"].standard_name = "sea_water_pressure"
    record = read(tmp_path / "a.nc")
    close(record.pressure_dbar, layouts.truth().pressure_dbar - 10.1325)
