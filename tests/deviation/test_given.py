"""Would catch given coefficients that are refitted, ready-made pairs read otherwise from a table than from MATLAB."""

import csv

import numpy as np
import pytest
from scipy.io import savemat

from compasslib import angles
from compasslib.calibrations.at_mooring import compass_from_coefficients
from compasslib.cli import main
from compasslib.deviation import deviation_json, fit_deviation
from compasslib.deviation.assessment import assess_correction
from compasslib.deviation.correction import correct
from compasslib.deviation.model import fit_from_json
from compasslib.deviation.series import fit_series
from compasslib.errors import InputError
from compasslib.preparation.pairs import match_ready_pairs
from compasslib.readers.matlab import PAIR_ROLES, read_ready_pairs
from compasslib.records import GOOD, PROBABLY_BAD
from tests.world import chain
from tests.world.launch import change
from tests.world.sea import MILD, cruise, field_of, pairs, record_of

SEEN, HEADING = pairs(n=400)
RECORD = record_of(SEEN)
LETTERS = dict(zip("ABCDE", MILD, strict=True))
COVARIANCE = (np.diag([0.01, 0.02, 0.02, 0.01, 0.01]) ** 2).tolist()


def rows_of(seen) -> dict[str, np.ndarray]:
    return {"time": seen.time_s, "heading": seen.heading_deg} | {role: getattr(seen, role) for role in PAIR_ROLES[2:]}


ROWS = rows_of(SEEN)


def test_given_coefficients_are_applied_without_a_refit():
    fit = compass_from_coefficients("exact", LETTERS, COVARIANCE, RECORD, SEEN)
    assert fit_deviation(fit.method, SEEN, fit) is fit and fit_from_json(deviation_json(fit, RECORD)).fixed
    product = correct(RECORD, fit, field_of(SEEN), SEEN)
    off = angles.difference(product.heading_corrected_deg, HEADING)
    assert angles.rms(off) < 2.0 and (product.heading_corrected_quality == GOOD).mean() > 0.97
    assert 0.5 < np.median(product.heading_uncertainty_deg) < 4.0
    verdict = assess_correction(SEEN, fit)
    assert verdict["after"]["n"] == len(SEEN) and verdict["after"]["rms_deg"] < verdict["before"]["rms_deg"]


@pytest.mark.parametrize(("by", "contradicted"), [(0.0, False), (0.02, False), (0.3, True)])
def test_coefficients_of_another_compass_are_contradicted_by_the_pairs(by, contradicted):
    """Regression test: for a compass 6° off, directions agreed within 26° rms, and all headings were flagged good."""
    given = {**LETTERS, "B": LETTERS["B"] + by}
    said = assess_correction(SEEN, compass_from_coefficients("exact", given, COVARIANCE, RECORD, SEEN))["refuted"]
    assert ("from the given one" in said) is contradicted


def test_without_covariance_headings_are_doubtful_with_uniform_sigma():
    fit = compass_from_coefficients("exact", LETTERS, None, RECORD, SEEN)
    again = fit_from_json(deviation_json(fit, RECORD))
    product = correct(RECORD, again, field_of(SEEN), SEEN)
    assert angles.rms(angles.difference(product.heading_corrected_deg, HEADING)) < 2.0
    assert (product.heading_corrected_quality == PROBABLY_BAD).all()
    assert product.heading_uncertainty_deg == pytest.approx(angles.UNIFORM_SIGMA_DEG)
    assert "without their covariance" in again.warnings[0]


def test_a_given_series_equals_the_fitted_one():
    fitted = fit_series(SEEN)
    letters = dict(zip("ABCDE", fitted.coefficients.tolist(), strict=True))
    fit = compass_from_coefficients("von_appen", letters, fitted.covariance.tolist(), RECORD, SEEN)
    assert (fit.method, fit.folded, fit.recorded_range_deg) == ("von_appen", fitted.folded, fitted.recorded_range_deg)
    products = [correct(RECORD, each, field_of(SEEN), SEEN) for each in (fit, fitted)]
    assert products[0].heading_corrected_deg == pytest.approx(products[1].heading_corrected_deg, nan_ok=True)
    assert fit_deviation("von_appen", SEEN, fit) is fit  # also on held-out pairs


def written(path, times, form="table", seen=SEEN):
    """Write the pairs as a table or MATLAB file, velocities in cm/s."""
    rows = {role: rows_of(seen)[role] * (100.0 if "_" in role else 1.0) for role in PAIR_ROLES} | {"time": times}
    if form == "mat":
        savemat(path, {f"v_{role}": column[:, None] for role, column in rows.items()})
    elif form == "mat 7.3":
        with pytest.importorskip("h5py", reason="no h5py").File(path, "w", userblock_size=512) as file:
            for role, column in rows.items():
                file[f"v_{role}"] = column[None]
    else:
        with path.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow([f"v_{role}" for role in PAIR_ROLES])
            writer.writerows(zip(*(rows[role] for role in PAIR_ROLES), strict=True))
    return path


