"""Would catch datasets that lack a dimension, a unit or a variable of the file."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

import compasslib
from compasslib.records import Labelled
from tests.world.products import make_product, write
from tests.world.sea import pairs


def test_product_converts_to_xarray_with_dimensions_and_units(tmp_path):
    pytest.importorskip("xarray", reason="xarray is not installed")
    product = compasslib.open_product(write(tmp_path / "corrected.nc", make_product(50, 4)))
    data = product.to_xarray()
    assert (
        data.STATION.values.item() == b"EG4"
        and data.sizes["TIME"] == 50
        and data.sizes["BIN"] == 4
        and {"TIME", "BIN", "DEPTH"} <= {*data.coords}
    )
    step = np.abs(data.TIME.values - np.round(product.record.time_s * 1e3).astype("datetime64[ms]"))
    assert (step < np.timedelta64(1, "ms")).all()  # days since 1950 in float64
    for name, unit, values in (
        ("HEADING_CORRECTED", "degree", product.heading_corrected_deg),
        ("UCUR", "m s-1", product.east),
        ("UCUR_UNCERTAINTY", "m s-1", product.velocity_uncertainty),
        ("HEADING", "degree", product.record.heading_deg),
    ):
        assert data[name].units == unit and data[name].values == pytest.approx(values, nan_ok=True)
    data.to_netcdf(tmp_path / "again.nc")


def test_channels_and_pairs_become_variables(tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    seen, _ = pairs(n=30)
    data = seen.to_xarray()
    assert isinstance(data, xarray.Dataset) and data["lower_east"].dims == ("time",)
    assert data["separation_minutes"].units == "minutes" and "reference_names" not in data.attrs
    record = make_product(20, 3).record
    record = replace(record, channels={"load": np.arange(20.0)}, channel_units={"load": "kN"})
    record = replace(record, profiles={"echo": np.zeros((20, 3, 4), dtype=np.int16)})
    data = record.to_xarray()
    assert data["load"].units == "kN" and data["echo"].dims == ("time", "bin", "beam")


def test_missing_xarray_is_reported_with_the_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    seen, _ = pairs(n=30)
    assert isinstance(seen, Labelled)
    with pytest.raises(ImportError, match=r"pip install 'compasslib\[xarray\]'"):
        seen.to_xarray()
