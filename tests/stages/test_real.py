"""Would catch a real recording whose withheld correction is no longer named, or a control that names it."""

import pytest

from compasslib.archive.files import read_json
from compasslib.stages import demonstration as real

RECORDINGS = {one.name: one for one in real.RECORDINGS}


def describe(name):
    return real.describe(RECORDINGS[name], RECORDINGS[name].diagnose())


@pytest.mark.parametrize("name", ["acm_2013_07_24", "acm_2014_06_06", "car_circles", "eight_headings"])
def test_recordings_end_as_expected(name):
    made = describe(name)
    assert all(case["expected"] for case in made["cases"])
    assert (not made["figures"]) == (made["cases"][0]["verdict"] == "insufficient")


def test_the_withheld_levelling_is_found_with_its_size():
    first, complete, shifted = describe("acm_2013_07_24")["cases"]
    assert first["heldout_deg"] == pytest.approx([1.57, 0.01], abs=0.01)
    assert (first["verdict"], complete["verdict"]) == ("explained", "consistent")
    assert (
        shifted["verdict"] == "ambiguous"
        and "hard iron" in shifted["conclusion"]
        and "tilt offset" in shifted["conclusion"]
    )


def test_iron_stronger_than_the_earths_field_is_found_in_a_car():
    found, corrected = describe("car_circles")["cases"]
    assert "large deviation" not in corrected["conclusion"]
    assert found["heldout_deg"] == pytest.approx([9.2, 4.2], abs=0.3) and "large deviation" in found["conclusion"]


def test_the_stored_storm_is_named_and_a_turned_sensor_is_not_one():
    storm, quiet, turned = read_json(real.FOLDER / "storm.json")["cases"]
    assert storm["conclusion"].startswith("field disturbance (>99") and quiet["verdict"] == "consistent"
    assert "50" in turned["conclusion"] and storm["expected"] and quiet["expected"] and turned["expected"]


def test_all_numbers_come_with_their_sources_and_licences():
    sources = (real.FOLDER / "SOURCES.md").read_text()
    for one in real.RECORDINGS:
        assert one.file.stat().st_size <= 300_000
        assert one.kind == "platform" or one.file.name in sources
