"""Would catch a column, unit, date or flag of a table misread, or damage that passes for data."""

import re
import tracemalloc
from collections import Counter
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from compasslib.errors import InputError
from compasslib.readers import cells, delimited, read
from compasslib.readers.table import read_series
from compasslib.records import Record
from tests.world import tables

ROLES = {"time": "t", "depth": "z", "east": "u", "north": "v", "scale": 0.01}
PLAIN = {"time": "t", "east": "u", "north": "v"}
BEGIN_S = 1188864000.0  # 2007-09-04


def table(tmp_path: Path, text: str | bytes, columns: dict = ROLES, **settings) -> Record:
    path = tmp_path / "deep.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read("table", [path], {"columns": columns} | settings)


def refused(tmp_path: Path, text: str | bytes) -> str:
    with pytest.raises(InputError) as caught:
        table(tmp_path, text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 600
    return str(caught.value)


def test_roles_scale_missing_values_and_extra_columns(tmp_path):
    record = table(tmp_path, "t,z,extra,u,v\n2007-09-04T00:00:00Z,101,x,10,-5\n2007-09-04 01:00,102,y,,NaN\n")
    assert list(record.time_s) == [BEGIN_S, BEGIN_S + 3600.0]
    assert record.east[0, 0] == pytest.approx(0.1) and np.isnan(record.north[1, 0])
    assert {key: n for key, n in record.counts.items() if n} == {"rows": 2, "velocities_missing": 1}


def test_polar_and_body_frame_velocities_are_converted(tmp_path):
    record = table(tmp_path, "t,s,d\n2007-09-04,0.5,90\n", {"time": "t", "speed": "s", "direction": "d"})
    assert (record.east[0, 0], record.north[0, 0]) == pytest.approx((0.5, 0.0))
    columns = {"time": "t", "x": "x", "y": "y", "heading": "h", "tilt_x": None}
    record = table(tmp_path, "t,x,y,h\n2007-09-04,0.2,0.1,90\n2007-09-05,0.2,0.1,-90\n2007-09-06,0,1,9999\n", columns)
    assert record.east[:, 0] == pytest.approx([0.2, -0.2, np.nan], nan_ok=True)  # forward is east, then west
    assert record.north[:, 0] == pytest.approx([0.1, -0.1, np.nan], nan_ok=True)  # port is north, then south
    assert record.heading_deg == pytest.approx([90.0, 270.0, np.nan], nan_ok=True)
    assert record.counts["directions_impossible"] == 1


def test_rows_with_equal_times_are_bins(tmp_path):
    record = table(tmp_path, "t,z,u,v\n2007-09-04T00:00,10,1,1\n2007-09-04T00:00,14,2,2\n2007-09-04T01:00,11,3,3\n")
    assert record.east.shape == (2, 2) and np.isnan(record.east[1, 1])
    assert list(record.bin_depth_m()[0]) == [10.0, 14.0]


ROWS = "t,z,u,v\n" + "".join(f"2007-09-04T0{i}:00:00Z,100.5,{i}1.25,-{i}.75\n" for i in range(5))
AT, WORD = "2007-09-04T09:00:00Z,100.5,", "a number or nothing"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "column 't' (time): expected one of the file's columns, found an empty file"),
        ("t,z,u\n", "column 'v' (north): expected one of the file's columns, found t, z, u"),
        ("t,z,u,v\n2007-09-04,1,1,x7\n", "line 2, v: expected a number or nothing, found 'x7'; mend"),
        ("t,z,u,v\n4 Sept,1,1,1\n", "line 2, t: expected an ISO time like 2007-09-04T00:00:00Z, found '4 Sept'"),
        ("t,z,u,v\n2007-09-04,1,1\n", "line 2, v: expected a number or nothing, found a line of 3 cells"),
        (f"{ROWS}{AT}1,2,3\n", "line 7: expected 4 cells as in the header, found a line of 5 cells"),
        *((f"{ROWS}{AT}{cell},2\n", f"line 7, u: expected {WORD}, found '{cell}'; mend or remove the line{more}")
          for cell, more in (("inf", ", or write missing: ['inf']"), ("1e999", ", or write missing: ['1e999']"),
                             ("bad", ", or write missing: ['bad']"), ("1_0", ""), ("5%", ""))),
        (f'{ROWS}{AT}"1,234.5",2\n', "line 7, u: expected a number or nothing, found '1,234.5'; mend"),
        *((f"{ROWS}{time},100.5,1,2\n", "line 7, t: expected an ISO time")
          for time in ("2007-09", "", "2007-09-04T09:00:00+2", "2007-02-30")),
        (ROWS.encode() + b"\xff" * 100, "expected a text in UTF-8"),
        (b"\xff\xfe\x00\x01", "expected a text in UTF-8"),
        ("t,z,u,v\n2007-09-04T00:00Z,1," + "x" * 131_000 + ",2\n", "x ... (131002 characters); mend"),
    ],
)  # fmt: skip
def test_unreadable_table_is_refused_in_one_line(tmp_path, text, message):
    assert message in refused(tmp_path, text)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a readable file"):
        read("table", [tmp_path / "none.csv"], {"columns": ROLES})


