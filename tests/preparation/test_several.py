"""Would catch several references combined wrongly, or accused for the natural difference of the water."""

import copy
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import yaml

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.archive.files import read_json
from compasslib.errors import InputError
from compasslib.pipeline.process import process_mooring
from compasslib.preparation.pairs import PairRules, find_pairs
from compasslib.preparation.references import combine_references, join_references
from compasslib.product.cells import compare_at_seam
from compasslib.records import PROBABLY_BAD, ReferenceCompass, take
from tests.world import chain, sea
from tests.world.layers import ALL_NEAR, CELL_M, FIELD, error_deg, instrument, layers, seen
from tests.world.sea import MILD

NAMES = ("low", "mid", "high")


def turned(flow, by_deg):
    return flow * np.exp(-1j * np.deg2rad(by_deg))[:, None]


def trio(seed, faults=None, predict=True):
    """Simulate pairs with meters below, next to and above the sphere, their directions wrong by ``faults`` degrees."""
    flow = layers(seed)
    top, _, heading = seen(MILD, flow, seed)
    zero, found = np.zeros(len(flow)), []
    for name, bin_ in zip(NAMES, (0, 1, 5), strict=True):
        wrong = turned(flow[:, bin_ : bin_ + 1], zero + (faults or {}).get(name, 0.0))
        meter = instrument(wrong, CELL_M * (bin_ - 1), heading_deg=np.full(len(flow), np.nan))
        found.append(find_pairs(top, [meter], FIELD, PairRules(max_metres=ALL_NEAR.max_metres, predict=predict)))
    return found, top, heading


def test_single_reference_is_unchanged():
    (pairs, *_), _, _ = trio(1)
    assert join_references([pairs], ["low"]) is pairs
    assert combine_references(pairs) == pairs


def test_combined_references_reduce_the_heading_error():
    ratios = []
    for seed in (1, 2, 3):
        found, top, heading = trio(seed)
        every = join_references(found, NAMES)
        assert len(every) == sum(map(len, found)) and not every.warnings
        assert (np.diff(every.time_s) >= 0.0).all() and every.reference_names == NAMES
        for k, own in enumerate(found):
            mine = take(every, every.reference_index == k)
            np.testing.assert_array_equal(mine.lower_east, own.lower_east)
        one = combine_references(every)
        seam = compare_at_seam(every, {"after": {"n": 0}})  # a time may occur more than once in ``every``
        assert seam == compare_at_seam(one, {"after": {"n": 0}}) and seam["speed_difference_sigma_m_s"] > 0.0
        assert len(one) == len(np.unique(every.time_s)) and one.reference_index is None
        ratios.append(error_deg(one, top, heading) / min(error_deg(pairs, top, heading) for pairs in found[:2]))
    assert np.median(ratios) < 0.8


