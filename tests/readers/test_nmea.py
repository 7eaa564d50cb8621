"""Would catch headings and courses paired wrongly, and damaged or void sentences that count."""

from functools import reduce
from operator import xor

import numpy as np
import pytest

from compasslib.errors import InputError
from compasslib.readers import nmea
from tests.world.sea import SHARED

REAL = SHARED / "swing/2010-11-03.Taiohae.nmea"


def sentence(body: str) -> str:
    return f"${body}*{reduce(xor, body.encode()):02X}"


def rmc(second: int, course: float, *, status: str = "A", speed: float = 5.0) -> str:
    place = "0854.979,S,14006.028,W"
    return sentence(f"GPRMC,1904{second:02d},{status},{place},{speed},{course},031110,10,E,A")


def lines(n: int = 6) -> list[str]:
    return [x for k in range(n) for x in (sentence(f"HCHDG,{10 * k}.0,,,10,E"), rmc(k, 10 * k + 12.5))]


def log(tmp_path, content, **how) -> nmea.NmeaLog:
    path = tmp_path / "swing.nmea"
    path.write_bytes(content if isinstance(content, bytes) else "\r\n".join(content).encode())
    return nmea.read([path], **how)


@pytest.mark.skipif(not REAL.exists(), reason="no ../shared/data")
def test_real_log_is_read_and_survives_bytes_flipped_at_random(tmp_path):
    whole = nmea.read([REAL])
    assert len(whole.time_s) == 1088 and np.sum(whole.speed_kn > 2.0) == 715
    assert set(whole.variation_deg) == {10.0}
    assert whole.counts["read"] == 11537 and whole.counts.get("damaged", 0) == 0
    assert (whole.latitude[0], whole.longitude[0]) == pytest.approx((-8.9163, -140.1005), abs=1e-4)
    assert str(np.datetime64(int(whole.time_s[0]), "s")) == "2010-11-03T19:04:00"
    content = bytearray(REAL.read_bytes())
    rng = np.random.default_rng(1)
    for at in rng.integers(0, len(content), 300):
        content[at] ^= int(rng.integers(1, 256))
    read = log(tmp_path, bytes(content))
    assert read.counts["damaged"] > 150 and len(read.time_s) > 1000
    assert np.isin(read.time_s, whole.time_s).mean() > 0.99


def test_pairs_contain_the_encoded_values(tmp_path):
    read = log(tmp_path, lines())
    assert read.heading_deg.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    assert read.course_deg.tolist() == [12.5, 22.5, 32.5, 42.5, 52.5, 62.5]
    assert np.diff(read.time_s).tolist() == [1.0] * 5
    assert np.isnan(read.water_speed_kn).all()
    assert read.warnings == ()


def test_sentences_without_a_line_end_between_them_are_all_read(tmp_path):
    read = log(tmp_path, "".join(lines()).encode())
    assert read.heading_deg.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0] and not read.counts.get("damaged")


@pytest.mark.parametrize("apart_s", [1, 10])
@pytest.mark.parametrize("order", [1, -1])
def test_one_heading_and_one_course_a_block_belong_together(tmp_path, order, apart_s):
    """Other sentences of a block stand between the two."""
    blocks = [
        (sentence(f"HCHDG,{10 * k}.0,,,10,E"), sentence("GPGSV,1,1,00"), rmc(apart_s * k, 10 * k + 12.5))
        for k in range(6)
    ]
    read = log(tmp_path, [line for block in blocks for line in block[::order]])
    assert read.heading_deg.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    assert read.course_deg.tolist() == [12.5, 22.5, 32.5, 42.5, 52.5, 62.5]
    assert f"with the heading {'before' if order > 0 else 'behind'} them" in read.warnings[0]


@pytest.mark.parametrize(("other", "named"), [("AP", "II"), ("HC", "HC")])
def test_talker_is_asked_for_and_no_autopilot_is_proposed(tmp_path, other, named):
    both = [line for k in range(6) for line in (sentence(f"{other}HDG,{k}.0,,,,"), sentence(f"IIHDG,{k}.0,,,,"))]
    with pytest.raises(InputError, match=f"write talker: {named}$"):
        log(tmp_path, [*both, rmc(0, 12.5)])


