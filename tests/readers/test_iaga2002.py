"""Would catch wrong components, fill values or damage in an observatory's files."""

import numpy as np
import pytest

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


WHOLE = "\n".join([*header("XYZF"), *rows(DAY, "XYZF")])
ADVICE = "give IAGA-2002 files of one observatory"
BEGINS = "a header that begins with Format IAGA-2002 and ends with a line DATE"


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ([""], f"0.hor: expected {BEGINS}, found nothing; {ADVICE}"),
        (["time,u,v\n1,2,3\n"], f"0.hor: expected {BEGINS}, found 'time,u,v'; {ADVICE}"),
        ([WHOLE.replace("2003-03-01", "2003-13-01")], "found 24 rows, none of them so"),
        (
            ["\n".join([*header("HEZF"), *rows(DAY, "HEZF")])],
            "found HEZF in the line DATE; variations such as HEZ hold no",
        ),
        ([WHOLE, WHOLE.replace(" MDE ", " LER ")], f"0.hor, found LER; {ADVICE}"),
        ([], "expected a readable file, found No such file"),
    ],
)
def test_unusable_files_are_refused_in_one_line(tmp_path, texts, message):
    paths = [tmp_path / f"{k}.hor" for k in range(max(len(texts), 1))]
    for path, text in zip(paths, texts, strict=False):
        path.write_text(text)
    with pytest.raises(InputError) as error:
        iaga2002.read(paths)
    assert message in str(error.value) and "\n" not in str(error.value)


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