@pytest.mark.parametrize(
    ("cells", "flags", "expected", "said"),
    [
        (("good_data", "Bad_data", ""), None, [1, 4, 0], ""),
        (("1", "4", "1"), None, [3, 3, 3], "column q: the meaning of the flags 1 (2 samples), 4 (1 samples)"),
        (("1", "4", "7"), {"good": ["1"], "bad": ["4"]}, [1, 4, 3], "flags 7 (1 samples)"),
        (("ok", "side lobe", "ok"), {"good": ["ok"], "bad": ["side_lobe"]}, [1, 4, 1], ""),
    ],
)
def test_flag_column_is_mapped_by_words_or_settings(tmp_path, cells, flags, expected, said):
    text = "t,u,v,q\n" + "".join(f"2007-09-04T0{k}:00:00Z,1,2,{cell}\n" for k, cell in enumerate(cells))
    record = table(tmp_path, text, PLAIN | {"flag": "q"}, flags=flags)
    assert record.quality.ravel().tolist() == expected
    assert (said in " ".join(record.warnings)) and ("not known" in " ".join(record.warnings)) == bool(said)


def test_truncated_table_loses_only_its_last_row(tmp_path):
    whole = table(tmp_path, ROWS)
    for cut in range(ROWS.index("\n2007-09-04T01") + 1, len(ROWS)):  # one row does not determine the decimals
        record = table(tmp_path, ROWS[:cut])
        n, started = len(record.time_s), ROWS[:cut].rstrip("\n").count("\n")
        # A line without its line break is complete only if no digit is missing.
        assert n == started - (ROWS[cut - 1] != "\n" and ROWS[cut] != "\n"), cut
        assert record.counts["rows"] == n + record.counts["rows_cut"]
        for name in ("time_s", "east", "north"):
            assert np.array_equal(getattr(record, name), getattr(whole, name)[:n])


def test_second_column_of_a_name_has_a_name_of_its_own(tmp_path):
    whole = table(tmp_path, ROWS)
    twice = table(tmp_path, ROWS.replace("t,z,u,v", "t,z,u,u"), ROLES | {"north": "u.2"})
    assert np.array_equal(whole.north, twice.north) and np.array_equal(whole.east, twice.east)
    assert "the first of the columns u, of which u.2 is the second" in twice.warnings[0]


def test_duplicate_rows_count_once_and_contradictory_rows_are_dropped(tmp_path):
    again, other = ROWS.splitlines()[2], ROWS.splitlines()[4].replace("31.25", "9.25")
    record = table(tmp_path, f"{ROWS}{again}\n{other}\n")
    assert record.east.shape == (4, 1)
    assert record.counts["rows_repeated"] == 1 and record.counts["rows_contradict"] == 2
    assert record.counts["rows"] == 4 + 1 + 2 and len(record.warnings) == 2


@pytest.mark.parametrize("filler", ["999", "-99.9", "9999.0", "-999"])
def test_fill_values_of_nines_are_missing(tmp_path, filler):
    record = table(tmp_path, ROWS + "".join(f"2007-09-05T0{i}:00:00Z,100.5,{filler},{filler}\n" for i in range(3)))
    assert record.counts["fillers"] == 3 and np.isnan(record.east[5:]).all() and np.isfinite(record.east[:5]).all()


