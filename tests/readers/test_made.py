"""Would catch a layout or format whose times, velocities, headings or flags are read as other values than it holds."""

import re

import numpy as np
import pytest
from scipy.io import savemat

from compasslib import readers
from compasslib.cli import main
from compasslib.readers.files import list_converted
from tests.world import made_files

DRAWN = [(kind, seed) for kind in made_files.KINDS for seed in (1, 2)]


@pytest.mark.parametrize(("kind", "seed"), DRAWN)
def test_made_file_is_read_as_it_was_written(tmp_path, kind, seed):
    form, suffix, cells, write, has_headings, has_flags = made_files.KINDS[kind]
    truth = made_files.draw(np.random.default_rng(seed), cells)
    path = tmp_path / f"made{suffix}"
    settings = {"orientation": None} | write(path, truth)
    record = readers.read(form, [path], settings)
    assert np.abs(record.time_s - truth.time_s).max() < 2e-3  # 1e-8 days are 0.9 ms
    assert np.abs(record.east - truth.east).max() < 1e-9 and np.abs(record.north - truth.north).max() < 1e-9
    if has_headings:
        assert np.abs((record.heading_deg - truth.heading + 180.0) % 360.0 - 180.0).max() < 1e-9
    assert (record.quality[:, 0] == (truth.flag if has_flags else 1)).all()


SAID = {  # lines of the draft; what the file does not say is DECIDE; other kinds are in test_wild.py
    "WinADCP": {"format: mat", "orientation: up", "declination_applied: DECIDE"},
    "rdradcp": {"format: mat", "orientation: down", "declination_applied: DECIDE"},
    "Aquadopp": {"format: nortek", "orientation: up", "declination_applied: DECIDE"},
    "Aquadopp profiler": {"format: nortek", "orientation: up"},
    "year and day of the year": {"format: table", "time: [YEAR, DAY_OF_YEAR]"},
    "units in a comment": {"format: table", "scale: 0.01"},
}


@pytest.mark.parametrize("kind", SAID)
def test_init_says_of_a_folder_what_its_files_say(tmp_path, capsys, kind):
    _, suffix, cells, write, *_ = made_files.KINDS[kind]
    (tmp_path / "raw").mkdir()
    write(tmp_path / f"raw/made{suffix}", made_files.draw(np.random.default_rng(3), cells))
    assert main(["init", str(tmp_path / "raw"), "--into", str(tmp_path), "--name", "M"]) == 0
    text = (tmp_path / "config/moorings/M.yaml").read_text()
    lines = {re.sub(r"\s+#.*", "", line).strip() for line in text.splitlines()}
    assert SAID[kind] <= lines and "left out" not in capsys.readouterr().err


def test_north_of_files_that_cannot_be_read_yet_is_asked_for(tmp_path, capsys):
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw/a.csv").write_text("time,u,v,heading\n39670.02,0.1,0.2,30.0\n39670.04,0.1,0.2,31.0\n")
    savemat(tmp_path / "raw/b.mat", {"t": np.arange(9.0), "u": np.ones(9), "v": np.ones(9)})
    assert main(["init", str(tmp_path / "raw"), "--into", str(tmp_path), "--name", "M"]) == 0
    text = "".join(path.read_text() for path in (tmp_path / "config/moorings").iterdir())
    assert text.count("direction_reference: DECIDE") == 2 and "time_format: DECIDE" in text


def test_files_of_a_conversion_are_inputs_beside_its_header(tmp_path):
    """A changed one would not be read again, nor be in the manifest."""
    (tmp_path / "raw").mkdir()
    made_files.KINDS["Aquadopp profiler"][3](tmp_path / "raw/made.hdr", made_files.draw(np.random.default_rng(3), 6))
    (tmp_path / "raw/made.prf").touch()
    assert list_converted("raw/made.hdr", tmp_path) == ["raw/made.sen", "raw/made.v1", "raw/made.v2", "raw/made.v3"]
    assert list_converted("raw/made.prf", tmp_path) == []


def test_recording_beside_its_conversion_is_drafted_once(tmp_path):
    (tmp_path / "raw").mkdir()
    made_files.KINDS["Aquadopp"][3](tmp_path / "raw/made.hdr", made_files.draw(np.random.default_rng(3)))
    (tmp_path / "raw/made.aqd").write_bytes(b"\xa5\x05\x18\x00AQD 9330" + bytes(range(200, 240)))
    main(["init", str(tmp_path / "raw"), "--into", str(tmp_path), "--name", "M"])
    assert "made.hdr" not in (tmp_path / "config/moorings/M.yaml").read_text()
