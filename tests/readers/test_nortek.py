"""Would catch values unlike mhkit's or an independent reading, and damage that costs more than its sample."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compasslib.errors import InputError
from compasslib.readers import nortek
from compasslib.readers.nortek.packets import find_packets
from compasslib.records import BAD, GOOD, MAGNETOMETER
from tests.world import nortek_encoder as encoder
from tests.world.nortek_encoder import BEAM, ENU, XYZ, Sample
from tests.world.sea import SHARED, mhkit

GENUINE = SHARED / "moored/aqd9330.aqd"
FIELDS = {"heading": "heading_deg", "pitch": "pitch_deg", "roll": "roll_deg", "pressure": "pressure_dbar"}
FIELDS |= {"temperature": "temperature_c", "volts": "supply_voltage"}


def drawn(beams: int = 3, cells: int = 5, n: int = 30, **fields) -> list[Sample]:
    rng = np.random.default_rng(4)
    angles = [np.round(rng.normal(0.0, 5.0, n), 1) for _ in range(2)]
    heading = np.round(rng.uniform(0.0, 359.9, n), 1)
    return [
        Sample(k, rng.integers(-900, 900, (beams, cells)) / 1000.0, heading[k], angles[0][k], angles[1][k], **fields)
        for k in range(n)
    ]


def of_older(samples: list[Sample], coordinates: int = ENU, kind: int = 0x20, **configured) -> bytes:
    cells = samples[0].velocity.shape[1]
    return encoder.configuration(coordinates, cells, **configured) + b"".join(encoder.older(s, kind) for s in samples)


def of_signature(samples: list[Sample], coordinates: int = BEAM, **said) -> bytes:
    return encoder.text(**said) + b"".join(encoder.signature(sample, coordinates) for sample in samples)


def read(folder: Path, data: bytes, name: str = "meter.wpr", **keys):
    path = folder / name
    path.write_bytes(data)
    return nortek.read([path], **keys)


def refused(folder: Path, data: bytes, **keys) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, data, **keys)
    return str(caught.value)


def by_mhkit(path: Path):
    """Read a file with mhkit, which leaves an index file, and rotate it to earth coordinates."""
    with mhkit() as dolfyn:
        found = dolfyn.read(str(path), userdata=False)
        if found.coord_sys != "earth" and found.inst_model != "Aquadopp":  # mhkit has no rotation for it
            dolfyn.rotate2(found, "earth", inplace=True)
    return found


def xform(sample: Sample, down: bool) -> np.ndarray:
    """Compute the matrix from x, y, z to east, north, up, as in Nortek's Xform.m."""
    hh, pp, rr = np.deg2rad([sample.heading - 90.0, sample.pitch, sample.roll])
    (ch, cp, cr), (sh, sp, sr) = np.cos([hh, pp, rr]), np.sin([hh, pp, rr])
    h = np.array([[ch, sh, 0], [-sh, ch, 0], [0, 0, 1]])
    p = np.array([[cp, -sp * sr, -cr * sp], [0, cr, -sr], [sp, sr * cp, cp * cr]])
    return h @ p @ np.diag([1, -1, -1] if down else [1, 1, 1])


def turned(sample: Sample, down: bool) -> np.ndarray:
    """Rotate x, y, z to east and north, (2, cells)."""
    return (xform(sample, down) @ sample.velocity)[:2]


@pytest.mark.skipif(not GENUINE.exists(), reason=f"{GENUINE} is not there")
def test_genuine_aquadopp_agrees_with_an_independent_reader():
    record, known = nortek.read([GENUINE], serial_number="9330"), np.load(GENUINE.with_suffix(".npz"))
    assert (record.time_s == known["time"].astype("M8[s]").astype(float)).all()
    for theirs, ours in FIELDS.items():
        assert (getattr(record, ours) == known[theirs]).all(), theirs
    assert (np.column_stack([record.east, record.north]) == known["vel"][:, :2]).all()
    found = find_packets(GENUINE)
    assert int((found.end - found.start).sum()) == GENUINE.stat().st_size == record.counts["bytes_total"]
    assert record.counts["diagnostic_samples"] == 20080 and record.counts["bytes_skipped"] == 0
    assert ((record.quality[:, 0] == BAD) == (known["status"] & 0x0C > 0)).all()  # tilted out of range on deck
    assert (record.manufacturer, record.serial_number) == ("Nortek", "AQD 9330") and record.looks_up
    assert record.warnings == (
        "Each sample is the mean of 120 s from its time on: its middle is 60 s later; clock_offset_seconds: -60 moves "
        "it there.",
    )


