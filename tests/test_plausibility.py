"""What parses and is impossible: every count and sentence of it reaches the record, the summary and the report."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path

import chain
import numpy as np
import pytest
from sea import cruise
from test_deployment import LONG, turning
from test_grid_overlap import HOUR

from compasslib import archive, config, deployment, report, stages, summary
from compasslib.records import BAD, PROBABLY_BAD
from compasslib.report import words

N = 60


def changed(name: str, where, value):
    column = np.array(getattr(turning(), name), dtype=float)
    column[where] = value
    return replace(turning(), **{name: column})


def echoes(*row: float):
    return replace(turning(), echo_range_m=np.tile(np.array(row), (N, 1)))


# What is done to a good record of 60 hours in 500 m of water, its instrument at 100 m: the count that tells of it.
FAULTS = {
    "impossible_speed": (changed("east", (7, 1), 30.0), 1),
    "steep_tilt": (changed("pitch_deg", slice(5, 9), 90.0), 12),
    "impossible_depth": (changed("depth_m", slice(None), np.linspace(90.0, 900.0, N)), 66),
    "bins_without_length": (changed("bin_range_m", 3, 10.0), 3),
    "frozen_velocity": (changed("east", slice(None), 0.123), 180),
    "heading_stuck": (changed("heading_deg", slice(20, 40), 33.0 + 0.02 * np.arange(20)), 19),
    "heading_frozen": (changed("heading_deg", slice(None), 33.0), 60),
    "heading_narrow": (changed("heading_deg", slice(None), 33.0 + np.arange(N) % 4), 60),
    "tilt_frozen": (replace(turning(), pitch_deg=np.full(N, 3.0), roll_deg=np.full(N, 1.0)), 60),
    "time_wild": (changed("time_s", 9, 1e9), 1),
    "clock_unsure": (changed("time_s", slice(30, None), HOUR * np.arange(5, 35)), 30),
    "time_backwards": (changed("time_s", [4, 5], [5 * HOUR, 4 * HOUR]), 1),
    "time_repeated": (changed("time_s", 5, 4 * HOUR), 1),
    "outside_deployment": (changed("time_s", slice(20, None), 1e9 + HOUR * np.arange(40)), 40),
    "echo_of_other_boundary": (echoes(400.0, 450.0), 60),
    "echo_without_boundary": (echoes(np.nan, 200.0), 60),
}


def settled(fault: str):
    return deployment.settle(FAULTS[fault][0], **LONG)


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_counted_and_said(fault):
    record, number = settled(fault), FAULTS[fault][1]
    assert record.counts[fault] == number
    throughout = ("all the time", "never change", "all headings")
    assert any(word in said for said in record.warnings for word in (f"{number} ", *throughout)), record.warnings


def test_no_count_of_the_deployment_is_without_its_fault():
    quiet = {"side_lobe", "beyond_boundary", "excluded", "echo_of_boundary"}  # the sea's and the user's own
    assert set(deployment.settle(echoes(100.0, 110.0), **LONG).counts) == {*FAULTS, *quiet}


def test_a_meter_that_shows_one_velocity_from_first_to_last_is_bad_and_still_water_is_not():
    assert (settled("frozen_velocity").quality[1:] == BAD).all()
    still = replace(turning(), east=np.zeros((N, 3)), north=np.zeros((N, 3)))
    assert deployment.settle(still, **LONG).counts["frozen_velocity"] == 0


def test_a_compass_that_only_trembles_is_stuck():
    assert list(np.flatnonzero(settled("heading_stuck").heading_quality == PROBABLY_BAD)) == list(range(21, 40))


def test_all_of_it_reaches_summary_and_report(tmp_path):
    """Each faulty record stands beside those of a small mooring, as one of its instruments."""
    folder = cruise(tmp_path / "c", n=40)
    (folder / "config/config.yaml").write_text("{fit: {method: von_appen}, diagnose: {enabled: false}}\n")
    assert chain.run(folder)["error"] is None
    results, records = folder / "results", {fault: settled(fault) for fault in FAULTS}
    for fault, record in records.items():
        archive.write_record(results / f"M1/work/{fault}.nc", record)
    row = summary.row("M1", results / "M1")
    summary.write(results / "summary.csv", [row])
    described = stages.plan(config.load(folder), Path()).described()
    described["M1"]["roles"] = [*described["M1"]["roles"], *FAULTS]
    made = report.gather(results, attributes={}, moorings=described, calibrations=[])
    report.write(results / "report.html", made)
    page = html.unescape((results / "report.html").read_text())
    for fault, record in records.items():
        assert record.warnings
        for said in record.warnings:
            assert f"{fault}: {said}" in row["warnings"].split(" | ") and f"{fault}: {said}" in page
    counted = next(t for section in made.moorings.sections for t in section.tables if t.caption.startswith("Inputs"))
    shown = {row[0]: dict(zip(counted.header, row, strict=True)) for row in counted.rows}
    for fault, (_, number) in FAULTS.items():
        assert shown[words.plain(fault)][fault] == str(number)
