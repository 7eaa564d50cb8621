"""``compass check``, which opens all configured files and prints all problems, and ``compass correct``."""

import os
import re
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import chdir, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path

import numpy as np

from compasslib import angles, calibrations, earthfield
from compasslib.archive.deposit import missing_attributes
from compasslib.cli.results import align, print_warnings
from compasslib.config import cruise as config
from compasslib.config.cruise import CALIBRATIONS, Cruise
from compasslib.config.schema import Covariate, Instrument, Mooring
from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError
from compasslib.pipeline.process import process_mooring
from compasslib.preparation.pairs import PairRules, find_pairs, match_ready_pairs
from compasslib.readers import iaga2002, table
from compasslib.readers.matlab import PAIR_ROLES, read_ready_pairs
from compasslib.readers.pd0 import match_serial_number
from compasslib.records import BAD, Pairs, Record
from compasslib.stages import read
from compasslib.stages.settings import (
    Calibrations,
    Moorings,
    check_cruise,
    stated_serial_number,
    used_instruments,
)
from compasslib.types import DAY_S, HOUR_S, Floats

GAP = 3.0  # in median time steps: a longer step between two samples is a gap
STEPS = ((DAY_S, "d"), (HOUR_S, "h"), (60.0, "min"), (1.0, "s"))
HEAD: tuple[str, ...] = (
    *("", "", "format", "samples", "every", "gaps", "from", "to", "depth", "bins", "headings", "directions"),
)


@dataclass
class Inspection:
    """Contents of the files of one mooring or calibration, and problems with them."""

    lines: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    usable: bool = True  # whether a run can process it
    serials: dict[str, str] = field(default_factory=dict)  # serial numbers, by instrument

    @contextmanager
    def noting(self, where: str, *, needed: bool = True) -> Iterator[None]:
        """Note an error of the block as a problem; what is ``needed`` makes the whole unusable."""
        try:
            yield
        except InputError as error:
            self.problems.append(f"{where}: {error}")
            self.usable &= not needed


def check(asked: Namespace) -> int:
    """Print the contents of each mooring and calibration, then warnings and problems; return 1 if there is any."""
    refused: list[InputError] = []
    cruise = config.load_cruise(Path(asked.cruise), refuse=refused.append)
    check_cruise(cruise)
    problems = [str(each) for first in refused for each in (first, *first.others)]
    jobs = [(_inspect_mooring, name) for name in cruise.moorings]
    jobs += [(_inspect_calibration, name) for name in cruise.calibrations]
    if cruise.options.demonstration:
        print("the demonstration's raw files are made by the run: not opened")
        jobs = []
    inspections = dict[str, Inspection]()
    with ProcessPoolExecutor(max(min(os.cpu_count() or 1, len(jobs)), 1)) as pool:
        opened = [pool.submit(_inspect, job, name, cruise) for job, name in jobs]
        for (_, name), future in zip(jobs, opened, strict=True):
            inspections[name] = inspection = future.result()
            print("\n".join(inspection.lines), flush=True)
            problems += inspection.problems
    if jobs:
        problems += _mixed_serials(cruise.moorings, inspections)
        if absent := missing_attributes(cruise.options.attributes):
            print(f"to deposit the results, add to the attributes of config.yaml before the run: {', '.join(absent)}")
    print_warnings([text for inspection in inspections.values() for text in inspection.warnings], sys.stdout)
    for line in problems:
        print(f"error: {line}", file=sys.stderr)
    counted = _plural(len(problems), "problem")
    if refused:
        print(f"cannot run, {counted}")
    else:
        kinds = ((cruise.moorings, "mooring"), (cruise.calibrations, "calibration"))
        everything = " and ".join(_plural(len(each), noun) for each, noun in kinds if each) or "nothing to run"
        stopped = [name for name, inspection in inspections.items() if not inspection.usable]
        left_out = f" (stopped: {', '.join(stopped)})" if stopped else ""
        print(f"{everything}: can run, {counted}{left_out}")
    return int(bool(problems))


def _inspect(job: Callable[[Inspection, str, Cruise], None], name: str, cruise: Cruise) -> Inspection:
    inspection = Inspection()
    with chdir(cruise.root):
        job(inspection, name, cruise)
    return inspection


