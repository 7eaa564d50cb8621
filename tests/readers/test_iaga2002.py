"""Would catch wrong components, fill values or damage in an observatory's files."""

from __future__ import annotations

import numpy as np
import pytest

from compasslib.calibrations import declination
from compasslib.errors import InputError
from compasslib.readers import iaga2002
from compasslib.records import take
from tests.world.iaga_files import header, rows, series, write
from tests.world.sea import SHARED

REAL = SHARED / "observatory"
DAY = series(1)
ROUNDED_DEG = 2e-5  # values are rounded to 0.01 nT, with a horizontal field of 17,000 nT


@pytest.mark.parametrize("letters", ["XYZF", "FXYZ", "HDZF", "DHZF", "DHIF", "DIHF"])
def test_every_order_of_components_gives_the_same_field(tmp_path, letters):
    found = iaga2002.read([write(tmp_path / "a.hor", DAY, letters)])
    # D is written in minutes of arc with two decimals.
    assert np.abs(found.declination_deg - DAY.declination_deg).max() < ROUNDED_DEG + 0.005 / 60.0
    assert np.allclose(found.horizontal_nT, DAY.horizontal_nT, atol=0.02)
    # An inclination rounded to 0.01 minutes of arc gives the vertical component to 0.05 nT.
    assert np.allclose(found.vertical_nT, DAY.vertical_nT, atol=0.1)
    assert np.array_equal(found.time_s, DAY.time_s)
    assert (found.station, found.latitude, found.longitude, found.elevation_m) == ("Made", 55.3, 356.8, 100.0)


def test_missing_values_become_nan(tmp_path):
    lines = rows(DAY, "XYZF")
    lines[3] = lines[3].replace(lines[3].split()[4], "99999.00")
    lines[5] = lines[5].replace(lines[5].split()[3], "88888.00")
    (tmp_path / "a.hor").write_text("\n".join([*header("XYZF"), *lines]))
    found = iaga2002.read([tmp_path / "a.hor"])
    assert list(np.flatnonzero(np.isnan(found.declination_deg))) == [3, 5]
    assert found.counts["missing"] == 2 and "2 rows have no declination" in found.warnings


def test_files_are_joined_in_time_and_repeats_count_once(tmp_path):
    two = series(2)
    half = take(two, slice(24, None))
    late = write(tmp_path / "b.hor", half, "DHZF")
    first = write(tmp_path / "a.hor", two, "XYZF", place=False)
    found = iaga2002.read([late, first])
    assert len(found) == 48 and (np.diff(found.time_s) == 3600.0).all()
    assert found.counts["repeated"] == 24 and found.latitude == 55.3
    assert "24 rows repeat an instant; the first of each counts" in found.warnings


@pytest.mark.parametrize(
    "bad",
    [
        "2003-03-01 05:30:00.000 061     17343.00  -1474.00  46197.00  99999.00",
        "2003-02-30 05:30:00.000 061     17343.00  -1474.00  46197.00  99999.00",
        "2003-03-01 25:30:00.000 060     17343.00  -1474.00  46197.00  99999.00",
        "2003-03-01 05:30:00.000 060     17343.00  -1474.00  46197.00",
        "2003-03-01 05:30:00.000 060     17343.00  -14x4.00  46197.00  99999.00",
        "\x00\x00\x1f",
    ],
    ids=["day of year", "30 February", "hour 25", "cut short", "letter in a number", "bytes"],
)
def test_damaged_row_is_counted_and_dropped(tmp_path, bad):
    lines = rows(DAY, "XYZF")
    (tmp_path / "a.hor").write_text("\n".join([*header("XYZF"), *lines[:5], bad, *lines[6:]]))
    found = iaga2002.read([tmp_path / "a.hor"])
    assert len(found) == 23 and found.counts["damaged"] == 1
    assert found.warnings[0].startswith("1 rows are damaged")