@pytest.mark.parametrize("coordinates", [ENU, XYZ, BEAM])
@pytest.mark.parametrize("down", [False, True])
def test_profiles_agree_with_mhkit_in_all_coordinates(tmp_path, coordinates, down):
    """Except older down-lookers, whose y and z mhkit does not invert, and Aquadopps, which it does not rotate."""
    four, three = drawn(4, down=down), drawn(down=down)
    if coordinates == BEAM:  # mhkit does not map the bins of tilted beams
        four, three = ([replace(sample, pitch=0.0, roll=0.0) for sample in each] for each in (four, three))
    files = {
        "meter.ad2cp": of_signature(four, coordinates),
        "meter.wpr": of_older(three, coordinates),
        "meter.prf": of_older(three, coordinates, kind=0x21, serial="AQD 1234"),
    }
    for name, data in files.items():
        record, theirs = read(tmp_path, data, name), by_mhkit(tmp_path / name)
        tag = "_avg" if name.endswith("ad2cp") else ""
        assert len(record.time_s) == 30 and record.looks_up is not down
        at = np.searchsorted(record.time_s, theirs[f"time{tag}"].values.astype("i8") / 1e9)
        assert len(at) >= 29  # mhkit drops the first sample of an older file
        assert np.abs(record.bin_range_m[0] - theirs[f"range{tag}"].values).max() < 1e-6
        for field, ours in {"heading": record.heading_deg, "pitch": record.pitch_deg, "roll": record.roll_deg}.items():
            assert np.abs(ours[at] - theirs[f"{field}{tag}"].values).max() < 1e-4  # float32
        if coordinates == ENU or tag or not (down or name.endswith("prf")):
            velocity = theirs[f"vel{tag}"].values
            assert np.abs(record.east[at] - velocity[0].T).max() < 5e-6
            assert np.abs(record.north[at] - velocity[1].T).max() < 5e-6
            up = velocity[2:].mean(axis=0) if tag else velocity[2]  # a Signature has two vertical velocities
            assert np.abs(record.profiles["up"][at] - up.T).max() < 5e-6
        half_decibels = 2.0 if tag else 1.0
        amplitude = half_decibels * theirs[f"amp{tag}"].values.transpose(2, 1, 0)
        np.testing.assert_array_equal(record.profiles["echo"][at], amplitude)
        if tag:
            np.testing.assert_array_equal(record.profiles["correlation"], theirs["corr_avg"].values.transpose(2, 1, 0))
        axes = [record.channels[axis][0] for axis in MAGNETOMETER] if tag else [*record.channels]
        assert axes == ([120.0, -340.0, 410.0] if tag else [])


@pytest.mark.parametrize("down", [False, True])
def test_axes_and_beams_are_rotated_as_by_nortek(tmp_path, down):
    """A current linear in depth is recovered despite the tilt, except in bins that the beams do not reach."""
    samples = drawn(down=down)
    expected = np.array([turned(sample, down) for sample in samples])
    record = read(tmp_path, of_older(samples, XYZ))
    assert np.abs(record.east - expected[:, 0]).max() < 1e-12 > np.abs(record.north - expected[:, 1]).max()

    directions = np.linalg.inv(np.rint(encoder.TRANSFORM * 4096) / 4096)
    cells, beams = record.bin_range_m[0], []
    for sample in samples:
        matrix = xform(sample, down)
        reach = np.abs(directions @ matrix[2]) / np.abs(directions[:, 2])
        along = [
            direction @ matrix.T @ np.outer([0.2, -0.1, 0.0], 1.0 + 0.05 * cells * share)
            for direction, share in zip(directions, reach, strict=True)
        ]
        beams.append(replace(sample, velocity=np.array(along)))
    record = read(tmp_path, of_older(beams, BEAM))
    known = np.isfinite(record.east)
    assert record.bins_mapped and known[:, :3].all()
    for component, size in ((record.east, 0.2), (record.north, -0.1)):
        off = component - size * (1.0 + 0.05 * record.bin_range_m)
        assert np.abs(off[known]).max() < 4e-3  # beams are rounded to mm/s