def test_fill_value_of_one_row_is_missing(tmp_path):
    record = table(tmp_path, f"{ROWS}2007-09-05T01:00:00Z,100.5,-999.9,-999.9\n")
    assert record.counts["fillers"] == 1 and np.isnan(record.east[5:]).all() and np.isfinite(record.east[:5]).all()


HOURS = "2007 09 04 00 90 20\n2007 09 04 01 90 30\n"
FLOW = {"speed": 6, "direction": 5}


@pytest.mark.parametrize(
    ("above", "time"),
    [
        ("#YY MM DD hh DIR SPD\n#yr mo dy hr degT cm/s\n", ["#YY", "MM", "DD", "hh"]),  # as NDBC writes
        ("#YY MM DD hh DIR SPD\n#yr mo dy hr degT cm/s\n", [1, 2, 3, 4]),
        ("% of a mooring, in no units\n# yr mo dy hr degT cm/s\n", [1, 2, 3, 4]),
        ("yr mo dy hr degT cm/s\n", [1, 2, 3, 4]),
    ],
)
def test_units_above_columns_that_are_named_by_number_count(tmp_path, above, time):
    record = table(tmp_path, above + HOURS, {"time": time} | FLOW)
    assert record.east[:, 0] == pytest.approx([0.2, 0.3]) and record.direction_reference == "true"
    assert list(record.time_s) == [BEGIN_S, BEGIN_S + 3600.0]


def test_zone_that_is_no_offset_and_columns_without_time_are_refused(tmp_path):
    with pytest.raises(InputError, match="columns: expected the column of the time, or those of date and clock"):
        table(tmp_path, "u,v\n1,2\n", {"east": "u", "north": "v"})
    for zone in ("MET", "+1", "-8"):
        with pytest.raises(InputError, match="timezone: expected UTC, or an offset"):
            table(tmp_path, "t,u,v\n2007-09-04,1,2\n", PLAIN, timezone=zone)


def test_time_of_day_in_a_column_of_numbers_is_refused_with_advice(tmp_path):
    columns = {"time": 1, "east": 2, "north": 3}
    with pytest.raises(InputError, match="two columns: date and clock"):
        table(tmp_path, "ODF_HEADER,\n-- DATA --\n '04-SEP-2007 00:00:00.00' 1.0 2.0\n", columns, skip_rows=2)


@pytest.mark.parametrize(
    ("times", "seconds"),
    [
        (["2007-09-04T02:00:00+02:00", "2007-09-03T20:30-0430", "2007-09-04T02:00:00Z"], [0.0, 3600.0, 7200.0]),
        *(([f"2007-09-04T00:00:{k}{end}" for k in (59, 60)] + [f"2007-09-04T00:01:00{end}"], [59.0, 59.999, 60.0])
          for end in ("Z", ".00")),  # a leap second stays before the next minute
    ],
)  # fmt: skip
def test_utc_offset_and_leap_second_are_applied(tmp_path, times, seconds):
    record = table(tmp_path, "t,z,u,v\n" + "".join(f"{t},1,1,1\n" for t in times))
    assert record.time_s - BEGIN_S == pytest.approx(seconds, abs=1e-6) and record.east.shape == (3, 1)


@pytest.mark.parametrize("order", ["newest first", "no order", "level by level"])
def test_order_of_rows_does_not_change_the_record(tmp_path, order):
    stamps = np.arange("2007-09-04T00", "2007-09-05T00", dtype="datetime64[h]")
    rows = [f"{t}:00,{z},{k},{z}" for k, t in enumerate(stamps) for z in (10, 14)]
    by_level = sorted(rows, key=lambda row: row.split(",")[1])
    drawn = list(np.random.default_rng(1).permutation(rows))
    mixed = {"newest first": rows[::-1], "no order": drawn, "level by level": by_level}[order]
    plain, again = (table(tmp_path, "\n".join(["t,z,u,v", *each, ""])) for each in (rows, mixed))
    assert (plain.time_s == again.time_s).all()
    for record in (plain, again):
        flow = record.east[np.arange(24)[:, None], np.argsort(record.bin_depth_m(), axis=1)]
        assert (flow == 0.01 * np.arange(24)[:, None]).all()
        assert sorted(record.bin_depth_m()[3]) == [10.0, 14.0]
    warned = any("all were put in order" in warning for warning in again.warnings)
    assert warned == (order == "no order")


