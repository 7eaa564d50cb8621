"""Diagnosis of simulated observatory series: false names, names found and dates; and coverage of the constant.

The simulation shares no formulae with the analysis, only the record type. If real series are available
(../shared/data/observatory), constants of days, weeks and months are compared with that of their year.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
import targets
from runs import DATA
from scipy.signal import lfilter

from compasslib import earthfield
from compasslib.calibrations import observatory
from compasslib.inference.comparison import Options
from compasslib.inference.kinds import declination
from compasslib.records import FieldSeries

HOUR_S, DAY_S = 3600.0, 86400.0
PLACES = ((55.3, -3.2), (48.0, 2.3), (65.4, 26.6), (40.1, -105.2), (-35.3, 149.4))
REAL = DATA / "observatory"
QUIET_DEG = 0.3  # largest three-hourly disturbance of a null
KINDS = ("null", "null_gaps", "storm", "trend", "jump", "swing", "constant")


def red(rng, n, memory, deviation):
    keep = np.exp(-1.0 / memory)
    return lfilter([1.0], [1.0, -keep], rng.normal(0, deviation * np.sqrt(1 - keep**2), n))


def quiet(rng, days, step_s, latitude, longitude):
    """Simulate a quiet series: secular variation, local rocks, a varying daily cycle, and small disturbances."""
    start = 1.0e9 + DAY_S * rng.integers(3000)
    times = start + step_s * np.arange(int(days * DAY_S / step_s))
    field = earthfield.field_along(latitude, longitude, times[0], times[-1])
    hours = times / HOUR_S
    local = 2 * np.pi * (hours + longitude / 15) / 24
    day = 1 + red(rng, len(times), 5 * DAY_S / step_s, 0.25)
    season = 1 + 0.4 * np.cos(2 * np.pi * times / (365.25 * DAY_S))
    size = rng.uniform(0.04, 0.09)
    variation = size * day * season * (-np.sin(local) + 0.6 * np.cos(2 * local - 2.6) + 0.3 * np.sin(3 * local + 0.3))
    activity = np.exp(red(rng, len(times), 2 * DAY_S / step_s, 0.8))
    noise = rng.uniform(0.01, 0.025) * activity * red(rng, len(times), 2 * HOUR_S / step_s, 1.0)
    noise *= min(1.0, QUIET_DEG / three_hourly(noise, step_s).max())
    noise += red(rng, len(times), 12 * DAY_S / step_s, 0.012) + rng.normal(0, 0.003, len(times))
    d = earthfield.declination_at(field, times) + rng.normal(0, 0.25) + variation + noise
    blank = np.full(len(times), np.nan)
    return FieldSeries(times, d, blank + 18000, blank, "made", latitude, longitude, 0.0), field


def storm(rng, times, worst_deg):
    """Simulate a storm with onset, main phase of substorms and recovery, scaled by its worst three hours."""
    begin = times[0] + rng.uniform(0.25, 0.55) * (times[-1] - times[0])
    hours = (times - begin) / HOUR_S
    shape = np.where(hours > 0, np.exp(-np.maximum(hours, 0) / rng.uniform(8, 20)), 0.0)
    step = float(np.median(np.diff(times)))
    course = red(rng, len(times), 1.5 * HOUR_S / step, 1.0) + 0.5 * red(rng, len(times), 0.3 * HOUR_S / step, 1.0)
    return shape * course * worst_deg / three_hourly(shape * course, step).max(), begin


def three_hourly(x, step_s):
    own = round(3 * HOUR_S / step_s)
    return np.sqrt(np.maximum(np.convolve(x**2, np.ones(own) / own, "same"), 0.0))


def drawn(rng, kind, days, step_s, size):
    """Simulate a series; return it with the field model, its effect and the date of the effect."""
    series, field = quiet(rng, days, step_s, *PLACES[rng.integers(len(PLACES))])
    d, times, date, name = series.declination_deg.copy(), series.time_s, None, None
    if kind == "storm":
        course, date = storm(rng, times, size)
        d, name = d + course, "field_disturbance"
    elif kind == "trend":
        ramp = (times - times[0]) / (times[-1] - times[0])
        d, name = d + rng.choice([-1, 1]) * size * np.sqrt(12) * ramp, "secular_variation"
    elif kind == "jump":
        share = rng.uniform(0.25, 0.75)
        date = times[0] + share * (times[-1] - times[0])
        d, name = d + rng.choice([-1, 1]) * size / np.sqrt(share * (1 - share)) * (times >= date), "heading_slip"
    elif kind == "swing":
        d, name = d + size * np.sqrt(2) * np.sin(2 * np.pi * times / DAY_S + rng.uniform(0, 6)), "field_disturbance"
    elif kind == "constant":
        d, name = d + rng.choice([-1, 1]) * (size + 2.5), "declination_error"
    elif kind == "null_gaps":
        for begin in rng.uniform(times[0], times[-1], 6):
            d[(times > begin) & (times < begin + rng.uniform(0.02, 0.1) * days * DAY_S)] = np.nan
        d[rng.integers(len(d), size=3)] += rng.normal(0, 4, 3)  # single outliers
    return replace(series, declination_deg=d), field, name, date


def measure(kind, days, step_s, size, count, seed):
    named = right = alone = rest = 0
    late, spent = [], []
    for index in range(count):
        rng = np.random.default_rng([seed, KINDS.index(kind), int(days), int(step_s), int(100 * size), index])
        series, field, name, date = drawn(rng, kind, days, step_s, size)
        if observatory.too_short_reason(series):
            continue
        begin = time.perf_counter()
        found = declination.diagnose_series(series, field, Options())
        spent.append(time.perf_counter() - begin)
        names = [one.effect for one in found.findings]
        sets = {n for one in found.findings for n in (one.effect, *one.alternatives)}
        named, rest = named + bool(names), rest + (found.unexplained is not None)
        right, alone = right + (name in sets), alone + (set(names) == {name})
        if date is not None and name in names:
            late += [(one.when_s[0] - date) / HOUR_S for one in found.findings if one.effect == name][:1]
    dated = f", date off by {np.median(np.abs(late)):.1f} h (median)" if late else ""
    shares = (targets.text_of(held, count) for held in (named, right, alone, rest))
    targets.line(kind, f"{days} d, {step_s / 60:.0f} min", size, *shares, f"{np.median(spent):.2f} s{dated}")


def constants():
    """Compare the constants of parts of real years with the whole year's."""
    from compasslib.readers import iaga2002

    targets.head("year", "days", "rms error", "stated 1 sigma", "within 95 %, parts that overlap")
    for path in sorted(REAL.glob("*.hor")):
        series = iaga2002.read([path])
        field = earthfield.field_along(55.3, -3.2, series.time_s[0], series.time_s[-1])
        whole = observatory.compare(series, field, limit_deg=0.5).constant_deg
        for days in (1, 3, 10, 30, 90):
            held = []
            for begin in range(0, 365 - days + 1, max(1, days // 2)):
                inside = slice(24 * begin, 24 * (begin + days))
                part = replace(series, time_s=series.time_s[inside], declination_deg=series.declination_deg[inside])
                held.append(observatory.compare(part, field, limit_deg=0.5))
            off = np.array([one.constant_deg - whole for one in held])
            sigma = np.array([one.constant_sigma_deg for one in held])
            within = targets.share_of(np.abs(off) <= 1.96 * sigma)
            targets.line(path.stem, days, f"{np.sqrt(np.mean(off**2)):.4f}", f"{np.median(sigma):.4f}", within)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=20)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--kind", choices=KINDS)
    asked = parser.parse_args()
    targets.head("kind", "record", "size", "named", "truth in the set", "truth alone", "unexplained", "time")
    for kind in KINDS if asked.kind is None else (asked.kind,):
        null = kind.startswith("null")
        records = ((1, 60.0), (3, 60.0), (60, 3600.0), (365, 3600.0))
        if kind in ("trend", "swing"):
            records = records[2:]
        for days, step in records:
            for size in (0.0,) if null else (0.3, 0.7, 1.5, 4.0):
                measure(kind, days, step, size, asked.count * (5 if null else 1), asked.seed)
    if REAL.is_dir():
        constants()


if __name__ == "__main__":
    main()