def test_combination_bridges_gaps_and_preserves_rotations():
    found, *_ = trio(4)
    found[1] = take(found[1], slice(0, 800))
    one = combine_references(join_references(found, NAMES))
    assert len(one) == len(found[0])
    shift = 37.0 * np.sin(np.arange(len(one)))

    def by_heading(pairs):
        east, north = angles.turn(pairs.upper_east, pairs.upper_north, shift[np.searchsorted(one.time_s, pairs.time_s)])
        return replace(pairs, upper_east=east, upper_north=north)

    again = combine_references(join_references([by_heading(pairs) for pairs in found], NAMES))
    np.testing.assert_allclose(again.upper_east, by_heading(one).upper_east, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_consistent_references_give_no_warning(seed):
    assert not join_references(trio(seed)[0], NAMES).warnings


@pytest.mark.parametrize("name", NAMES)
def test_outlier_of_three_references_is_excluded(name):
    found, top, heading = trio(5, {name: 12.0})
    every = join_references(found, NAMES)
    (said,) = every.warnings
    assert f"{name} is left out" in said and "12 ± " in said
    assert NAMES.index(name) not in every.reference_index
    assert error_deg(combine_references(every), top, heading) < 3.0


def test_outlier_of_three_references_is_excluded_within_a_month():
    found, *_ = trio(5, {"mid": 25.0})
    every = join_references([take(pairs, slice(0, 720)) for pairs in found], NAMES)
    assert "mid is left out" in every.warnings[0] and set(every.reference_index) == {0, 2}


def test_second_file_of_a_recording_does_not_count():
    (low, mid, _), *_ = trio(7, {"low": 15.0})
    every = join_references([low, low, mid], ("low", "copy", "mid"))
    assert every.warnings[0] == "copy is left out: it is another file of the recording low"
    assert "cannot be determined" in every.warnings[1] and set(every.reference_index) == {0}


def test_references_that_differ_as_their_compasses_usually_do_are_all_used():
    found, *_ = trio(7, {"mid": -8.0})
    known = [replace(pairs, compass=ReferenceCompass("r", 3.0, 2.0)) for pairs in found[:2]]
    every = join_references(known, NAMES[:2])
    assert not every.doubts and "all are used" in every.warnings[0]
    assert 3.0 / np.sqrt(2.0) <= every.compass.sigma_deg <= 3.0  # by the weights, which follow from the noise


def test_reference_with_exchanged_components_is_left_out_of_several():
    flow = layers(5)
    top, _, _ = seen(MILD, flow, 5)
    meters = [
        instrument(x, -CELL_M, heading_deg=np.full(len(flow), np.nan)) for x in (flow[:, :1], 1j * np.conj(flow[:, :1]))
    ]
    found = [find_pairs(top, [meter], FIELD, ALL_NEAR, several=True) for meter in meters]
    every = join_references(found, NAMES[:2])
    assert "mid is left out" in every.warnings[0] and "east and north" in every.warnings[0]
    with pytest.raises(InputError, match="compromised and reference"):
        find_pairs(top, [meters[1]], FIELD, ALL_NEAR)


def test_first_of_two_contradictory_references_is_used():
    found, *_ = trio(7, {"mid": -10.0})
    every = join_references(found[:2], NAMES[:2])
    assert "cannot be determined" in every.warnings[0] and set(every.reference_index) == {0}
    assert every.doubts[0][0] == pytest.approx(10.0, abs=3.0)


def add_reference(file: Path) -> None:
    """Add an instrument ``other``, like ``deep``, to the references of a mooring file."""
    said = yaml.safe_load(file.read_text())
    said["instruments"]["other"] = copy.deepcopy(said["instruments"]["deep"]) | {"files": "raw/M1/other.csv"}
    said["reference"] = ["deep", "other"]
    file.write_text(yaml.safe_dump(said))


def test_list_of_references_runs_through_the_pipeline(tmp_path):
    cruise = sea.cruise(tmp_path / "cruise", n=400)  # too short for the search
    lines = (cruise / "raw/M1/deep.csv").read_text().splitlines()
    rows = [line.rsplit(",", 2) for line in lines[1:301]]
    noise = np.random.default_rng(1).normal(0.0, 0.5, (300, 2))
    noisy = zip(rows, noise, strict=True)
    other = [f"{first},{float(u) + a:.2f},{float(v) + b:.2f}" for (first, u, v), (a, b) in noisy]
    (cruise / "raw/M1/other.csv").write_text("\n".join([lines[0], *other]) + "\n")
    add_reference(cruise / "config/moorings/M1.yaml")
    lines = []
    folder = process_mooring(cruise, "M1", tmp_path / "out", lines.append)
    pairs = netcdf.read_pairs(folder / "overlap.nc")
    assert pairs.reference_names == ("deep", "other")
    assert np.bincount(pairs.reference_index).tolist() == [400, 300]
    assert any("(deep 400, other 300)" in line for line in lines)
    assert len(combine_references(pairs)) == 400
    file = cruise / "config/moorings/M1.yaml"
    file.write_text(file.read_text().replace("- other", "- deep"))
    with pytest.raises(InputError, match="each name once"):
        process_mooring(cruise, "M1", tmp_path / "again")


def test_contradictory_references_make_all_headings_doubtful(tmp_path):
    cruise = sea.cruise(tmp_path / "cruise", n=1400)
    add_reference(cruise / "config/moorings/M1.yaml")
    frame = pd.read_csv(cruise / "raw/M1/deep.csv")
    east, north = angles.turn(frame.u_cm_s, frame.v_cm_s, 40.0)
    frame.assign(u_cm_s=east, v_cm_s=north).round(2).to_csv(cruise / "raw/M1/other.csv", index=False)
    folder = chain.make(cruise, "M1", tmp_path / "out")
    product = netcdf.read_corrected(folder / "corrected.nc")
    known = np.isfinite(product.heading_corrected_deg)
    assert known.all() and (product.heading_corrected_quality == PROBABLY_BAD).all()
    assert (product.heading_uncertainty_deg > 35.0).all()
    assert read_json(folder / "diagnosis.json")["verdict"] == "unexplained"


@pytest.mark.parametrize(("kind", "flag", "source"), [(None, 1, "deep"), ("rotor", 1, "top"), ("rotor", 2, "deep")])
def test_a_fouled_rotor_yields_to_the_affected_instrument(tmp_path, kind, flag, source):
    """Its gain falls from 1 to 0.35 within 20 days; it hangs at the affected instrument's first bin, or below all."""
    folder, depth_m = sea.cruise(tmp_path / "c", n=2400), 90.0 if source == "top" or kind is None else 105.0
    table, settings = folder / "raw/M1/deep.csv", folder / "config/moorings/M1.yaml"
    rows = pd.read_csv(table).assign(depth_m=depth_m)
    speed = 0.01 * np.hypot(rows["u_cm_s"], rows["v_cm_s"]).to_numpy()
    for name in ("u_cm_s", "v_cm_s"):
        rows[name] *= np.interp(np.arange(2400), [960, 1440], [1.0, 0.35])
    rows.to_csv(table, index=False)
    content = yaml.safe_load(settings.read_text()) | {"diagnose": {"enabled": False}}
    content["instruments"]["deep"] |= {"depth": depth_m} | ({"kind": kind} if kind else {})
    settings.write_text(yaml.safe_dump(content))
    made = chain.make(folder, "M1", tmp_path / "out", gridded=True)
    with netCDF4.Dataset(made / "gridded.nc") as nc:
        level = int(np.argmin(np.abs(nc["DEPTH"][:] - depth_m)))
        u, v, quality, number = (nc[name][:, level] for name in ("UCUR", "VCUR", "UCUR_QC", "SOURCE"))
        names = nc["SOURCE"].flag_meanings.split()
    late = slice(1500, 2300)
    assert (quality[late] == flag).all() and (number[late] == names.index(source)).all()
    assert (number[:900] == names.index("deep")).all() and (quality[:900] == 1).all()
    ratio = np.hypot(u, v)[late].mean() / speed[late].mean()
    assert ratio == pytest.approx(1.0 if source == "top" else 0.35, abs=0.05)  # noise of 2 cm/s in 20 cm/s
    assert "the speeds of the reference fall to 0.3" in netcdf.read_pairs(made / "overlap.nc").warnings[0]