def _inspect_mooring(inspection: Inspection, name: str, cruise: Cruise) -> None:
    rules, mooring = Moorings(cruise), cruise.moorings[name]
    fit, used = mooring.fit, used_instruments(mooring)
    records: dict[str, Record] = {}
    rows = [HEAD]
    for role in (*used, *(other for other in mooring.instruments if other not in used)):
        with inspection.noting(f"{name}: {role}", needed=False):
            settings = rules.read(name, role) | {"series": {}}
            record = records[role] = read.record_of(rules.raw_files(name, role), **settings)
            part = "reference" if role in mooring.reference else "not used"
            part = "affected" if role == mooring.compromised else part
            rows.append(_row(role, part, mooring.instruments[role], record))
            match_serial_number(f"{name}: {role}", record.serial_number, rules.serial_number(name, role))
    by = f"calibration {' and '.join(fit.name)}" if fit.name else fit.method
    also = "".join(f"; {each} ({covariate.format})" for each, covariate in mooring.covariates.items())
    shares = any(name in moorings and len(moorings) > 1 for moorings, _ in cruise.compasses.values())
    corrected = mooring.reference or fit.name or fit.file or fit.coefficients or shares
    also += "" if corrected else "; no reference, so nothing is corrected"
    place = f"{name}: {angles.position(mooring.latitude, mooring.longitude)}"
    inspection.lines += [
        f"{place}; {mooring.start:%Y-%m-%d} to {mooring.end:%Y-%m-%d}, by {by}{also}",
        *(f"  {line}" for line in align(rows)),
    ]
    inspection.warnings += [f"{name} {role}: {text}" for role, record in records.items() for text in record.warnings]
    inspection.serials |= {role: record.serial_number for role, record in records.items() if record.serial_number}
    inspection.usable = records.keys() >= set(used)
    _inspect_covariates(inspection, name, mooring.covariates, (mooring.start_s, mooring.end_s))
    if inspection.usable:
        _inspect_pairs(inspection, name, rules, [records[role] for role in used])


def _inspect_covariates(
    inspection: Inspection, where: str, series: Mapping[str, Covariate], deployment: tuple[float, float]
) -> None:
    for name, covariate in series.items():
        with inspection.noting(f"{where}: covariates.{name}"):
            if covariate.format == "table":
                time_s = table.read_series(covariate.model_dump(exclude={"format"}))[0]
            else:
                time_s = iaga2002.read([Path(file) for file in covariate.files]).time_s
            inspection.lines.append(f"  {name}: {covariate.format}, {_plural(len(time_s), 'value')}, {_dates(time_s)}")
            if time_s[0] > deployment[1] or time_s[-1] < deployment[0]:
                raise InputError(covariate.files[0], "values inside the deployment", "none", "correct its files")


def _inspect_calibration(inspection: Inspection, name: str, cruise: Cruise) -> None:
    rules, file = Calibrations(cruise), f"{CALIBRATIONS}/{name}.yaml"
    settings, raw = rules.calibrate(name), rules.raw_files(name)
    with inspection.noting(file):
        made = calibrations.calibrate(settings["kind"], raw, earthfield.resolve_settings(settings["settings"]))
        inspection.lines = [f"{name}: {settings['kind']}, {_plural(len(raw), 'file')}, {made.n} points"]
        inspection.problems = [f"{file}: no coefficients: {made.why}"] if made.why else []


def _row(name: str, part: str, instrument: Instrument, record: Record) -> tuple[str, ...]:
    """Compose the table row of one record; ``part`` is its role."""
    time_s = record.time_s
    if not len(time_s):
        return (name, part, instrument.format, "0", *[""] * (len(HEAD) - 4))
    steps = np.diff(time_s)
    usual = float(np.median(steps)) if len(steps) else np.nan
    valid, inside = record.heading_quality < BAD, parse_applied_declination(instrument.declination_applied)
    known, depths = record.depth_m[np.isfinite(record.depth_m)], "unknown"
    if len(known):
        low, high = (round(each) for each in np.quantile(known, [0.01, 0.99]))
        depths = f"{low} m" if low == high else f"{low}-{high} m"
    return (
        name, part, instrument.format, f"{len(time_s)}", _span(usual), f"{int(np.sum(steps > GAP * usual))}",
        *_dates(time_s).split(" to "), depths,
        f"{record.east.shape[1]}", _sectors(record.heading_deg[valid]),
        _directions(record, inside),
    )  # fmt: skip


def _dates(time_s: Floats) -> str:
    return " to ".join(f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M}" for t in time_s[[0, -1]])


def _span(seconds: float) -> str:
    unit, name = next(((size, name) for size, name in STEPS if seconds >= size), STEPS[-1])
    return f"{seconds / unit:.3g} {name}"


