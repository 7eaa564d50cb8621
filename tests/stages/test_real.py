"""Would catch a real recording whose withheld correction is no longer named, or a control that names it."""

import pytest

from compasslib.stages import demonstration as real

RECORDINGS = {one.name: one for one in real.RECORDINGS}


def describe(name):
    return real.describe(RECORDINGS[name], RECORDINGS[name].diagnose())


@pytest.mark.parametrize("name", ["acm_2014_06_06", "eight_headings"])
def test_a_recording_that_decides_nothing_is_refused(name):
    made = describe(name)
    assert all(case["expected"] for case in made["cases"]) and not made["figures"]


def test_the_withheld_levelling_is_found_with_its_size():
    made = describe("acm_2013_07_24")
    first, complete, shifted = made["cases"]
    assert first["heldout_deg"] == pytest.approx([1.57, 0.01], abs=0.01)
    assert (first["verdict"], complete["verdict"], shifted["verdict"]) == ("explained", "consistent", "ambiguous")
    assert "hard iron" in shifted["conclusion"] and "tilt offset" in shifted["conclusion"]
    assert made["figures"] and all(case["expected"] for case in made["cases"])


def test_iron_stronger_than_the_earths_field_is_found_in_a_car():
    found, corrected = describe("car_circles")["cases"]
    assert "large deviation" not in corrected["conclusion"] and found["expected"] and corrected["expected"]
    assert found["heldout_deg"] == pytest.approx([9.2, 4.2], abs=0.3) and "large deviation" in found["conclusion"]


def test_all_numbers_come_with_their_sources_and_licences():
    sources = (real.FOLDER / "SOURCES.md").read_text()
    for one in real.RECORDINGS:
        assert one.file.stat().st_size <= 300_000
        assert one.kind == "platform" or one.file.name in sources
