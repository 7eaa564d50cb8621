"""Would catch a mistake in a valid file that goes unsaid, and a hostile cruise folder that does harm."""

import os
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml

from compasslib import angles
from tests.world import chain
from tests.world.launch import PROJECT, environment, snakemake
from tests.world.sea import START, cruise

HOURS = 400
YAML, TOP, DEEP = Path("config/moorings/M1.yaml"), Path("raw/M1/top.000"), Path("raw/M1/deep.csv")
SET = START.replace(tzinfo=None)
Spoil = Callable[[Path], object]


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """Write a cruise of 17 days without faults."""
    folder = cruise(tmp_path_factory.mktemp("sound") / "c", n=HOURS)
    # The fast method and no search, to save time: the faults act before either.
    (folder / "config/config.yaml").write_text("{fit: {method: von_appen}, diagnose: {enabled: false}}\n")
    return folder


def spoilt(sound: Path, folder: Path, spoil: Spoil) -> Path:
    shutil.copytree(sound, folder / "c")
    spoil(folder / "c")
    return folder / "c"


def said(**keys: object) -> Spoil:
    """Return a function that sets keys of the mooring file; ``deep__columns__scale`` is a nested key."""

    def spoil(folder: Path) -> None:
        content = yaml.safe_load((folder / YAML).read_text())
        for path, value in keys.items():
            place = content["instruments"] if path.split("__")[0] in content["instruments"] else content
            for part in path.split("__")[:-1]:
                place = place[part]
            place[path.split("__")[-1]] = value
        (folder / YAML).write_text(yaml.safe_dump(content, sort_keys=False))

    return spoil


def table(change: Callable[[int, list[str]], list[str]]) -> Spoil:
    """Return a function that changes the rows of the reference instrument's table."""

    def spoil(folder: Path) -> None:
        head, *rows = (folder / DEEP).read_text().splitlines()
        rows = [",".join(change(i, row.split(","))) for i, row in enumerate(rows)]
        (folder / DEEP).write_text("\n".join([head, *rows]) + "\n")

    return spoil


def ensembles(folder: Path) -> list[bytes]:
    data = (folder / TOP).read_bytes()
    length = struct.unpack("<H", data[2:4])[0] + 2
    return [data[k : k + length] for k in range(0, len(data), length)]


def rewritten(ensemble: bytes, block: int, at: int, content: bytes) -> bytes:
    """Replace bytes of a block of an ensemble and update its checksum."""
    changed = bytearray(ensemble)
    begin = struct.unpack_from("<H", changed, 6 + 2 * block)[0] + at
    changed[begin : begin + len(content)] = content
    changed[-2:] = struct.pack("<H", sum(changed[:-2]) % 65536)
    return bytes(changed)


def at(ensemble: bytes, when: datetime) -> bytes:
    clock = bytes((when.year - 2000, *when.timetuple()[1:6], 0))
    return rewritten(rewritten(ensemble, 1, 4, clock), 1, 58, clock)


def recording(change: Callable[[int, bytes], bytes]) -> Spoil:
    """Return a function that changes the ensembles of the affected instrument's recording."""

    def spoil(folder: Path) -> None:
        (folder / TOP).write_bytes(b"".join(change(i, each) for i, each in enumerate(ensembles(folder))))

    return spoil


def clock(hours: Callable[[int], float]) -> Spoil:
    return recording(lambda i, each: at(each, SET + timedelta(hours=hours(i))))


def profiles(block: int, place: int, content: bytes) -> Spoil:
    return recording(lambda i, each: rewritten(each, block, place, content))


def unrelated(folder: Path) -> None:
    rng = np.random.default_rng(4)
    table(lambda i, row: [*row[:2], *(f"{x:.3f}" for x in rng.normal(0.0, 15.0, 2))])(folder)


def longitude_without_sign(folder: Path) -> None:
    """With true reference directions, drop the sign of the longitude: declination 12.5° E instead of 23.6° W."""

    def true(i: int, row: list[str]) -> list[str]:
        turned = angles.turn(float(row[2]), float(row[3]), -23.6)
        return [*row[:2], *(f"{x:.4f}" for x in turned)]

    table(true)(folder)
    said(longitude=32.955, deep__direction_reference="true")(folder)


