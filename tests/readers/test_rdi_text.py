"""Would catch columns of a WinADCP export confused, or another file taken for one."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from compasslib import readers
from compasslib.errors import InputError
from compasslib.records import MISSING, Record
from tests.world.rdi_text_files import BINS, CURRENTS, FIRST, HEADINGS, ROWS, SIZE, START, export


def read(path: Path, text: str, orientation: str | None = None) -> Record:
    path.write_bytes(text.encode("latin-1"))
    return readers.read("rdi_text", [path], {"orientation": orientation})


def refused(path: Path, text: str, orientation: str | None = None) -> str:
    with pytest.raises(InputError) as error:
        read(path, text, orientation)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("names", [("Eas", "Nor"), ("Mag", "Dir")])
def test_export_is_read_as_written(tmp_path, names):
    record = read(tmp_path / "a.txt", export(names))
    expected = CURRENTS / 1000.0
    expected[:, 1, -1] = np.nan
    np.testing.assert_allclose([record.east, record.north], expected, atol=1e-5)
    start = np.datetime64(START, "s").astype(float) + 0.17
    np.testing.assert_allclose(record.time_s, start + 3600.0 * np.arange(ROWS), atol=1e-6)
    np.testing.assert_allclose(record.bin_range_m[3], FIRST + SIZE * np.arange(BINS))
    np.testing.assert_allclose(record.heading_deg, HEADINGS)
    assert (record.roll_deg[0], record.temperature_c[0], record.depth_m[0]) == (-0.4, 7.3, 45.0)
    assert record.pitch_deg[0] == pytest.approx(1.2, abs=1e-3)
    assert record.looks_up and record.quality[1, -1] == MISSING and record.counts["velocities_missing"] == 1
    assert any("its middle is 300 s later" in line for line in record.warnings)  # 120 pings, five seconds apart


def with_rows(change: Callable[[list[str]], list[str]]) -> str:
    """Apply a function to the rows of an export, headers included."""
    return "\r\n".join(
        "\t".join(change(r)) if len(r := line.split("\t")) > 20 else line for line in export().split("\r\n")
    )


def test_columns_are_found_by_name_and_blank_cells_are_missing(tmp_path):
    spaced = read(tmp_path / "a.txt", with_rows(lambda row: [*row[:8], "", *row[8:]]))
    np.testing.assert_array_equal(spaced.heading_deg, HEADINGS)
    assert "of the same bins" in refused(tmp_path / "a.txt", with_rows(lambda row: row[:-1]))
    some = read(tmp_path / "a.txt", with_rows(lambda row: [*row[:17], *row[18:21], *row[22:]]))  # without bin 2
    np.testing.assert_allclose(some.bin_range_m[0], FIRST + SIZE * np.array([0.0, 2.0, 3.0]))
    assert read(tmp_path / "a.txt", export().replace("\t-32768", "\t")).counts["velocities_missing"] == 1


def test_orientation_comes_from_the_file_or_is_required(tmp_path):
    assert not read(tmp_path / "a.txt", export(orientation="Down")).looks_up
    assert "orientation: up or down" in refused(tmp_path / "a.txt", export(orientation=None))
    assert read(tmp_path / "a.txt", export(orientation=None), "up").looks_up


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("1st Bin Range (m)", "Range (m)", "1st Bin Range"),
        ("mm/s", "knots", "unit knots"),
        ("\t15\t8\t30\t", "\t15\t2\t30\t", "YR MO DA HH MM SS"),
        ("\t7.30\t", "\twarm\t", "line 16, Tem: expected a number"),
        ("\t45.0\tUp\t0\t160\t", "\t45.0\tUp\t0\t", "line 16, Ens: expected 24 cells"),
        ("\t", "   ", "of another text table write format: table"),
    ],
)
def test_invalid_export_is_refused_in_one_line(tmp_path, old, new, line):
    assert line in refused(tmp_path / "a.txt", export().replace(old, new))


def test_truncated_last_line_is_dropped_and_reported(tmp_path):
    record = read(tmp_path / "a.txt", export()[:-40])
    assert len(record.time_s) == ROWS - 1 and record.counts["rows_cut"] == 1
    assert any("truncated" in line for line in record.warnings)