def edited(tmp_path, made, letters, edit):
    """Write a series after a function has changed its numbers, (k, 4), in place."""
    lines = rows(made, letters)
    cells = np.array([[float(cell) for cell in line.split()[3:]] for line in lines])
    edit(cells)
    lines = [f"{line[:27]}    " + " ".join(f"{x:9.2f}" for x in row) for line, row in zip(lines, cells, strict=True)]
    (tmp_path / "a.hor").write_text("\n".join([*header(letters), *lines]) + "\n")
    return tmp_path / "a.hor"


@pytest.mark.parametrize(("letters", "about_zero"), [("HDZF", (1,)), ("DHZF", (0, 1)), ("XYZF", (0, 1, 2))])
def test_variation_without_baseline_is_refused_as_declination(tmp_path, letters, about_zero):
    """It can be used as a covariate, whose offset is irrelevant, but not as a declination."""

    def varying(cells):
        for column in about_zero:
            cells[:, column] -= np.round(np.median(cells[:, column]))
        cells[:, 3] += 600.0  # F measured at another pillar

    said = []
    for columns in (letters, letters[:3] + "G"):
        found = iaga2002.read([edited(tmp_path, series(3), columns, varying)])
        assert np.isfinite(found.declination_deg).all()
        with pytest.raises(InputError) as error:
            declination.check_field(found, (found.latitude, found.longitude))
        said.append(str(error.value))
    assert said[0] == said[1] and "a variation about zero: the baseline is missing" in said[0]


def message(tmp_path, *texts) -> str:
    paths = [tmp_path / f"{k}.hor" for k in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    with pytest.raises(InputError) as error:
        iaga2002.read(paths)
    return str(error.value).replace(str(tmp_path), "")


def test_unusable_files_are_refused_in_one_line(tmp_path):
    whole = "\n".join([*header("XYZF"), *rows(DAY, "XYZF")])
    begins = "a header that begins with Format IAGA-2002 and ends with a line DATE"
    advice = "give IAGA-2002 files of one observatory"
    assert message(tmp_path, "") == f"/0.hor: expected {begins}, found nothing; {advice}"
    assert message(tmp_path, "time,u,v\n1,2,3\n") == f"/0.hor: expected {begins}, found 'time,u,v'; {advice}"
    assert "found 24 rows, none of them so" in message(tmp_path, whole.replace("2003-03-01", "2003-13-01"))
    assert "found HEZF in the line DATE; variations such as HEZ hold no direction" in message(
        tmp_path, "\n".join([*header("HEZF"), *rows(DAY, "HEZF")])
    )
    other = "\n".join([*header("XYZF", code="LER"), *rows(DAY, "XYZF")])
    assert message(tmp_path, whole, other) == f"/1.hor: expected station MDE as in /0.hor, found LER; {advice}"


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.min: expected a readable file, found No such file"):
        iaga2002.read([tmp_path / "a.min"])


@pytest.mark.skipif(not REAL.is_dir(), reason="no observatory files in ../shared/data")
def test_real_files_of_eskdalemuir_are_read():
    day = iaga2002.read([REAL / "esk20030610dmin.min"])
    assert (len(day), day.station, day.definitive) == (1440, "Eskdalemuir", True)
    assert (day.latitude, day.elevation_m) == (55.3, 245)
    # First row: X 17328.30, Y -1423.30.
    assert day.declination_deg[0] == pytest.approx(np.rad2deg(np.arctan2(-1423.30, 17328.30)))
    years = iaga2002.read(sorted(REAL.glob("*.hor")))
    assert len(years) == 24 * (366 + 365) and np.isnan(years.latitude) and years.station == "ESK"
    assert years.declination_deg[0] == pytest.approx(-504.70 / 60.0)  # 1980 gives D in minutes of arc
    assert (years.counts["damaged"], years.counts["repeated"], years.counts["missing"]) == (0, 0, 0)
