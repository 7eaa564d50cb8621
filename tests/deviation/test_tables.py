"""Would catch a table that does not invert the compass, wrong counts, intervals too narrow for correlated pairs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from compasslib import angles, compass
from compasslib.archive import summary
from compasslib.archive.files import read_csv
from compasslib.deviation.assessment import (
    BIN_DEG,
    QUANTITIES,
    assess_correction,
    build_histograms,
    confidence_intervals,
)
from compasslib.deviation.correction import LOOKUP_COLUMNS, tabulate_deviation
from compasslib.deviation.doubts import doubt_whole_record
from compasslib.deviation.model import DeviationFit, estimate_safe_distance, unfitted
from compasslib.deviation.series import fit_series, series_deviation
from compasslib.records import BAD
from tests.world.sea import FOLDED, MILD, pairs, record_of


def exact(coefficients) -> DeviationFit:
    covariance = np.diag([0.02, 0.04, 0.04, 0.01, 0.01]) ** 2
    return DeviationFit("exact", 600, np.array(coefficients), covariance, folded=coefficients is FOLDED)


@pytest.mark.parametrize("coefficients", [MILD, FOLDED])
def test_the_table_inverts_the_compass_at_every_reachable_degree(coefficients, tmp_path):
    fit = exact(coefficients)
    summary.write_lookup(tmp_path / "table.csv", tabulate_deviation(fit))
    table = read_csv(tmp_path / "table.csv")
    assert tuple(table) == LOOKUP_COLUMNS
    back = compass.recorded_heading(coefficients, table["corrected_deg"])
    assert angles.rms(angles.difference(back, table["recorded_deg"])) < 0.002
    assert angles.rms(angles.difference(table["recorded_deg"] + table["deviation_deg"], table["corrected_deg"])) < 0.001
    low, high = compass.recorded_range(coefficients)
    reachable = [degree for degree in range(360) if (degree - low) % 360.0 <= high - low]
    roots = {degree: list(table["root"][table["recorded_deg"] == degree]) for degree in range(360)}
    assert roots == {degree: [1.0, 2.0][: 2 if fit.folded else 1] if degree in reachable else [] for degree in roots}
    slope = compass.slope(coefficients, table["corrected_deg"])
    assert (slope[table["root"] == 1] > 0.0).all() and (slope[table["root"] == 2] < 0.0).all()
    assert (table["sigma_deg"] > 0.0).all()


def test_table_of_a_series_includes_doubts_of_the_whole_record():
    fit = fit_series(pairs(n=600)[0])
    table = tabulate_deviation(fit)
    assert len(table["root"]) == 360 and (table["root"] == 1).all()
    recorded = angles.wrap360(table["corrected_deg"] - series_deviation(fit.coefficients, table["corrected_deg"]))
    assert angles.rms(angles.difference(recorded, table["recorded_deg"])) < 0.5
    doubts = [doubt_whole_record(20.0, "why"), replace(doubt_whole_record(9.0, ""), to_s=1.0)]
    doubted = tabulate_deviation(fit, 3.0, doubts)
    assert doubted["sigma_deg"] == pytest.approx(np.sqrt(table["sigma_deg"] ** 2 + 409.0))
    assert not tabulate_deviation(unfitted("exact", 5))["root"].size


def test_histograms_count_finite_values_in_bins_of_five_degrees(tmp_path):
    seen, heading = pairs(n=600)
    record = replace(record_of(seen), heading_quality=np.where(np.arange(600) < 7, BAD, 1).astype(np.int8))
    heading[:11] = np.nan
    verdict = assess_correction(seen, unfitted("exact", 600))
    summary.write_histograms(tmp_path / "a.csv", build_histograms(record, heading, seen, verdict["difference_counts"]))
    counts = summary.read_histograms(tmp_path / "a.csv")
    assert [int(counts[name].sum()) for name in QUANTITIES] == [593, 589, 600, 589, 600, 600, 0]
    upper = angles.direction(seen.upper_east, seen.upper_north)
    off = angles.difference(upper, angles.direction(seen.lower_east, seen.lower_north))
    edges = -180.0 + BIN_DEG * np.arange(73)
    assert (counts["difference_before"] == np.histogram(off, edges)[0]).all()
    assert (counts["heading_recorded"] == np.histogram(seen.heading_deg[7:], edges + 180.0)[0]).all()
    turned = angles.difference(heading, seen.heading_deg) + upper
    assert (counts["direction_corrected"] == np.histogram(angles.wrap360(turned[11:]), edges + 180.0)[0]).all()


def test_confidence_intervals_cover_with_autocorrelated_differences():
    """95 % intervals of 200 series with a memory of ten hours contain the truth in at least 90 %."""
    rng, n, time_s = np.random.default_rng(1), 1000, 3600.0 * np.arange(1000)
    truth = {"mean_deg": 3.0, "rms_deg": np.hypot(10.0, 3.0), "median_absolute_deg": 7.06}
    held = dict.fromkeys(truth, 0)
    for white in rng.normal(size=(200, n + 200)):
        off = 3.0 + 10.0 * lfilter([np.sqrt(1.0 - 0.9**2)], [1.0, -0.9], white)[200:]
        intervals = confidence_intervals(off, time_s)
        held = {name: k + (intervals[name][0] <= truth[name] <= intervals[name][1]) for name, k in held.items()}
    assert all(count >= 180 for count in held.values()), held


def test_currents_of_the_pairs_have_their_mean_and_principal_axes():
    seen, _ = pairs(n=900)
    along, across = np.random.default_rng(2).normal(size=(2, 900))
    east, north = angles.turn(0.05 * across, 0.2 * along + 0.1, 30.0)
    current = assess_correction(replace(seen, lower_east=east, lower_north=north), unfitted("exact", 900))["currents"]
    reference = current["reference"]
    assert current["corrected"] is None and reference["n"] == 900
    assert abs(angles.difference(2 * reference["major_towards_deg"], 60.0)) < 4.0  # an axis has two ends
    assert [reference[name] for name in ("major_m_s", "minor_m_s")] == pytest.approx([0.2, 0.05], rel=0.06)
    assert [reference[name] for name in ("east_m_s", "north_m_s")] == pytest.approx(
        [east.mean(), north.mean()], abs=1e-6
    )


def test_deviation_falls_with_the_cube_of_distance_within_bounds():
    fit = replace(exact([0.02, 0.6, 0.8, 0.0, 0.0]), covariance=np.diag([0.0, 0.01, 0.01, 0.0, 0.0]) ** 2)
    block = estimate_safe_distance(fit, (0.4, 0.6))
    assert block["relative_field"] == pytest.approx(1.0) and block["relative_field_sigma"] == pytest.approx(0.01)
    rows = {row["m"]: row["deviation_deg"] for row in block["distances"]}
    assert min(rows) == 0.75 and rows[0.75][1] == 180.0  # twice the field at 0.8 of the distance exceeds the earth's
    low, high = (0.5 * (1.0 - 0.0196) * 0.2**3, 2.0 * (1.0 + 0.0196) * 0.3**3)
    assert rows[2.0] == pytest.approx(np.rad2deg(np.arcsin([low, high])), rel=1e-4)
    assert estimate_safe_distance(fit, None) is estimate_safe_distance(fit_series(pairs(n=99)[0]), (1, 1)) is None
