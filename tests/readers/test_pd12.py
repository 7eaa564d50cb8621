"""Would catch wrong values of telemetered ensembles, or lost and damaged ones that are not told."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from compasslib import angles, readers
from compasslib.errors import InputError
from compasslib.records import MISSING, Record
from tests.world.pd12_files import ensemble, framed
from tests.world.sea import real

START = datetime(2013, 7, 24, 1, 26, 16, tzinfo=UTC)  # day 24 is byte 18h, which modems escape
RNG = np.random.default_rng(3)
PROFILES = RNG.integers(-500, 500, (80, 3, 4))


def series(**choices: Any) -> list[bytes]:
    return [
        ensemble(79 + 2 * i, START + timedelta(hours=2 * i), (43.0 * i) % 360.0, PROFILES[i].tolist(), **choices)
        for i in range(len(PROFILES))
    ]


def read(path: Path, *parts: bytes, **settings: Any) -> Record:
    path.write_bytes(b"".join(parts))
    keys = {"orientation": "up", "bin_size": 20.0, "first_bin": 24.7} | settings
    return readers.read("pd12", [path], keys)


@pytest.mark.parametrize("wrapped", [framed, lambda ensembles: framed(ensembles, escape=False), b"".join])
def test_ensembles_are_decoded_from_any_frame(tmp_path, wrapped):
    record = read(tmp_path / "a.dat", wrapped(series()))
    np.testing.assert_array_equal(np.stack([record.east, record.north], axis=2), PROFILES[..., :2] / 1000.0)
    for k, name in ((2, "up"), (3, "error_velocity")):
        np.testing.assert_array_equal(record.profiles[name], (PROFILES[..., k] / 1000.0).astype(np.float32))
    np.testing.assert_array_equal(record.time_s, START.timestamp() + 7200.0 * np.arange(80))
    np.testing.assert_allclose(angles.difference(record.heading_deg, 43.0 * np.arange(80)), 0.0, atol=1e-9)
    np.testing.assert_allclose(record.bin_range_m[7], [24.7, 44.7, 64.7])
    assert (record.pitch_deg[0], record.roll_deg[0]) == (pytest.approx(-1.57, abs=1e-3), 0.13)
    assert (record.temperature_c[0], record.pressure_dbar[0]) == (3.65, 490.332)
    assert record.looks_up and record.counts["ensembles"] == 80 and record.counts["lost"] == 0


def test_missing_velocities_and_later_first_bins(tmp_path):
    late = ensemble(7, START, 10.0, [[-32768] * 4, [1, 2, 3, 4]], first=2)
    early = ensemble(5, START - timedelta(hours=1), 10.0, [[5, 6, 7, 8]] * 3)
    record = read(tmp_path / "a.dat", early, late)
    assert np.isnan(record.east[1, [0, 2]]).all() and record.east[1, 1] == 0.001
    assert record.quality[1].tolist()[::2] == [MISSING, MISSING]
    # Every second bin is sent: starting one bin later adds half the spacing to all ranges.
    np.testing.assert_allclose(record.bin_range_m[:, 0], [24.7, 34.7])


def test_lost_and_damaged_ensembles_are_counted_and_reported(tmp_path):
    parts = series()
    bad = bytearray(parts[5])
    bad[40] ^= 1
    no_date = ensemble(9999, START.replace(year=1900), 0.0, PROFILES[0].tolist())
    record = read(tmp_path / "a.dat", framed([*parts[:5], bytes(bad), *parts[6:], parts[8], no_date]))
    losses = ("damaged", "lost", "repeated", "bad_dates")
    assert record.counts["ensembles"] == 79 and [record.counts[key] for key in losses] == [1] * 4
    said = "\n".join(record.warnings)
    for line in ("places begin like", "ensembles are missing", "ensembles were sent more than once", "ensembles have"):
        assert f"1 {line}" in said


def test_ensemble_with_fewer_components_is_refused(tmp_path):
    body = bytearray(ensemble(1, START, 0.0, [[0] * 4])[:-4])  # without its last component
    body[2], body[31] = body[2] - 2, 0x2E
    with pytest.raises(InputError, match="command PO 1111"):
        read(tmp_path / "a.dat", bytes(body) + (sum(body) & 0xFFFF).to_bytes(2, "little"))


def test_genuine_file_agrees_with_an_independent_reading(tmp_path):
    """The independent reader did not undo escapes; the 854 ensembles that it found are equal here."""
    path = real("moored/papa_node59p1.dat")
    data, other = path.read_bytes(), np.load(path.with_suffix(".npz"))
    record = read(tmp_path / "a.dat", data)
    order = np.argsort(record.time_s)
    at = order[np.searchsorted(record.time_s[order], other["time"].astype("datetime64[s]").astype(float))]
    found = np.stack([record.east[at], record.north[at]], axis=2)
    np.testing.assert_allclose(found, other["vel"][..., :2], atol=1e-6)
    np.testing.assert_allclose(record.heading_deg[at], other["heading"], atol=1e-9)
    np.testing.assert_allclose(record.pressure_dbar[at], other["pressure"], atol=1e-9)
    counts = record.counts
    assert (len(at), counts["ensembles"], counts["escaped"]) == (854, 2528, 1695)
    marks = data.count(b"\x6e\x7f\x02\x01")  # length 258 bytes; one more mark is chance or has a damaged length
    assert counts["ensembles"] + counts["repeated"] + counts["damaged"] == marks + 1