def test_orientation_of_the_metadata_takes_precedence(tmp_path):
    samples = drawn()
    record = read(tmp_path, of_older(samples, XYZ), orientation="down")
    assert not record.looks_up and np.abs(record.east[3] - turned(samples[3], True)[0]).max() < 1e-12
    assert "30 of 30 samples say that it looked up; down counts." in record.warnings


@pytest.mark.parametrize(
    ("stated", "heading", "velocity", "said"),
    [
        (None, 12.5, 12.5, "declination of 12.5 degrees that was set"),
        (3.0, 3.0, 3.0, "the file tells 12.5"),
        ({"heading": 3, "velocity": 0}, 3.0, 0.0, "the file tells 12.5"),
    ],
)
def test_declination_setting_is_removed_unless_metadata_override(tmp_path, stated, heading, velocity, said):
    samples = drawn(4)
    plain = read(tmp_path, of_signature(samples, ENU))
    record = read(tmp_path, of_signature(samples, ENU, declination=12.5), declination_applied=stated)
    assert (record.heading_bias_deg, record.velocity_bias_deg) == (heading, velocity)
    assert said in " ".join(record.warnings)
    assert np.allclose((record.heading_deg + heading) % 360.0, plain.heading_deg)
    back = np.exp(1j * np.deg2rad(velocity)) * (record.north + 1j * record.east)
    assert np.allclose(back, plain.north + 1j * plain.east)


def test_error_codes_and_low_correlation_are_flagged(tmp_path):
    samples = drawn(3, n=4)
    samples[1] = replace(samples[1], extra={"error": 0x01})  # compass
    samples[2] = replace(samples[2], extra={"error": 0x02})  # measurement
    record = read(tmp_path, of_older(samples))
    assert record.heading_quality.tolist() == [GOOD, BAD, GOOD, GOOD]
    assert record.quality[:, 0].tolist() == [GOOD, BAD, BAD, GOOD]
    correlation = np.full((4, 5), 90)
    correlation[2, 3] = 40
    found = read(tmp_path, of_signature([replace(s, correlation=correlation) for s in drawn(4, n=3)]))
    assert (found.manufacturer, found.model, found.serial_number) == ("Nortek", "Signature500", "100123")
    assert found.quality[0].tolist() == [GOOD, GOOD, GOOD, BAD, GOOD]


def test_lost_samples_are_counted_and_junk_is_skipped(tmp_path):
    data = of_older(drawn(n=40))
    length = len(of_older(drawn(n=40))) - len(of_older(drawn(n=40)[:-1]))
    hole = read(tmp_path, data[: -20 * length - 7] + data[-10 * length :])
    assert len(hole.time_s) == 29 and hole.counts["lost"] == 11
    junk = b"\xa5\x20\x10\x00\xa5\xa5" * 300
    whole = read(tmp_path, data[: -5 * length] + junk + data[-5 * length :])
    assert len(whole.time_s) == 40 and whole.counts["bytes_skipped"] == len(junk) and whole.counts["lost"] == 0


def test_other_record_types_are_skipped_and_reported(tmp_path):
    samples = drawn(4, n=10)
    bursts = [encoder.signature(replace(s, velocity=s.velocity[:, :2]), BEAM, 0x15) for s in samples]
    data = of_signature(samples) + b"".join(bursts) + encoder.packet(0x1C, bytes(401))  # odd: an echo sounder's
    record = read(tmp_path, data, "meter.ad2cp")
    assert record.east.shape == (10, 5) and record.counts["bytes_skipped"] == 0
    said = "meter.ad2cp: the averages were read; 11 records of other kinds, 10 of them bursts, were passed over."
    assert said in record.warnings
    point = [replace(s, velocity=s.velocity[:, :1]) for s in drawn(n=10)]
    mixed = of_older(point, kind=0x01) + b"".join(encoder.older(s, 0x80) for s in point)
    found = read(tmp_path, mixed)
    assert found.east.shape == (10, 1) and found.counts["diagnostic_samples"] == 10