COLUMNS = {role: f"v_{role}" for role in PAIR_ROLES}
DATENUM = SEEN.time_s / 86400.0 + 719529.0
ISO = np.array([np.datetime_as_string(np.datetime64(round(t), "s")) + "Z" for t in SEEN.time_s])


@pytest.mark.parametrize(
    ("name", "form", "times"), [("a.csv", "table", ISO), ("b.mat", "mat", SEEN.time_s), ("c.mat", "mat 7.3", DATENUM)]
)
def test_ready_made_pairs_of_tables_and_matlab_files_are_the_same(tmp_path, name, form, times):
    rows = read_ready_pairs(written(tmp_path / name, times, form), COLUMNS)
    matched = match_ready_pairs(rows, 0.01, RECORD, field_of(SEEN))
    assert len(matched) == len(SEEN) and not matched.warnings
    for part in ("time_s", "heading_deg", "upper_east", "lower_north"):
        assert getattr(matched, part) == pytest.approx(getattr(SEEN, part), abs=1e-4), part


@pytest.mark.parametrize(
    ("odd", "expected"),
    [
        ({"degrees": SEEN.heading_deg}, r"v_heading \(heading\): expected real numbers, found a structure"),
        (SEEN.heading_deg.reshape(20, 20), r"expected series of one length.* v_heading 20 x 20"),
        (np.zeros(10**7), "expected series of one length, 1 x n or n x 1, found v_time 400, v_heading 10000000"),
    ],
)
def test_matlab_variables_other_than_series_of_one_length_are_refused(tmp_path, odd, expected):
    rows = {f"v_{role}": column for role, column in ROWS.items()} | {"v_heading": odd}
    savemat(tmp_path / "a.mat", rows, do_compression=True)
    with pytest.raises(InputError, match=f"a.mat: {expected}"):
        read_ready_pairs(tmp_path / "a.mat", COLUMNS)


def test_errors_of_ready_made_pairs_are_one_line_or_a_warning(tmp_path):
    path = written(tmp_path / "a.mat", DATENUM, "mat")
    with pytest.raises(InputError, match=r"a.mat: speed \(heading\): expected one of its variables, found v_heading"):
        read_ready_pairs(path, COLUMNS | {"heading": "speed"})
    with pytest.raises(InputError, match=r"expected times as datenum or as seconds since 1970, found 5289\.0"):
        read_ready_pairs(written(tmp_path / "b.mat", DATENUM - 728000.0, "mat"), COLUMNS)
    (tmp_path / "c.mat").write_bytes(bytes(512) + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(InputError, match=r"expected a whole MATLAB file"):
        read_ready_pairs(tmp_path / "c.mat", COLUMNS)
    later = match_ready_pairs(ROWS | {"time": SEEN.time_s + 5.0 * 3600.0}, 1.0, RECORD, field_of(SEEN))
    assert len(later) == 395 and later.warnings[0] == "5 of 400 ready-made pairs lie at no usable sample of the record"
    turned = match_ready_pairs(ROWS | {"heading": SEEN.heading_deg + 40.0}, 1.0, RECORD, field_of(SEEN))
    assert "differ from the record's by 40° in the median" in turned.warnings[0]


def test_a_cruise_runs_on_ready_made_pairs_or_given_coefficients(tmp_path, capsys):
    cruise(tmp_path, ("M1", "M3"), n=400)
    ready_made = written(tmp_path / "raw/M1/pairs.csv", ISO, seen=pairs(n=400, seed=10)[0])
    files, none = tmp_path / "config/moorings", {"reference": None, "diagnose": {"enabled": False}}
    columns = COLUMNS | {"scale": 0.01}
    change(files / "M1.yaml", fit={"method": "pairs", "file": "raw/M1/pairs.csv", "columns": columns}, **none)
    change(files / "M3.yaml", fit={"method": "coefficients", "coefficients": LETTERS, "covariance": COVARIANCE}, **none)
    assert main(["check", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "with raw/M1/pairs.csv: 400 pairs over" in shown and "nothing is corrected" not in shown
    ready, given = (chain.run(tmp_path, name) for name in ("M1", "M3"))
    assert not (ready["error"] or given["error"])
    assert ready["fit"]["method"] == "exact" and ready["n_pairs"] == 400
    off = [ready["fit"]["coefficients"][k] - LETTERS[k] for k in "ABCDE"]
    assert np.max(np.abs(off)) < 0.15 and ready["rms_after_deg"] < ready["rms_before_deg"]
    assert given["fit"]["method"] == "coefficients" and given["n_pairs"] == 0 and given["share_corrected"] == 1.0
    assert given["fit"]["coefficients"] == pytest.approx(LETTERS)
    ready_made.write_text("time\n")
    assert main(["check", str(tmp_path)]) == 1
    shown = capsys.readouterr()
    assert "raw/M1/pairs.csv" in shown.err and "1 problem (stopped: M1)" in shown.out