def test_few_backward_steps_keep_the_order_of_the_file(tmp_path):
    stamps = [f"2007-09-{d:02d}T00:00" for d in (4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 2)]
    record = table(tmp_path, "t,z,u,v\n" + "".join(f"{t},1,1,1\n" for t in stamps))
    assert np.diff(record.time_s)[-1] < 0.0


def test_endless_line_is_refused_and_carriage_returns_end_lines(tmp_path):
    """A sparse file of 1.5 GB of zeros, which once took 4.5 GB of memory, is refused with little memory."""
    path = tmp_path / "a.csv"
    with path.open("wb") as stream:
        stream.write(b"t,z,u,v\n")
        stream.truncate(1_500_000_000)
    tracemalloc.start()
    with pytest.raises(InputError, match="expected lines of less than 1 MB, found a longer one"):
        read("table", [path], {"columns": ROLES})
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    lines = ["t,z,u,v", *(f"2007-09-04T00:00:00Z,{k},1,2" for k in range(50_000))]
    assert table(tmp_path, "\r".join(lines)).counts["rows"] == 50_000


MARKS = [("'", "'"), ('"', '"'), ('="', '"')]


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("t u v", '"{}" {} {}'),
        ('"t" "u" "v"', '"{}" "{}" "{}"'),
        ("t, u, v", ' "{}", {}, {}'),
        ("t,u,v", '"""{}""",{},{}'),
        ("t,u,v", '=" {}",{},{}'),
        *((f"{a}t{b}{by}u{by}v", by.join([f"{a}{{}}{b}", "{}", "{}"])) for a, b in MARKS for by in ", \t"),
    ],
)
def test_quoted_times_are_read(tmp_path, header, row):
    rows = [row.format(f"2007-09-04 {h:02d}:00:00", h / 10, -h / 10) for h in range(24)]
    record = table(tmp_path, "\n".join([header, *rows, ""]), PLAIN)
    np.testing.assert_array_equal(record.time_s, BEGIN_S + 3600.0 * np.arange(24))
    np.testing.assert_array_equal(record.east[:, 0], np.arange(24) / 10)


@pytest.mark.parametrize("form", ["'%d.%m.%y %H'", "%d.%m.%y %H"])
def test_quotation_marks_in_a_time_format_are_optional(tmp_path, form):
    text = "t,u,v\n" + "".join(f"'04.09.07 {h:02d}',1.0,2.0\n" for h in range(24))
    np.testing.assert_array_equal(
        table(tmp_path, text, PLAIN, time_format=form).time_s, BEGIN_S + 3600.0 * np.arange(24)
    )


def test_covariate_is_sorted_without_gaps_and_contradictions(tmp_path):
    hours = {"03": 3, "01": 1, "02": 2, "04": ""}
    text = "at,A\n" + "".join(f"2007-09-04T{hour}:00Z,{value}\n" for hour, value in hours.items())
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "b.csv").write_text("at,A\n2007-09-04T01:00Z,1\n2007-09-04T02:00Z,9\n")
    files = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    time_s, value, _ = read_series({"files": files, "columns": {"time": "at", "value": "A", "date": None}})
    assert ((time_s - BEGIN_S) / 3600.0).tolist() == [1.0, 3.0] and value.tolist() == [1.0, 3.0]
    (tmp_path / "a.csv").write_text("at,A\n2007-09-04T01:00Z,\n")
    with pytest.raises(InputError, match="expected rows with a time and a value, found none"):
        read_series({"files": files[:1], "columns": {"time": "at", "value": "A"}})


FORMS = tables.VARIANTS | tables.drawn(seed=1, n=20)
OTHERS = [kind for kind in tables.KINDS if kind != "table"]
EACH = [("table", name) for name in FORMS] + [(OTHERS[k % len(OTHERS)], name) for k, name in enumerate(FORMS)]


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_table_is_read_correctly_or_refused_with_advice(tmp_path, kind, name):
    found, key = tables.outcome(Path(tmp_path, "table.csv"), FORMS[name], kind), tables.settled_by(FORMS[name])
    assert (found.startswith("refused") and key in found) if key else found == "right"


