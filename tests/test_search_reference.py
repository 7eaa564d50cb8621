"""Faults of the trusted instrument: found as such, and never put on the affected compass alone."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compasslib.archive import netcdf
from compasslib.core import angles
from compasslib.simulation import draw
from compasslib.simulation.sealed import Wish
from compasslib.stages import pipeline

HOURS = 5000


def processed(tmp_path, effect, *, wide, seed=11):
    """Return diagnosis.json and the errors of the corrected headings of one mooring with a fault of 3 degrees."""
    one = draw.Sealed("R1", "single", {effect: 3.0}, wish=Wish(wide=wide, hours=HOURS), seed=seed)
    cruise, locked = draw.write_alone(one, tmp_path)
    folder = pipeline.process(cruise, "R1", tmp_path / "results")
    product = netcdf.read_corrected(folder / "corrected.nc")
    time_s, heading, *_ = np.load(locked / "R1.npy")
    error = angles.difference(
        product.heading_corrected_deg, heading[np.searchsorted(time_s, product.record.time_s).clip(0, len(time_s) - 1)]
    )
    assert netcdf.read_pairs(folder / "overlap.nc").lower_heading_deg is not None
    return json.loads((folder / "diagnosis.json").read_text()), error[np.isfinite(error)]


@pytest.mark.parametrize("effect", ["reference_deviation", "reference_beams", "reference_bias"])
def test_a_fault_of_the_trusted_instrument_is_named_with_its_side(tmp_path, effect):
    found, error = processed(tmp_path, effect, wide=True)
    first = found["findings"][0]
    assert effect in (first["effect"], *first["alternatives"])
    assert first["side"] == "reference" and not first["applied"]
    assert "trusted" in first["text"]
    assert angles.rms(error) < 2.0


@pytest.mark.parametrize("effect", ["reference_slip", "heading_slip"])
def test_a_step_is_put_on_neither_side_where_the_record_cannot_tell_whose_it_is(tmp_path, effect):
    found, _ = processed(tmp_path, effect, wide=False)
    first = found["findings"][0]
    assert {"reference_slip", "heading_slip"} <= {first["effect"], *first["alternatives"]}
    assert found["verdict"] == "ambiguous" and not first["applied"]
    assert "second trusted instrument" in found["separated_by"]
