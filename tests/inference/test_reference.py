"""Would catch a fault of the reference that is attributed to the affected compass alone."""

import json

import numpy as np
import pytest

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.demo.sealed import Wish
from tests.world import chain, draw


def processed(tmp_path, effect, *, wide, hours=3000, seed=11, size_deg=3.0):
    """Process a mooring; return diagnosis.json and heading errors, in degrees and in half-widths of 95 % intervals."""
    cruise, locked = draw.write_alone(tmp_path, "R1", Wish(wide=wide, hours=hours), seed, {effect: size_deg})
    folder = chain.make(cruise, "R1", tmp_path / "results")
    product = netcdf.read_corrected(folder / "corrected.nc")
    time_s, heading, *_ = np.load(locked / "R1.npy")
    error = angles.difference(
        product.heading_corrected_deg, heading[np.searchsorted(time_s, product.record.time_s).clip(0, len(time_s) - 1)]
    )
    assert netcdf.read_pairs(folder / "overlap.nc").lower_heading_deg is not None
    known = np.isfinite(error)
    share = np.abs(error[known]) / (1.96 * product.heading_uncertainty_deg[known])
    return json.loads((folder / "diagnosis.json").read_text()), error[known], share


@pytest.mark.parametrize("effect", ["reference_deviation", "reference_beams", "reference_bias"])
def test_a_fault_of_the_reference_is_attributed_to_it(tmp_path, effect):
    found, error, _ = processed(tmp_path, effect, wide=True)
    first = found["findings"][0]
    assert effect in (first["effect"], *first["alternatives"])
    assert first["side"] == "reference" and not first["applied"]
    assert "reference" in first["text"]
    assert angles.rms(error) < 2.0


@pytest.mark.parametrize("effect", ["reference_slip", "heading_slip"])
def test_a_large_step_is_attributed_correctly_or_ambiguous(tmp_path, effect):
    found, _, share = processed(tmp_path, effect, wide=False, hours=3600, size_deg=12.0)
    first = found["findings"][0]
    assert effect in (first["effect"], *first["alternatives"])
    if first["effect"] != effect:
        assert found["verdict"] == "ambiguous" and "second reference" in found["separated_by"]
    assert np.mean(share < 1.0) > 0.9