def test_matching_files_are_joined_in_time_order(tmp_path):
    samples = drawn()
    parts = {"b.wpr": of_older(samples[:10]), "a.wpr": of_older(samples[10:]), "c.wpr": of_older(drawn(cells=4))}
    for name, data in parts.items():
        (tmp_path / name).write_bytes(data)
    whole = nortek.read([tmp_path / "a.wpr", tmp_path / "b.wpr"])
    assert (whole.time_s == read(tmp_path, of_older(samples)).time_s).all()
    with pytest.raises(InputError, match="parts of one recording, found 4 bins looking up and 5 bins"):
        nortek.read([tmp_path / "a.wpr", tmp_path / "c.wpr"])


def test_unusable_files_are_refused_in_one_line(tmp_path):
    good = drawn(n=3)
    two, one = (of_older([replace(s, velocity=s.velocity[:k]) for s in drawn(cells=30)], beams=k) for k in (2, 1))
    vector = encoder.configuration(ENU, 1, serial="VEC 1") + encoder.record(0x11, bytes(22))
    side = [replace(s, extra={"orientation": 0}) for s in drawn(4, n=3)]
    refusals = {
        b"": "expected records of a Nortek file (A5), found an empty file",
        b"7F7F, a letter": "found a file that begins with b'7F7F, a letter'",
        of_older(good)[800:]: "the configuration A5 00, which tells what the velocities are, found none",
        of_older(good) + of_older(good, XYZ): "found 2 that differ; give each recording as a file of its own",
        vector: "expected velocities of an Aquadopp, an Aquadopp profiler or an AWAC, found those of a Vector",
        of_signature(side): "found an instrument on its side by its own word in 3 of 3 samples; give orientation: up",
        of_signature(drawn(4, n=3))[1200:]: "expected the matrix of its 4 beams among the text records",
        encoder.text(): "expected averages or bursts, found records A0",
        two: "expected 3 slanted beams, found 2 beams, which are level",
        one: "expected 3 slanted beams, found 1 beam;",
        of_older(drawn(n=3), khz=1234): "expected a head of 2000, 1000, 600, 400 kHz, found 1234 kHz",
    }
    for data, words in refusals.items():
        line = refused(tmp_path, data)
        assert words in line and "\n" not in line
    assert "expected serial number 99, found WPR 1234" in refused(tmp_path, of_older(good), serial_number="99")
    assert read(tmp_path, of_signature(side), orientation="up").looks_up


def test_sample_with_damaged_clock_is_dropped(tmp_path):
    samples = drawn(n=5)
    wrong = encoder.older(samples[2])[4:-2]
    data = of_older(samples[:2]) + encoder.record(0x20, b"\xff" + wrong[1:]) + b"".join(map(encoder.older, samples[3:]))
    record = read(tmp_path, data)
    assert len(record.time_s) == 4 and "1 good samples have an impossible date and were left out" in record.warnings[0]


@pytest.mark.parametrize(("apart_min", "said"), [(6.0, 1), (5.99, 1), (1 / 60, 0), (3.0, 0)])
@pytest.mark.parametrize("name", ["meter.ad2cp", "meter.wpr"])
def test_averages_are_recognized_by_the_sampling_interval(tmp_path, name, apart_min, said):
    """A Signature stores the single pings of its averages in records of the same type."""
    samples = drawn(4 if name == "meter.ad2cp" else 3, minutes=apart_min)
    if name == "meter.ad2cp":
        data = encoder.text(average_s=360) + b"".join(encoder.signature(sample, ENU) for sample in samples)
    else:
        data = of_older(samples, average_s=360)
    assert sum("the mean of 360 s" in line for line in read(tmp_path, data, name).warnings) == said
