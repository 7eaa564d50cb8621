"""Would catch a profiler of the opposite orientation unnoticed, or a sound one accused."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from compasslib.preparation.deployment import apply_deployment
from compasslib.readers import pd0
from tests.world.pd0_encoder import START, ensemble
from tests.world.sea import real

CELLS, CELL_CM, BIN1_CM = 30, 400, 600
NOISE = 45  # counts
DEPTH, BOTTOM = 60.0, 150.0  # m
SETTINGS = {
    "start_s": START.timestamp() - 1e5,
    "end_s": START.timestamp() + 1e6,
    "water_depth": BOTTOM,
    "latitude": 47.6,
    "nominal_depth": DEPTH,
}


def echo(*boundaries_m: float, faint: bool = False) -> bytes:
    """Encode an echo that decreases with range, with boundaries at the given ranges, 40 dB above the water."""
    away = BIN1_CM / 100.0 + CELL_CM / 100.0 * np.arange(CELLS)
    water = np.maximum(NOISE, 160.0 - (20.0 if faint else 1.0) * away)
    for boundary in boundaries_m:
        water = water + 90.0 * np.exp(-(((away - boundary) / 4.0) ** 2))
    return b"\x00\x03" + bytes(np.repeat(np.clip(water, 0, 255).astype(np.uint8), 4))


def recorded(folder: Path, *blocks: bytes, n: int = 60, word: str = "up"):
    """Simulate the record of a level profiler at 60 m, with its orientation from the metadata."""
    each = [
        ensemble(
            [[100 + i, 50, 0, 0]] * CELLS,
            fixed={"cell_cm": CELL_CM, "bin1_cm": BIN1_CM, "up": word == "up"},
            extra=blocks,
            number=i + 1,
            when=START + timedelta(hours=i),
            heading=600 * i,
            tilt1=10 * i,
            pressure=int(1000 * DEPTH) + 20 * i,
        )
        for i in range(n)
    ]
    (folder / "a.000").write_bytes(b"".join(each))
    read = pd0.read([folder / "a.000"], orientation=word, declination_applied=None, heading_alignment=None)
    return apply_deployment(read, **SETTINGS)


def told(record) -> list[str]:
    return [sentence for sentence in record.warnings if "echo" in sentence]


@pytest.mark.parametrize(("word", "at"), [("up", DEPTH), ("down", BOTTOM - DEPTH)])
def test_expected_boundary_is_counted_without_warning(tmp_path, word, at):
    record = recorded(tmp_path, echo(at), word=word)
    assert record.counts["echo_of_boundary"] == 60 and told(record) == [] and record.echo_range_m is None


def test_opposite_boundary_is_reported_with_both_distances(tmp_path):
    record = recorded(tmp_path, echo(BOTTOM - DEPTH), word="up")
    assert record.counts["echo_of_other_boundary"] == 60
    assert told(record) == [
        "60 samples show the echo of the bottom, 90 m away, and 0 that of the surface, 60 m away: it looked the other "
        "way; check orientation, depth and water_depth"
    ]


@pytest.mark.parametrize(
    ("blocks", "word"),
    [
        ((), "up"),  # no echo recorded
        ((echo(faint=True),), "up"),  # echo too faint to reach the surface
        ((b"\x00\x03" + b"\x78" * 4 * CELLS,), "up"),  # one value throughout
        ((echo(),), "down"),  # water heard to 100 m: too close to the bottom at 90 m
        ((echo(30.0),), "up"),  # an echo at 30 m, from neither boundary
    ],
)
def test_uninformative_echo_gives_no_warning(tmp_path, blocks, word):
    assert told(recorded(tmp_path, *blocks, word=word)) == []


@pytest.mark.parametrize(
    ("name", "word", "depth", "bottom"),
    [("eh2_20060530_20060717_0007m.000", "down", 7.0, 45.5), ("03160000.000", "up", 41.5, 200.0)],
)
def test_orientation_of_genuine_records_is_recognized(name, word, depth, bottom):
    read = pd0.read([real(f"pd0/{name}")], orientation=None, declination_applied=None, heading_alignment=None)
    settings = SETTINGS | {"nominal_depth": depth, "water_depth": bottom}
    settings |= {"start_s": read.time_s[0] + 43200.0 * (word == "down"), "end_s": read.time_s[-1]}
    right = apply_deployment(read, **settings)
    assert right.counts["echo_of_boundary"] > 0.99 * len(right.time_s) and told(right) == []
    wrong = apply_deployment(replace(read, looks_up=word != "up"), **settings)
    assert "it looked the other way" in told(wrong)[0]