def _blocks(whole: bytes) -> list[bytes]:
    begins = struct.unpack_from(f"<{whole[5]}H", whole, 6)
    return [whole[a:b] for a, b in zip(begins, [*begins[1:], len(whole) - 4], strict=True)]


def headings(centidegrees: Callable[[int, bytes], int]) -> Spoil:
    return recording(lambda i, each: rewritten(each, 1, 18, struct.pack("<H", centidegrees(i, each))))


def logged(whole: bytes) -> int:
    return struct.unpack_from("<H", whole, struct.unpack_from("<H", whole, 8)[0] + 18)[0]


def bytes_of(path: Path, change: Callable[[bytes], bytes]) -> Spoil:
    return lambda folder: (folder / path).write_bytes(change((folder / path).read_bytes()))


def backwards(folder: Path) -> None:
    """Turn the affected instrument by half a turn in its mount, its velocities too."""
    headings(lambda i, each: (logged(each) + 18000) % 36000)(folder)

    def turned(i: int, each: bytes) -> bytes:
        block = np.frombuffer(_blocks(each)[2][2:34], dtype="<i2").reshape(4, 4)
        return rewritten(each, 2, 2, (block * np.array([-1, -1, 1, 1], dtype="<i2")).tobytes())

    recording(turned)(folder)


def without_unit(scale: float) -> Spoil:
    """Return a function that takes the unit from the headers of the reference and sets a wrong scale."""

    def spoil(folder: Path) -> None:
        bytes_of(DEEP, lambda data: data.replace(b"_cm_s", b""))(folder)
        said(deep__columns__east="u", deep__columns__north="v", deep__columns__scale=scale)(folder)

    return spoil