def test_each_fault_loses_one_sentence(tmp_path):
    whole = lines()
    wrong_sum, cut, bare = whole[3][:-1] + "0", whole[5][:20], whole[7].split("*")[0]
    assert wrong_sum != whole[3]
    read = log(tmp_path, [*whole[:3], wrong_sum, whole[4], cut, whole[6], bare, *whole[8:]])
    assert read.counts["damaged"] == 3
    assert read.course_deg.tolist() == [12.5, 52.5, 62.5]
    assert "3 damaged sentences" in read.warnings[0]


def test_junk_and_unknown_sentences_are_skipped(tmp_path):
    odd = [b"\xff\xfe\x00 noise", b"\\s:GP0001*31\\", sentence("PSRF103,00,01").encode(), sentence("XXQQQ,1").encode()]
    stamped = [b"12:00:01 " + x.encode() for x in lines()]
    read = log(tmp_path, b"\n".join([*odd, b"", *stamped, *odd]))
    assert len(read.time_s) == 6 and read.counts["other"] == 2


PLACE = "0854.979,S,14006.028,W"
ADDED = [  # sentences added to a log, and what is counted
    ([rmc(8, 99.0, status="V")], {"void": 1}),
    ([sentence(f"GPRMC,190409,A,{PLACE},5.0,,031110,10,E,A")], {"empty": 1}),
    ([sentence(f"GPRMC,9x0409,A,{PLACE},5.0,12,031110,10,E,A")], {"damaged": 1}),
    ([sentence("HCHDG,655.0,,,10,E")], {"impossible": 1}),
    *(
        ([sentence(f"GPRMC,190409,A,{place},{speed},{course},031110,10,E,A")], {"impossible": 1})
        for place, speed, course in (
            ("9954.979,S,14006.028,W", 5, 12),
            ("0854.979,S,19906.028,W", 5, 12),
            (PLACE, 5, 412),
            (PLACE, -5, 12),
        )
    ),
    ([rmc(30, 100.0), rmc(31, 100.0)], {"unpaired": 2}),
    *(([sentence(body)], {}) for body in ("HCHDG", "HCHDG,", "HCHDG,x", "GPRMC,190400", "GPRMC,,A,,,,,,,,,")),
]


@pytest.mark.parametrize(("added", "counted"), ADDED)
def test_invalid_sentences_are_dropped_and_counted(tmp_path, added, counted):
    read = log(tmp_path, [*lines(), *added])
    assert read.course_deg.tolist() == [12.5, 22.5, 32.5, 42.5, 52.5, 62.5] and read.heading_deg.max() == 50.0
    for key, n in counted.items():
        assert read.counts[key] == n and f"{n} {nmea.LOSSES[key]}" in read.warnings[0]


def test_other_sentence_types_are_used_if_selected(tmp_path):
    content = []
    for k in range(4):
        content += [sentence(f"HCHDM,{k + 1}.0,M"), sentence(f"GPVTG,{k + 15}.0,T,,M,6.0,N,11.1,K,A"), rmc(k, 99.0)]
        content += [sentence(f"HEHDT,{k + 12}.0,T"), sentence("VWVHW,,T,,M,5.5,N,10.2,K")]
    read = log(tmp_path, content, heading="HDM", course="VTG")
    assert read.course_deg.tolist() == [15.0, 16.0, 17.0, 18.0]
    assert read.heading_deg.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert read.water_speed_kn.tolist() == [5.5] * 4
    assert set(read.true_heading_deg) <= {12.0, 13.0, 14.0, 15.0}
    assert np.all(np.diff(read.time_s) >= 0.0)


def test_west_variation_is_negative_and_stated_deviation_is_not_applied(tmp_path):
    content = [x.replace(",10,E", ",10,W") for x in (y.split("*")[0][1:] for y in lines())]
    read = log(tmp_path, [sentence(x.replace(".0,,,", ".0,2.0,E,")) for x in content])
    assert set(read.variation_deg) == {-10.0}
    assert read.heading_deg.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
