"""Logged headings of an ACM against its magnetometer: the logger's algorithm, planted faults and a real log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compasslib.readers.mmp import compare_headings
from compasslib.readers.mmp import scans as mmp_scans
from compasslib.records import GOOD, PROBABLY_BAD
from tests.readers.test_mmp_acm import BINARY, TEXT, logged, read, text_file
from tests.world.sea import real


def changed(folder: Path, change) -> Path:
    scans = logged((30, 30))
    values = scans.values.copy()
    change(values)
    values[:, 0] %= 360.0
    return text_file(folder, replace(scans, values=np.round(values, 4)))


def about(record) -> list[str]:
    return [said for said in record.warnings if "HX HY HZ" in said]


def without_tilts(values: np.ndarray) -> None:
    values[:, 0] = np.rad2deg(np.arctan2(values[:, 4], values[:, 3]))


@pytest.mark.parametrize("change", [lambda values: None, without_tilts], ids=["as logged", "without tilt correction"])
def test_consistent_headings_are_not_flagged(tmp_path, change):
    record = read(changed(tmp_path, change))
    assert record.counts["heading_off_magnetometer"] == 0 and about(record) == []


def test_deviating_headings_are_flagged_with_their_currents(tmp_path):
    def change(values):
        values[[5, 12, 40], 0] += (9.0, -60.0, 180.0)

    record = read(changed(tmp_path, change))
    assert record.counts["heading_off_magnetometer"] == 3
    wrong = [4, 11, 38]  # the first scan of each profile is dropped
    assert list(np.flatnonzero(record.heading_quality == PROBABLY_BAD)) == wrong
    assert list(np.flatnonzero(record.quality[:, 0] == PROBABLY_BAD)) == wrong
    said = "3 of 58 logged headings stand more than 2 degrees off those of HX HY HZ TX TY and were flagged"
    assert about(record) == [said]


def test_constant_offset_is_reported_without_flags(tmp_path):
    def change(values):
        values[:, 0] -= 23.6

    record = read(changed(tmp_path, change))
    assert (record.heading_quality == GOOD).all()
    said = "the logged headings stand -23.6 degrees off those of HX HY HZ TX TY throughout"
    assert about(record) == [f"{said}: give it as declination_applied if the logger added it"]


def test_headings_unrelated_to_the_magnetometer_are_reported(tmp_path):
    def change(values):
        values[:, 3:6] = np.random.default_rng(3).normal(size=(60, 3))

    record = read(changed(tmp_path, change))
    assert (record.heading_quality == GOOD).all() and record.counts["heading_off_magnetometer"] > 50
    assert about(record)[0].endswith("one of the two is wrong, which is unknown")


@pytest.mark.parametrize("name", [TEXT, BINARY])
def test_real_log_agrees_and_a_planted_fault_is_found(name):
    values = mmp_scans.read_scans([real(name)]).values
    heading = values[:, 0].copy()
    sound = compare_headings(heading, values[:, 3:6], values[:, 1:3])
    assert sound.known == 17917 and not sound.off.any() and sound.warnings() == []
    assert abs(sound.constant_deg) < 0.05  # rounding of field and heading
    heading[3000:3100] = heading[2999]  # a compass stuck for 50 s while the meter turns by up to 12.6 degrees
    found = compare_headings(heading, values[:, 3:6], values[:, 1:3])
    assert 75 < found.off[3000:3100].sum() == found.off.sum()  # 77 scans differ from it by more than 2.2 degrees