# Each fault, and the text expected in the warnings of the summary or in the one-line error; those that flags of single
# samples tell are in preparation/test_plausibility.py.
FAULTS: dict[str, tuple[Spoil, str]] = {
    "instruments swapped": (said(compromised="deep", reference="top"), "affected instrument has no usable heading"),
    "files swapped": (said(top__files=str(DEEP)), "expected an RDI PD0 file, found a text table; write format: table"),
    "declination of the wrong sign": (said(declination=23.6), "off IGRF"),
    "declination taken out of one that has none": (
        said(deep__declination_applied=-23.6),
        "equal to minus the declination (-23.6°)",
    ),
    "mounted backwards": (backwards, "refute the correction"),
    "a magnetic reference called true": (said(deep__direction_reference="true"), "directions of the reference lack it"),
    "cm/s called mm/s": (without_unit(0.0001), "the unit or scale of one is wrong"),
    "cm/s of a header called m/s": (said(deep__columns__scale=1.0), "found cm_s; correct scale"),
    "unrelated water": (unrelated, "held-out pairs refute the correction"),
    "trusted clock off by three days": (
        said(deep__clock_offset_seconds=259200),
        "held-out pairs refute the correction",
    ),
    "clock that jumps ahead": (clock(lambda i: i + 48 * (i >= 150)), "recording paused, or the clock was set"),
    "depth against its column": (said(deep__depth=505), "column of depths starts at 105 m, the metadata say 505 m"),
    "no overlap in depth": (
        said(deep__depth=505, deep__columns={"time": "time_utc", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01}),
        "no two velocities are near enough in time and depth",
    ),
    "a year of NaN": (table(lambda i, row: [*row[:2], "NaN", "NaN"]), "reference instrument has no usable velocity"),
    "fillers": (
        table(lambda i, row: row if i % 4 else [*row[:2], "-99.9", "-99.9"]),
        "100 fill values (speeds of nines only, or powers of ten)",
    ),
    "a longitude that lost its sign": (longitude_without_sign, "differ by a constant of -3"),
    "the other way up": (said(top__orientation="down"), "400 of 400 ensembles say that they looked up; down counts"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_mistake_in_a_valid_file_is_reported(sound, tmp_path, fault):
    spoil, expected = FAULTS[fault]
    found = chain.run(spoilt(sound, tmp_path, spoil))
    line = found["error"] or found["warnings"]
    assert expected in line and "\n" not in line


HARMLESS = {
    "a table filled up with NUL": bytes_of(DEEP, lambda data: data + bytes(4096)),
    "a recording filled up with NUL": bytes_of(TOP, lambda data: data + bytes(4096)),
    "one that begins with half an ensemble": bytes_of(TOP, lambda data: data[100:194] + data),
    "given twice": said(top__files=[str(TOP), str(TOP)]),
    "depths as negative numbers": table(lambda i, row: [row[0], f"-{row[1]}", *row[2:]]),
}


@pytest.fixture(scope="module")
def whole(sound, tmp_path_factory):
    """Run the chain on the cruise without faults."""
    return chain.run(spoilt(sound, tmp_path_factory.mktemp("whole"), lambda folder: None))


@pytest.mark.parametrize("what", HARMLESS)
def test_harmless_changes_leave_the_product_unchanged(sound, whole, tmp_path, what):
    whole, other = whole["product"], chain.run(spoilt(sound, tmp_path, HARMLESS[what]))["product"]
    assert np.array_equal(whole.heading_corrected_deg, other.heading_corrected_deg)
    assert np.array_equal(whole.east, other.east) and np.array_equal(whole.velocity_quality, other.velocity_quality)


def test_correction_refuted_by_held_out_pairs_is_flagged(sound, tmp_path):
    product = chain.run(spoilt(sound, tmp_path, unrelated))["product"]
    corrected = np.isfinite(product.heading_corrected_deg)
    assert (product.heading_corrected_quality[corrected] == 3).all()
    assert (product.heading_uncertainty_deg[corrected] > 100.0).all() and (product.velocity_quality >= 3).all()


def test_cruise_without_faults_has_no_warnings(whole):
    left = [w for w in whole["warnings"].split(" | ") if "search was switched off" not in w and "tilt sensor" not in w]
    assert left == [] and whole["share_corrected"] == 1.0


def test_shell_metacharacters_in_file_names_are_harmless(sound, tmp_path):
    name = "raw/M1/$(touch pwned); `touch pwned` & 'x' *.000"
    folder = spoilt(sound, tmp_path, lambda there: shutil.move(there / TOP, there / name))
    said(top__files=name)(folder)
    ran = snakemake(folder, "results/M1/work/top.nc", anew=True)
    assert ran.returncode == 0 and (folder / "results/M1/work/top.nc").exists(), ran.stderr
    assert not list(tmp_path.rglob("pwned"))


def test_wrong_cell_count_in_a_header_is_refused(sound, tmp_path):
    """With 255 cells instead of four, the velocities of an ensemble cannot be decoded."""
    found = chain.run(spoilt(sound, tmp_path, profiles(0, 9, bytes([255]))))
    assert "raw/M1/top.000: expected" in found["error"]


def test_no_code_of_a_cruise_folder_is_executed(sound, tmp_path):
    folder = spoilt(sound, tmp_path, lambda there: None)
    bomb = f"open({str(tmp_path / 'pwned')!r}, 'w')\n"
    modules = ("netCDF4.py", "gsw.py", "scipy.py", "pandas.py")
    for name in ("compasslib/__init__.py", *modules, ".snakemake/scripts/gsw.py"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(bomb)
    ran = snakemake(folder, "results/M1/work/top.nc", anew=True)
    assert ran.returncode == 0 and not (tmp_path / "pwned").exists(), ran.stderr


@pytest.mark.parametrize("path", [TOP, DEEP])
def test_unreadable_raw_file_is_reported_in_one_line(sound, tmp_path, path):
    folder = spoilt(sound, tmp_path, lambda there: (there / path).chmod(0))
    said = chain.run(folder)["error"] if not os.access(folder / path, os.R_OK) else without_rights(folder)
    assert "Permission denied" in said and "\n" not in said.strip()


def without_rights(folder: Path) -> str:
    """Return the error of the chain when run by the superuser without the right to read all files."""
    give_up = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
    if not shutil.which("setpriv") or subprocess.run([*give_up, "true"], check=False).returncode:
        pytest.skip("this user may read everything")
    code = f"import pathlib; from tests.world import chain; print(chain.run(pathlib.Path({str(folder)!r}))['error'])"
    into = environment()
    return subprocess.run(
        [*give_up, sys.executable, "-c", code], env=into, capture_output=True, text=True, check=True
    ).stdout


def test_readme_names_existing_tests():
    text = (PROJECT / "tests/README.md").read_text()
    named = set(re.findall(r"`([\w/]+\.py)::(test_\w+)`", text))
    assert len(named) > 30
    for file, test in named:
        assert f"def {test}(" in (PROJECT / "tests" / file).read_text(), (file, test)