ODD = ("", "nan", "-9999", "1e5", "1.2.3", "--1", " 7", "7 ", "1,5", "-0")
ODD += (";", "\n", "\r", '"', "#", "é", "\0", "T", "/")
ODD += ("0.12345678901234567", "999999999999999999", "2007-09-31T00:00:00Z", "2007-09-04 00:00", "t;z;u;v\n", ",,,\n")


def damaged_table(rng: np.random.Generator) -> bytes:
    """Draw a table of plain rows in one of several formats, with up to three insertions, deletions or replacements."""
    cell, form = rng.choice([",", ";", "\t"]), rng.choice(["%sT%02d:00:00Z", "%s %02d:00", "%sT%02d:00:00.50"])
    rows = [[form % ("2007-09-04", k), *(f"{x:.{rng.integers(5)}f}" for x in rng.normal(0, 99, 3))] for k in range(24)]
    end = rng.choice(["\n", "\r\n"])
    text = end.join(cell.join(row) for row in (list("tzuv"), *rows)) + end
    for piece in rng.choice(ODD, rng.integers(4)):
        at, length = rng.integers(len(text)), rng.integers(4)
        text = text[:at] + str(piece) + text[at + length :]
    return text.encode()


def by_lines(text: str, delimiter: str) -> dict[str, list[float]] | None:
    """Read a damaged table line by line with the standard library, without lines that lack cells; None in any doubt."""
    lines = re.split("\r\n|\r|\n", text)
    rows = [
        line.split(delimiter) for line in lines[1:] if line.strip(f" {delimiter}") and line.lstrip()[:1] not in "#%"
    ]
    rows = [[cell.strip() for cell in row] for row in rows if delimiter.join(row) != lines[0] and len(row) >= 4]
    if lines[0].split(delimiter) != [*"tzuv"] or any(len(row) != 4 or not row[3] for row in rows) or '"' in text:
        return None
    try:
        times = [datetime.fromisoformat(row[0].replace("Z", "") + "+00:00").timestamp() for row in rows]
        values = [[float(cell) if cell not in ("", "-9999", "nan") else np.nan for cell in row[1:]] for row in rows]
    except ValueError:
        return None
    return {"time": times, **dict(zip(("depth", "east", "north"), map(list, zip(*values, strict=True)), strict=True))}


@pytest.mark.parametrize(("delimiter", "lost"), [(",", 1), (" ", 2)])
def test_lines_with_fewer_cells_than_the_others_are_left_out_and_counted(tmp_path, delimiter, lost):
    lines = [f"2007-09-04T{k:02d}:00:00Z,{k}.5,0.25,{k}".replace(",", delimiter) for k in range(20)]
    lines[7] = delimiter.join(cell for n, cell in enumerate(lines[7].split(delimiter)) if n != lost)
    record = table(tmp_path, "\n".join(["t,u,v,temp".replace(",", delimiter), *lines, ""]), PLAIN)
    assert len(record.time_s) == 19 and record.counts["rows_cut"] == 1
    assert "1 lines with fewer cells than the others were left out (line 9 first)" in " ".join(record.warnings)


def test_damaged_tables_are_read_as_line_by_line_or_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(cells, "split_rows", partial(cells.split_rows, size=200))
    monkeypatch.setattr(delimited, "split_rows", cells.split_rows)
    rng, headers, outcomes = np.random.default_rng(1), {k: v for k, v in ROLES.items() if k != "scale"}, Counter()
    for _ in range(300):
        data = damaged_table(rng)
        (tmp_path / "t.csv").write_bytes(data)
        text = data.decode()
        known = by_lines(text, text[1])
        try:
            found = delimited.read_table(tmp_path / "t.csv", headers, layout=delimited.Layout(missing=("-9999",)))
        except InputError:
            outcomes["refused though whole" if known else "refused"] += 1
            continue
        outcomes["read" if known else "read though doubtful"] += 1
        for role, values in (known or {}).items():
            assert np.array_equal(found.columns[role], values, equal_nan=True), (role, text)
    assert outcomes["read"] > 70 and outcomes["refused"] > 60
    assert outcomes["refused though whole"] + outcomes["read though doubtful"] < 10
