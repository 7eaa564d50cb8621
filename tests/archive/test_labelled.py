"""Would catch datasets that lack a dimension, a unit or a variable of the file."""

import sys

import numpy as np
import pytest

import compasslib
from compasslib.errors import InputError
from tests.world.products import make_product, write


def test_product_converts_to_xarray_with_dimensions_and_units(tmp_path):
    pytest.importorskip("xarray", reason="xarray is not installed")
    product = compasslib.open_product(write(tmp_path / "corrected.nc", make_product(50, 4)))
    data = product.to_xarray()
    assert (data.sizes["TIME"], data.sizes["BIN"]) == (50, 4) and {"TIME", "BIN", "DEPTH"} <= {*data.coords}
    assert data.STATION.values.item() == b"EG4"
    step = np.abs(data.TIME.values - np.round(product.record.time_s * 1e3).astype("datetime64[ms]"))
    assert (step < np.timedelta64(1, "ms")).all()  # days since 1950 in float64
    for name, unit, values in (
        ("HEADING_CORRECTED", "degree", product.heading_corrected_deg),
        ("UCUR", "m s-1", product.east),
        ("UCUR_UNCERTAINTY", "m s-1", product.east_uncertainty),
        ("HEADING", "degree", product.record.heading_deg),
    ):
        assert data[name].units == unit and data[name].values == pytest.approx(values, nan_ok=True)
    data.to_netcdf(tmp_path / "again.nc")


def test_missing_xarray_and_products_in_memory_are_refused(tmp_path, monkeypatch):
    product = make_product(20, 3)
    with pytest.raises(InputError, match="expected a product opened from a file, found one in memory; write it by"):
        product.to_xarray()
    opened = compasslib.open_product(write(tmp_path / "corrected.nc", product))
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install 'compasslib\[xarray\]'"):
        opened.to_xarray()
