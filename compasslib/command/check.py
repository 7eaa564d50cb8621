"""``compass check``: every file opened, what each mooring has in a table, and every mistake at once. Nothing is run."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import chdir
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from compasslib import calibration as calibrations
from compasslib.command import gathered
from compasslib.config import compasses, draft
from compasslib.config import cruise as config
from compasslib.config.cruise import CALIBRATIONS
from compasslib.config.schema import Mooring
from compasslib.core import earthfield
from compasslib.core.declination import Applied, applied
from compasslib.core.errors import InputError
from compasslib.core.records import BAD, Pairs, Record
from compasslib.core.types import Floats
from compasslib.preparation import overlap
from compasslib.run import plan
from compasslib.stages import read
from compasslib.stages.pipeline import Job, reading

DAY_S = 86400.0
SECTOR_DEG, SECTORS = 10.0, 36
GAP = 3.0  # usual steps between two samples that make a gap
STEPS = ((DAY_S, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"))
HEAD: tuple[str, ...] = (
    "",
    "",
    "format",
    "samples",
    "every",
    "gaps",
    "from",
    "to",
    "depth",
    "bins",
    "headings",
    "directions",
)


@dataclass(frozen=True)
class Seen:
    """What the files of one mooring or calibration hold."""

    lines: tuple[str, ...]
    mistakes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def run(asked: Namespace) -> int:
    """Print what each mooring and calibration has, then all warnings and every mistake; return 1 where there is one.

    Raises:
        InputError: config/config.yaml cannot be used.
    """
    wrong: list[InputError] = []
    warnings: list[str] = []
    cruise = config.load(Path(asked.cruise), wrong.append)
    planned = plan.plan(cruise, Path())
    mistakes = [str(one) for first in wrong for one in (first, *first.others)]
    jobs = [*((_mooring, name) for name in cruise.moorings), *((_calibration, name) for name in cruise.calibrations)]
    if cruise.options.demonstration:
        print("the demonstration's raw files are made by the run: not opened")
        jobs = []
    with ProcessPoolExecutor(max(min(os.cpu_count() or 1, len(jobs)), 1)) as pool:
        for seen in pool.map(_opened, *zip(*((job, name, planned) for job, name in jobs), strict=True)) if jobs else ():
            print("\n".join(seen.lines), flush=True)
            mistakes += seen.mistakes
            warnings += seen.warnings
    counts = ((cruise.moorings, "mooring"), (cruise.calibrations, "calibration"))
    ready = " and ".join(_counted(len(names), noun) for names, noun in counts if names)
    for one in compasses.suggestions(cruise.moorings):
        print(one)
    gathered.tell(warnings, sys.stdout)
    for one in mistakes:
        print(f"error: {one}", file=sys.stderr)
    print(f"{ready or 'nothing'}: ready" if not mistakes else "", end="\n" * (not mistakes))
    return int(bool(mistakes))


def _opened(job: object, name: str, planned: plan.Plan) -> Seen:
    assert callable(job)
    with chdir(planned.cruise.root):
        found: Seen = job(name, planned)
        return found


def _mooring(name: str, planned: plan.Plan) -> Seen:
    cruise, rules = planned.cruise, planned.moorings
    mooring, roles = cruise.moorings[name], rules.roles([name])[name]
    records: dict[str, Record] = {}
    mistakes, warnings, rows = [], list[str](), [HEAD]
    for role in roles:
        try:
            record = records[role] = read.record_of(**reading(rules, Job(name, role)))
            rows.append(_row(role, mooring, record))
        except InputError as error:
            mistakes.append(f"{name}: {role}: {error}")
    lines = [_title(name, mooring), *_table(rows)]
    if not mistakes:
        try:
            pairs = _of_pairs(name, rules, [records[role] for role in roles])
            lines, warnings = [*lines, *pairs.lines], [*pairs.warnings]
        except InputError as error:
            mistakes.append(f"{name}: {error}")
    of_records = (f"{name} {role}: {text}" for role, record in records.items() for text in record.warnings)
    undecided = _undecided(cruise.mooring_files[name])
    return Seen(tuple(lines), tuple(mistakes), (*undecided, *of_records, *warnings))


def _undecided(file: str) -> list[str]:
    count = draft.decisions(Path(file).read_text("utf-8"))
    return [f"{file}: {_counted(count, 'value')} still to decide; a run takes what is written"] * bool(count)


def _calibration(name: str, planned: plan.Plan) -> Seen:
    rules, job = planned.calibrations, Job(calibration=name)
    try:
        made = calibrations.calibrate(rules.kind(job), rules.raw_files(job), calibrations.settled(rules.settings(job)))
    except InputError as error:
        return Seen((), (f"{CALIBRATIONS}/{name}.yaml: {error}",))
    return Seen((f"{name}: {rules.kind(job)}, {_counted(len(rules.raw_files(job)), 'file')}, {made.n} points",))


def _title(name: str, mooring: Mooring) -> str:
    by = f"calibration {mooring.fit.name}" if mooring.fit.name else mooring.fit.method
    place = f"{abs(mooring.latitude):.4f} {'NS'[mooring.latitude < 0]} "
    west = mooring.longitude if mooring.longitude <= 180.0 else mooring.longitude - 360.0
    place += f"{abs(west):.4f} {'EW'[west < 0]}"
    also = "".join(f"; {series} ({one.format})" for series, one in mooring.covariates.items())
    alone = "" if mooring.reference or mooring.fit.name else "; no reference, so nothing is corrected"
    return f"{name}: {place}, {mooring.start:%Y-%m-%d} to {mooring.end:%Y-%m-%d}, by {by}{also}{alone}"


def _row(role: str, mooring: Mooring, record: Record) -> tuple[str, ...]:
    one, time_s = mooring.instruments[role], record.time_s
    what = "affected" if role == mooring.compromised else "reference"
    if not len(time_s):
        return (role, what, one.format, "0", *[""] * (len(HEAD) - 4))
    steps = np.diff(time_s)
    usual = float(np.median(steps)) if len(steps) else np.nan
    seen, inside = record.heading_quality < BAD, applied(one.declination_applied)
    return (
        role, what, one.format, f"{len(time_s)}", _span(usual), f"{int(np.sum(steps > GAP * usual))}",
        *(f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M}" for t in time_s[[0, -1]]), _depths(record.depth_m),
        f"{record.east.shape[1]}", _sectors(record.heading_deg[seen]), _directions(record, inside),
    )  # fmt: skip


def _span(seconds: float) -> str:
    unit, name = next(((size, name) for size, name in STEPS if seconds >= size), STEPS[-1])
    return f"{seconds / unit:.3g} {name}"


def _depths(depth_m: Floats) -> str:
    known = depth_m[np.isfinite(depth_m)]
    low, high = np.quantile(known, [0.01, 0.99]) if len(known) else (np.nan, np.nan)
    return (
        "unknown"
        if not len(known)
        else f"{round(low)} m"
        if round(low) == round(high)
        else f"{round(low)}-{round(high)} m"
    )


def _sectors(heading_deg: Floats) -> str:
    known = heading_deg[np.isfinite(heading_deg)]
    return f"{len(np.unique(known // SECTOR_DEG))} of {SECTORS} sectors" if len(known) else "none"


def _directions(record: Record, inside: Applied | None) -> str:
    if record.direction_reference == "true":
        return "true"
    if record.velocity_bias_deg not in (None, record.heading_bias_deg):
        of_each = f"{record.heading_bias_deg:+.2f} of headings and {record.velocity_bias_deg:+.2f} of velocities"
        return f"magnetic, {of_each} taken out"
    if record.heading_bias_deg:
        return f"magnetic, heading bias {record.heading_bias_deg:+.2f} taken out"
    if inside is None or not any(inside):
        return "magnetic, none taken out"
    return f"magnetic, {inside if inside.differs else format(inside.heading, '+.2f')} taken out"


def _of_pairs(name: str, rules: plan.Moorings, records: Sequence[Record]) -> Seen:
    job = Job(name)
    along = earthfield.along_time(**rules.place_and_declination(job))
    east = np.quantile(along.declination_deg, [0.0, 1.0])
    lines = [f"  declination {east[0]:+.2f} to {east[1]:+.2f} degrees ({along.source})"]
    warnings = [f"{name}: {text}" for text in along.warnings]
    asked = overlap.Rules(**rules.pairing_rules(job) | {"predict": False})
    for role, trusted in zip(rules.roles([name])[name][1:], records[1:], strict=True):
        clocks = overlap.clocks(records[0], [trusted], asked)
        pairs = overlap.find(records[0], [trusted], along, asked, clocks)
        lines.append(f"  with {role}: {_pairs(pairs)}")
        warnings += [f"{name} with {role}: {text}" for text in pairs.warnings]
    return Seen(tuple(lines), warnings=tuple(warnings))


def _pairs(pairs: Pairs) -> str:
    if not len(pairs):
        return "no pairs"
    days, apart = np.ptp(pairs.time_s) / DAY_S, np.median(np.abs(pairs.lower_depth_m - pairs.upper_depth_m))
    return f"{len(pairs)} pairs over {days:.0f} days, {apart:.1f} m apart, {_sectors(pairs.heading_deg)}"


def _table(rows: Iterable[tuple[str, ...]]) -> list[str]:
    rows = list(rows)
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
    return ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'s' * (n != 1)}"