def _sectors(heading_deg: Floats) -> str:
    known = heading_deg[np.isfinite(heading_deg)]
    return f"{len(np.unique(known // angles.SECTOR_DEG))} of {angles.SECTORS} sectors" if len(known) else "none"


def _directions(record: Record, inside: AppliedDeclination | None) -> str:
    if record.direction_reference == "true":
        return "true"
    if record.velocity_bias_deg not in (None, record.heading_bias_deg):
        biases = f"{record.heading_bias_deg:+.2f} from headings and {record.velocity_bias_deg:+.2f} from velocities"
        return f"magnetic; {biases} removed"
    if record.heading_bias_deg:
        return f"magnetic; heading bias {record.heading_bias_deg:+.2f} removed"
    if inside is None or not any(inside):
        return "magnetic; no declination or heading bias removed"
    return f"magnetic; declination {inside if inside.differs else format(inside.heading, '+.2f')} removed"


def _inspect_pairs(inspection: Inspection, name: str, rules: Moorings, records: Sequence[Record]) -> None:
    settings, by_source = rules.overlap(name), dict[str, Pairs]()
    with inspection.noting(name):
        along = earthfield.field_along(**settings["place"])
        east = np.quantile(along.declination_deg, [0.0, 1.0])
        inspection.lines.append(f"  declination {east[0]:+.2f} to {east[1]:+.2f} degrees ({along.source})")
        inspection.warnings += [f"{name}: {text}" for text in along.warnings]
        asked, columns = PairRules(**settings["rules"] | {"predict": False}), settings["columns"]
        if (ready := rules.ready_pairs(name)) and columns is not None:
            rows = read_ready_pairs(Path(ready[0]), {role: columns[role] for role in PAIR_ROLES})
            by_source = {ready[0]: match_ready_pairs(rows, columns["scale"], records[0], along)}
        else:
            roles = rules.cruise.moorings[name].reference
            several = len(roles) > 1
            by_source = {
                role: find_pairs(records[0], [reference], along, asked, several=several)
                for role, reference in zip(roles, records[1:], strict=True)
            }
    for source, pairs in by_source.items():
        if len(pairs):
            days, apart = np.ptp(pairs.time_s) / DAY_S, np.median(np.abs(pairs.lower_depth_m - pairs.upper_depth_m))
            depths = f"{apart:.1f} m apart, " if np.isfinite(apart) else ""
            counted = f"{len(pairs)} pairs over {days:.0f} days, {depths}{_sectors(pairs.heading_deg)}"
            inspection.lines.append(f"  with {source}: {counted}")
            inspection.warnings += [f"{name} with {source}: {text}" for text in pairs.warnings]
        else:
            inspection.lines.append(f"  with {source}: no pairs")
            why = "; ".join(pairs.warnings) or "no samples near enough in time and depth"
            inspection.problems.append(f"{name}: no pairs with {source}, so nothing is corrected by it: {why}")


def _mixed_serials(moorings: Mapping[str, Mooring], inspections: Mapping[str, Inspection]) -> list[str]:
    """Describe each compass whose instruments have different serial numbers, by their files or their attributes."""
    numbers: dict[str, dict[str, str]] = {}
    for name, mooring in moorings.items():
        for role, instrument in mooring.instruments.items():
            number = inspections[name].serials.get(role) or stated_serial_number(instrument.attributes)
            if instrument.compass is not None and number:
                numbers.setdefault(instrument.compass, {})[f"{name} ({role})"] = number
    return [
        f"compass {compass}: serial number {first} at {this}, {second} at {other}: two instruments under one name; "
        "correct compass or files"
        for compass, places in numbers.items()
        for (this, first), (other, second) in combinations(places.items(), 2)
        if not {*map(int, re.findall(r"\d+", first))} & {*map(int, re.findall(r"\d+", second))}
    ]


def _plural(n: int, noun: str) -> str:
    return f"{n} {noun}{'s' * (n != 1)}"


def correct(asked: Namespace) -> int:
    """Correct a mooring; report each stage and finally all warnings on stderr, and print the folder of the results."""
    folder = Path(asked.into or Path(asked.cruise) / "corrected" / asked.mooring)
    warnings: list[str] = []

    def say(text: str) -> None:
        for line in text.splitlines():
            if ": warning: " in line:
                warnings.append(line.replace(": warning: ", ": ", 1))
            else:
                print(line, file=sys.stderr, flush=True)

    process_mooring(asked.cruise, asked.mooring, folder, say)
    print_warnings(warnings)
    print(folder)
    return 0
