"""Read NMEA 0183 logs: compass headings paired in time with courses over ground.

Sentences are parsed independently, so a damaged one does not affect others. Sentences without a valid checksum are
dropped.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import count, product
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.errors import InputError, applicable
from compasslib.readers.files import count_unprintable, read_text_bytes, refuse_mostly_damaged
from compasslib.types import Floats

HEADINGS, COURSES = ("HDG", "HDM"), ("RMC", "VTG")
USUAL = (HEADINGS[0], COURSES[0])
MAGNETIC, AUTOPILOTS = "HC", ("AG", "AP")  # talkers
LOSSES = {
    "damaged": "damaged sentences (checksum absent or wrong, or cut short)",
    "strange_bytes": "bytes that are no text",
    "void": "positions that the receiver itself called void",
    "unpaired": "courses without a heading within 2.5 s",
    "empty": "courses without a number",
    "impossible": "numbers that no heading, course, speed or place can be",
}
NAN = float("nan")
FASTEST_KN = 100.0
FIX = ("time_s", "course_deg", "speed_kn", "latitude", "longitude", "variation_deg")
APART_S = 2.5  # between a heading and its course

_NUMBERED = re.compile(rb"\$([A-Z]{2})(%s),[^,\s]" % "|".join((*HEADINGS, *COURSES)).encode())
_Values = dict[str, list[tuple[int, float]]]  # sentence type -> (line, value); line: running number of the sentence


@dataclass(frozen=True)
class NmeaLog:
    """Headings and courses of one or several logs, one row per course."""

    time_s: Floats  # (n,) UTC seconds since 1970; NaN without RMC
    heading_deg: Floats  # (n,) compass reading, magnetic, not corrected for deviation
    course_deg: Floats  # (n,) over ground, true north
    speed_kn: Floats  # (n,) over ground
    true_heading_deg: Floats  # (n,) HDT, NaN where absent
    water_speed_kn: Floats  # (n,) VHW, NaN where absent
    latitude: Floats  # (n,) degrees north, NaN without RMC
    longitude: Floats  # (n,) degrees east
    variation_deg: Floats  # (n,) declination stated in the log, degrees east, NaN where absent
    counts: dict[str, int] = field(default_factory=dict)  # numbers of sentences read, damaged, void, unpaired etc.
    warnings: tuple[str, ...] = ()


def read(paths: Sequence[Path], *, heading: str = "HDG", course: str = "RMC", talker: str | None = None) -> NmeaLog:
    """Read NMEA 0183 logs, pairing each course with the heading nearest in the stream.

    The course is of sentences ``RMC`` or ``VTG`` (timed by interpolation between RMC); ``talker``, the sender of the
    headings, is required where several send them.

    Raises:
        InputError: a file cannot be read, over half of its headings and courses are damaged, several instruments send
            headings, or there are no headings or no courses to pair.
    """
    counts = Counter[str]()
    fixes, values, talkers = _collect(_sentences(paths, counts, (heading, course)), counts, heading, course, talker)
    where = ", ".join(map(str, paths))
    if talkers and talker not in (talkers if talker or len(talkers) > 1 else [None]):
        senders = " and ".join(f"{name} ({n})" for name, n in sorted(talkers.items()))
        raise InputError(
            where,
            expected=f"{heading} of {talker or 'one talker'}",
            found=f"those of {senders}",
            advice=f"write talker: {min(talkers, key=_by_rank)}",
        )
    if not (len(fixes) and values[heading]):
        shown = f"{len(values[heading])} {heading} and {len(fixes)} {course} with numbers, {counts['damaged']} damaged"
        raise InputError(
            where,
            expected=f"sentences {heading} and {course} with a right checksum",
            found=shown,
            advice="check the file, or name other sentences in columns",
        )
    log = _pair(fixes, values, heading, counts)
    lost = ", ".join(f"{counts[key]} {what}" for key, what in LOSSES.items() if counts[key])
    n, side = counts["in_blocks"], "before" if counts["heading_first"] else "behind"
    lines = {
        f"left out of the log: {lost}": lost,
        f"{heading} and {course} come in blocks of one each: {n} courses were paired with the heading {side} them, "
        "in the order in which the log begins": n,
    }
    return NmeaLog(**log, counts=dict(counts), warnings=tuple(applicable(lines)))


def read_any(path: Path) -> tuple[dict[str, str], list[str], NmeaLog] | None:
    """Read a log by its first readable pair of heading and course sentences, None without any.

    Also give the setting ``columns`` of a swing for these sentences, empty for the default ones, and the talkers that
    a user has to choose from, of which the first was read; empty unless several send these headings.
    """
    sent = {(kind.decode(), talker.decode()) for talker, kind in _NUMBERED.findall(read_text_bytes(path))}
    for heading, course in product(HEADINGS, COURSES):
        talkers = sorted((name for kind, name in sent if kind == heading), key=_by_rank)
        for talker in (None, *talkers[:1]):
            with suppress(InputError):
                log = read([path], heading=heading, course=course, talker=talker)
                columns = {"compass_deg": heading, "cog_deg": course} if (heading, course) != USUAL else {}
                return columns, talkers if talker else [], log
    return None


def _by_rank(talker: str) -> tuple[bool, bool, str]:
    """Sort a magnetic compass before others, and autopilots last."""
    return talker != MAGNETIC, talker in AUTOPILOTS, talker


def _collect(
    sentences: Iterator[tuple[int, Any]], counts: Counter[str], heading: str, course: str, talker: str | None
) -> tuple[Floats, _Values, Counter[str]]:
    """Collect the courses, and (line, value) of headings and water speed; count the headings by talker.

    Returns:
        line and ``FIX`` of each course, (n, 7); values by sentence type; number of headings by talker.
    """
    rows, clock, talkers = list[tuple[float, ...]](), list[tuple[float, float]](), Counter[str]()
    values: _Values = {name: [] for name in (*HEADINGS, "HDT", "VHW")}
    for line, sentence in sentences:
        kind = getattr(sentence, "sentence_type", "")  # absent in proprietary sentences
        if kind == "RMC" and sentence.status != "A":
            counts["void"] += 1
        elif kind == "RMC":
            try:
                time_s = datetime.combine(sentence.datestamp, sentence.timestamp).replace(tzinfo=UTC).timestamp()
                place = float(sentence.latitude), float(sentence.longitude)
            except (TypeError, ValueError, AttributeError):
                counts["damaged"] += 1  # valid checksum, but an invalid time or position
                continue
            clock.append((line, time_s))
            track, speed = _number(sentence.true_course), _number(sentence.spd_over_grnd)
            variation = _number(sentence.mag_variation) * (-1.0 if sentence.mag_var_dir == "W" else 1.0)
            rows += [(line, time_s, track, speed, *place, variation)] if course == "RMC" else []
        elif kind == course == "VTG":
            track, speed = _number(sentence.true_track), _number(sentence.spd_over_grnd_kts)
            rows.append((line, NAN, track, speed, NAN, NAN, NAN))
        elif kind in values:
            value = _number(sentence.water_speed_knots if kind == "VHW" else sentence.heading)
            talkers[sentence.talker] += kind == heading and bool(np.isfinite(value))
            if kind == heading and talker and sentence.talker != talker:
                continue
            if not 0.0 <= np.nan_to_num(value) <= (FASTEST_KN if kind == "VHW" else 360.0):
                counts["impossible"] += 1
            elif np.isfinite(value):
                values[kind].append((line, value))
    fixes = np.reshape(np.array(rows, dtype=float), (-1, 1 + len(FIX)))
    at, speed, latitude, longitude = np.nan_to_num(fixes[:, 2:6]).T  # missing values are valid
    valid = (at >= 0) & (at <= 360) & (speed >= 0) & (speed <= FASTEST_KN)
    valid &= (np.abs(latitude) <= 90) & (np.abs(longitude) <= 180)
    complete = np.isfinite(fixes[:, 2:4]).all(axis=1)
    counts["impossible"] += int((~valid).sum())
    counts["empty"] += int((valid & ~complete).sum())
    fixes = fixes[valid & complete]
    if clock:  # times of courses without one are interpolated between the surrounding RMC sentences
        interpolated = np.interp(fixes[:, 0], *np.transpose(clock))
        fixes[:, 1] = np.where(np.isfinite(fixes[:, 1]), fixes[:, 1], interpolated)
    return fixes, values, +talkers


def _number(text: object) -> float:
    try:
        return float(str(text))
    except ValueError:
        return NAN


def _sentences(paths: Sequence[Path], counts: Counter[str], wanted: Sequence[str]) -> Iterator[tuple[int, Any]]:
    """Iterate over (running number, intact sentence); raise an error if most wanted ones in a file are damaged."""
    import pynmea2

    number = count()
    for path in paths:
        content = read_text_bytes(Path(path))
        counts["strange_bytes"] += count_unprintable(content)
        of_wanted = Counter[bool]()
        written = content.decode("ascii", errors="replace")
        if "heading_first" not in counts and (named := [kind for kind in wanted if kind in written]):
            counts["heading_first"] = int(min(named, key=written.find) == wanted[0])  # intact or not
        # A logger may lose the end of a line.
        for text in (f"${sentence}" for line in written.splitlines() for sentence in line.split("$")[1:]):
            whole = True
            try:
                yield next(number), pynmea2.parse(text.strip(), check=True)
                counts["read"] += 1
            except pynmea2.SentenceTypeError:
                counts["other"] += 1
            except (pynmea2.ParseError, ValueError):
                counts["damaged"] += 1
                whole = False
            of_wanted[whole] += text[3:6] in wanted
        refuse_mostly_damaged(path, " and ".join(wanted), damaged=of_wanted[False], whole=of_wanted[True])


def _pair(fixes: Floats, values: _Values, heading: str, counts: Counter[str]) -> dict[str, Floats]:
    """Pair each course with a heading, and drop those without."""
    line, time_s = fixes[:, 0], fixes[:, 1]
    at, headings = np.transpose(values[heading])
    nearest, apart_s = _nearest(values[heading], line, time_s)
    # In blocks of one heading and one course, the order is that of the first block.
    before, first = np.searchsorted(at, line), counts["heading_first"]
    single = np.diff(before, prepend=0) == 1 if first else np.diff(before, append=len(at)) == 1
    value = angles.wrap360(np.where(single, headings[np.clip(before - first, 0, len(at) - 1)], nearest))
    near = ~(apart_s > APART_S) | single  # without a clock the nearest heading in the stream is used
    by_order = single & ((apart_s > APART_S) | (value != angles.wrap360(nearest)))
    counts.update(in_blocks=int(by_order.sum()), unpaired=int((~near).sum()))
    series = dict(zip(FIX, fixes.T[1:], strict=True)) | {
        "heading_deg": value,
        "true_heading_deg": _nearest(values["HDT"], line, time_s)[0],
        "water_speed_kn": _nearest(values["VHW"], line, time_s)[0],
    }
    return {name: column[near] for name, column in series.items()}


def _nearest(values: list[tuple[int, float]], line: Floats, time_s: Floats) -> tuple[Floats, Floats]:
    """Find the value nearest in the stream to each line, and its time difference, seconds."""
    if not values:
        return np.full(line.shape, np.nan), np.full(line.shape, np.inf)
    at, value = np.transpose(values)
    right = np.clip(np.searchsorted(at, line), 0, len(at) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(at[left] - line) <= np.abs(at[right] - line), left, right)
    return value[nearest], np.abs(np.interp(at[nearest], line, time_s) - time_s)
