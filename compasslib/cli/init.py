"""``compass init``: draft the configuration files of a cruise from instrument exports; existing files are unchanged."""

from __future__ import annotations

import math
import os
import re
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path

import numpy as np

from compasslib import angles, readers
from compasslib.calibrations.swing import observations
from compasslib.cli.results import print_warnings
from compasslib.config import draft, json_schema
from compasslib.config.draft import Drafted, Mooring, Position, Roles
from compasslib.config.schema import KNOWN_SERIES
from compasslib.config.values import shown
from compasslib.errors import InputError
from compasslib.preparation.affected import ExplainedShare, compare_headings, is_affected
from compasslib.preparation.deployment import apply_deployment
from compasslib.readers import detect, iaga2002, nmea
from compasslib.readers.netcdf import ocean_contour
from compasslib.readers.nortek import converted
from compasslib.readers.table import read_series
from compasslib.records import DEEPEST_M, Record
from compasslib.types import Floats

LEFT_OUT = ("config", "results")  # folders of a cruise that hold no exports
NAMELESS = ("raw", "data", "exports", "")  # names of folders that do not name a mooring
PIECE = re.compile(r"\.\d{3}$")  # suffix of a PD0 file that was split by its recorder
RECORDINGS = (".aqd", ".prf", ".wpr")  # of Nortek, from which other files were converted
SCANS, COMPANION = re.compile(r"A(\d{7})\.\w+$"), re.compile(r"[CE](\d{7})\.\w+$")  # moored profiler
# Keys of a format that the user must decide; for the draft, the files are read with these values.
PROVISIONAL: dict[str, dict[str, object]] = {
    "pd12": {"orientation": "up", "bin_size": 1.0, "first_bin": 1.0},
    **{form: {"direction_reference": "magnetic"} for form in ("netcdf", "ocean_contour", "mat")},
}
# Keys by which files are read for the draft where they are refused without; of the north, as the error says.
UP, TRUE = {"orientation": "up"}, {"direction_reference": "true"}
RETRIED: tuple[dict[str, str], ...] = ({}, UP, TRUE, UP | TRUE)
ASKED = ("orientation", "bin_size", "first_bin")
TOLD_UP = ("pd0", "nortek", "netcdf", "ocean_contour", "mat", "rdi_text")  # formats that may state the orientation
SILENT = ("table", "acm_table", "mmp_acm")  # formats that never state whether directions are magnetic or true
TO_READ = "write one in a copy, or add it by hand with columns"
TO_CARRY = "where and when it was done: needed to carry it to a mooring"


@dataclass(frozen=True)
class Series:
    """A covariate: its keys, its mooring and its time span."""

    keys: Mapping[str, object]
    mooring: str | None  # None: for all moorings
    start_s: float
    end_s: float


@dataclass
class Contents:
    """Contents of the files, sorted by their use in the configuration."""

    place: Position  # as given on the command line
    folders: dict[str, dict[str, Drafted]] = field(default_factory=dict)  # mooring or folder -> name -> instrument
    records: dict[str, Record] = field(default_factory=dict)  # by the instrument's first file
    calibrations: dict[str, str] = field(default_factory=dict)  # name -> text
    series: dict[str, Series] = field(default_factory=dict)  # covariates by name
    left: list[str] = field(default_factory=list)  # files that are not used, and why


def init(asked: Namespace) -> int:
    """Write the drafts, print how many decisions each leaves to the user, and return 0.

    Raises:
        InputError: nothing can be drafted, or a file already exists.
    """
    root = Path(asked.into)
    entries: list[Path] = []
    for entry in map(Path, asked.files):
        if not entry.exists():
            raise InputError(
                str(entry), expected="a file or a folder", found="nothing there", advice="correct the path"
            )
        entries += sorted(_below(entry)) if entry.is_dir() else [entry]
    given = list(dict.fromkeys(entries))
    paths = [path for path in given if _inside(path, root).isprintable()]  # a YAML file cannot name others
    place = Position(asked.latitude, asked.longitude, asked.water_depth)
    contents = _sorted(paths, root, asked.name, Contents(place))
    moorings = _moorings(contents)
    texts = {
        f"config/moorings/{name}.yaml": draft.mooring(name, drafted, place) for name, drafted in moorings.items()
    } | {f"config/calibrations/{name}.yaml": text for name, text in contents.calibrations.items()}
    contents.left += [
        f"{shown(path.name)}: rename it in UTF-8, without control characters" for path in given if path not in paths
    ]
    left = [f"left out: {line}" for line in contents.left]
    if not texts:
        print_warnings(left)
        raise InputError(", ".join(asked.files), expected="exports of instruments", found="none", advice="name others")
    config = {"config/config.yaml": draft.CONFIG.format(moorings="config/moorings" if moorings else "[]")}
    config |= {f"{json_schema.FOLDER}/{name}": text for name, text in json_schema.schemas().items()}
    links = {root / _inside(path, root): Path(os.path.abspath(path)) for path in paths}
    links = {link: path for link, path in links.items() if not os.path.lexists(link)}
    _write(root, links, texts, {file: text for file, text in config.items() if not (root / file).exists()})
    for file, text in texts.items():
        n = draft.decisions(text)
        print(f"{root / file}: {n} DECIDE entr{'y' if n == 1 else 'ies'} to replace by a value")
    print(f"then: compass check {root}")
    print_warnings(left)
    return 0


def _below(folder: Path) -> Iterable[Path]:
    for top, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name[0] != "." and not (Path(top) == folder and name in LEFT_OUT)]
        yield from (Path(top, name) for name in names if name[0] != ".")


def _inside(path: Path, root: Path) -> str:
    """Return the path of a file relative to the cruise folder; below raw/ for outside files, which are linked there."""
    whole, base = Path(os.path.abspath(path)), Path(os.path.abspath(root))
    if whole.is_relative_to(base):
        return whole.relative_to(base).as_posix()
    return f"raw/{_name(whole.parent.name)}/{whole.name}"


def _sorted(paths: Sequence[Path], root: Path, name: str | None, contents: Contents) -> Contents:
    tables: dict[Path, detect.GuessedTable | None] = {}
    groups: dict[tuple[str, str, str], list[Path]] = {}
    for path in paths:
        kind = detect.detect_kind(path)
        form = kind.form if kind else None
        if form != "nortek" and converted.header_of(path) in paths:
            continue  # read together with the header file of its conversion
        recorded = next((each for each in map(path.with_suffix, RECORDINGS) if each in paths), None)
        if path.suffix.lower() == converted.HEADER and recorded:
            contents.left.append(f"{path}: converted from {recorded.name}, which is read")
            continue
        form = "ocean_contour" if form == "netcdf" and ocean_contour.is_ocean_contour(path) else form
        if COMPANION.search(path.name) and any(SCANS.search(other.name) for other in paths):
            continue  # read together with its scans
        if form == "mmp_acm" and (text := path.with_suffix(".TXT")) in paths and text != path:
            contents.left.append(f"{path}: its scans stand unpacked in {text.name}")
            continue
        if form == "table":
            tables[path] = detect.guess_columns(path)
        mooring = name
        if not mooring:  # named after the folder of its files, unless that has a generic name
            folders = (path.absolute().parent.name, Path(os.path.abspath(root)).name)
            mooring = next((_name(folder) for folder in folders if folder.lower() not in NAMELESS), "M1")
        table = tables.get(path)
        if form is None:
            contents.left.append(f"{path}: {f'{kind.name}; {kind.advice}' if kind else 'its kind is not known'}")
        elif form == "table" and table is None:
            contents.left.append(f"{path}: a table whose header names no known columns; {TO_READ}")
        elif table and table.kind == "pressure":
            continue  # read together with scans, or reported as unused below
        elif form in ("iaga2002", "nmea0183") or (table and table.kind != "instrument"):
            _add_aside(path, root, form, table, mooring, contents)
        else:
            groups.setdefault((mooring, form, _stem(path, form)), []).append(path)
    pressures = [path for path, table in tables.items() if table and table.kind == "pressure"]
    with_scans = {files[0].parent for (_, form, _), files in groups.items() if form == "mmp_acm"}
    advice = "name it under pressure_files of a profiler, or under covariates"
    contents.left += [
        f"{each}: a table of pressure alone; {advice}" for each in pressures if each.parent not in with_scans
    ]
    companions = [*pressures, *(path for path in paths if COMPANION.search(path.name))]
    for (mooring, form, stem), files in groups.items():
        companion_files = [path for path in companions if form == "mmp_acm" and path.parent == files[0].parent]
        others = contents.folders.setdefault(mooring, {})
        others[_free(stem, others)] = _drafted(form, files, root, tables.get(files[0]), companion_files, contents)
    _join_heads(contents)
    return contents


def _add_aside(
    path: Path, root: Path, form: str, table: detect.GuessedTable | None, mooring: str, contents: Contents
) -> None:
    """Add a file that is not an instrument's: a calibration or a covariate."""
    file, name = _inside(path, root), _free(_name(path.stem), contents.calibrations)
    keys: dict[str, object]
    if form == "iaga2002":
        keys = {"format": form, "files": [file]}
        contents.series["declination_observatory"] = Series(keys, None, -math.inf, math.inf)
        place, comments = _place(contents.place, "of the observatory", draft.DECIDE)
        try:
            series = iaga2002.read([path])
            placed = bool(np.isfinite(series.latitude + series.longitude))
        except InputError:
            placed = True  # compass check will report the error
        place, comments = ({}, {}) if placed else (place, comments)
        contents.calibrations[name] = draft.calibration("declination", {"file": file, **place}, comments)
    elif form == "nmea0183":
        _add_log(path, file, name, contents)
    elif table and table.kind == "series":
        _add_series(path, file, table, mooring, contents)
    elif table:
        columns = {role: header for role, header in table.columns.items() if role != header}
        unknown = draft.DECIDE if table.kind == "swing" else None  # its courses are true, its compass magnetic
        place, comments = _place(contents.place, TO_CARRY, unknown)
        dated = {} if "time_utc" in table.columns and unknown else {"date": unknown}
        keys = {"file": file, **({"columns": columns} if columns else {}), **place, **dated}
        contents.calibrations[name] = draft.calibration(table.kind, keys, comments | {"date": TO_CARRY})


def _add_log(path: Path, file: str, name: str, contents: Contents) -> None:
    """Add a swing calibration if a log contains magnetic headings, all around the circle, and courses."""
    parsed = nmea.read_any(path)
    if parsed is None:
        why = "no magnetic heading (HDG or HDM) with a course (RMC or VTG)"
        contents.left.append(f"{path}: an NMEA 0183 log with {why}: no swing")
        return
    columns, talkers, log = parsed
    gap = observations.widest_gap(log.heading_deg)
    if gap > observations.REFUSED_GAP_DEG:
        contents.left.append(f"{path}: an NMEA 0183 log whose headings leave {gap:.0f}° of the circle empty: no swing")
        return
    keys = {"file": file, "format": "nmea0183", **({"columns": columns} if columns else {})}
    keys |= {"talker": draft.DECIDE} if talkers else {}
    comments = {"talker": f"{', '.join(talkers)} send headings; HC is a magnetic compass"}
    contents.calibrations[name] = draft.calibration("swing", keys, comments)


def _add_series(path: Path, file: str, table: detect.GuessedTable, mooring: str, contents: Contents) -> None:
    keys = {"format": "table", "files": file, "columns": table.columns}
    try:
        time_s, _, _ = read_series({"files": [path], "columns": table.columns})
    except InputError as error:
        asked = dict.fromkeys(_named_keys(error, readers.TABLE_KEYS), draft.DECIDE)
        if not asked:
            contents.left.append(str(error))
            return
        keys, time_s = keys | asked, np.array([-np.inf, np.inf])
    name = _name(table.columns["value"])
    name = f"{name}_logged" if name in KNOWN_SERIES else name
    contents.series[_free(name, contents.series)] = Series(keys, mooring, float(time_s[0]), float(time_s[-1]))


def _place(said: Position, why: str, unknown: str | None) -> tuple[dict[str, object], dict[str, str]]:
    """Return the position keys of a calibration as given by the user, or undecided ones with comments."""
    if None in (said.latitude, said.longitude):
        words_of = {"latitude": f"degrees north, {why}", "longitude": "degrees east, west negative"}
        return {"latitude": unknown, "longitude": unknown}, words_of
    return {"latitude": said.latitude, "longitude": said.longitude}, {}


def _drafted(
    form: str,
    files: Sequence[Path],
    root: Path,
    table: detect.GuessedTable | None,
    companions: Sequence[Path],
    contents: Contents,
) -> Drafted:
    keys: dict[str, object] = {key: draft.DECIDE for key in ASKED if key in PROVISIONAL.get(form, {})}
    if table:
        keys["columns"] = {**table.columns, **({"scale": table.scale} if table.scale else {})}
    if companions:
        keys["pressure_files"] = [_inside(path, root) for path in companions]
    settings = {**keys, **PROVISIONAL.get(form, {}), "pressure_files": companions}
    inside = tuple(_inside(path, root) for path in files)
    record, asked, trouble = None, set[str](), ""
    for retried in RETRIED:
        if record is None and {*retried} <= asked:
            try:
                record = readers.read(form, files, settings | retried)
                keys |= dict.fromkeys({"orientation"} & {*record.unstated, *retried}, draft.DECIDE)
            except InputError as error:
                trouble = trouble or str(error)
                asked |= {*_named_keys(error, readers.get_format(form).keys)}
    if record is None:
        unread = ["direction_reference"] * (form == "netcdf")  # what the file says of it is not known yet
        return Drafted(form, inside, keys | dict.fromkeys([*sorted(asked), *unread], draft.DECIDE), trouble=trouble)
    contents.records[inside[0]] = record
    drafted = _of_record(form, inside, keys, record, table)
    if form != "netcdf":
        return drafted
    from compasslib.readers.netcdf.variables import read_position

    where = read_position(files[0])
    both = (where["latitude"], where["longitude"]) if {"latitude", "longitude"} <= set(where) else None
    return replace(drafted, place=both, water_depth_m=where.get("water_depth"))


def _named_keys(error: InputError, keys: Iterable[str]) -> list[str]:
    """Find the keys that the advice of an error names."""
    advice = str(error).rpartition("; ")[2] if "; " in str(error) else ""
    return [key for key in keys if key != "columns" and re.search(rf"\b{key}\b", advice)]


def _of_record(
    form: str, files: tuple[str, ...], keys: Mapping[str, object], record: Record, table: detect.GuessedTable | None
) -> Drafted:
    start, end, surfaced = _in_water(record)
    level = record.depth_m if np.isfinite(record.depth_m).any() else record.pressure_dbar
    inside = (record.time_s >= start) & (record.time_s <= end) & np.isfinite(level)
    depth = float(np.median(level[inside])) if inside.any() else np.nan
    speed = np.hypot(record.east, record.north)
    headings = record.heading_deg[np.isfinite(record.heading_deg)]
    stated = (table.north if table else None) if form in SILENT else record.direction_reference
    return Drafted(
        form, files, keys, "", start, end, surfaced,
        step_s=float(np.median(np.diff(record.time_s))) if len(record.time_s) > 1 else np.nan,
        bins=record.east.shape[1],
        sectors=len(np.unique(headings // angles.SECTOR_DEG)),
        depth_m=depth if depth > 0.0 else np.nan,
        depth_range_m=float(np.ptp(np.quantile(level[inside], [0.01, 0.99]))) if inside.any() else np.nan,
        looks_up=record.looks_up if form in TOLD_UP and keys.get("orientation") != draft.DECIDE else None,
        heading_bias_deg=None if form in SILENT else record.heading_bias_deg or record.velocity_bias_deg,
        direction_reference=None if "direction_reference" in record.unstated else stated,
        speed=float(np.nanmedian(speed)) if np.isfinite(speed).any() else np.nan,
        serial_number=record.serial_number,
    )  # fmt: skip


def _in_water(record: Record, *, least_m: float = 2.0) -> tuple[float, float, bool]:
    """Find the first and last time below half the median depth, and return whether they show in pressure or depth.

    Args:
        least_m: least median, and range, of depths that show when an instrument was in the water.
    """
    times = record.time_s[np.isfinite(record.time_s)]
    if not len(times):
        return math.nan, math.nan, False
    for level in (record.pressure_dbar, record.depth_m):
        known = level[np.isfinite(level)]
        if 2 * len(known) > len(level) and min(np.median(known), np.ptp(known)) > least_m:
            deep: Floats = record.time_s[level > np.median(known) / 2.0]
            return float(deep.min()), float(deep.max()), True
    return float(times.min()), float(times.max()), False


def _join_heads(contents: Contents, *, moored_s: float = 60.0) -> None:
    """Turn two fast-sampling PD0 profilers of one folder into a calibration of two heads on one frame.

    Args:
        moored_s: least time step of moored profilers, which average over longer intervals.
    """
    for folder, instruments in list(contents.folders.items()):
        quick = [each for each in instruments.values() if each.format == "pd0" and each.step_s < moored_s]
        if len(quick) == len(instruments) == 2 and all(len(each.files) == 1 for each in quick):
            files = [each.files[0] for each in quick]
            place, comments = _place(contents.place, TO_CARRY, None)
            comments |= {"file": "head a and head b: they sample too quickly to be moored", "date": TO_CARRY}
            contents.calibrations[_free(folder, contents.calibrations)] = draft.calibration(
                "two_heads", {"file": files, **place, "date": None}, comments
            )
            del contents.folders[folder]


def _moorings(contents: Contents) -> dict[str, Mooring]:
    """Form moorings from the instruments of each folder that recorded at the same time."""
    moorings: dict[str, Mooring] = {}
    for folder, instruments in contents.folders.items():
        groups = _deployments(instruments)
        for group in groups:
            start, end = (
                edge(getattr(each, key) for each in group.values()) for edge, key in ((min, "start_s"), (max, "end_s"))
            )
            dated = len(groups) > 1 and math.isfinite(start)
            name = _free(f"{folder}_{datetime.fromtimestamp(start, UTC):%Y}" if dated else folder, moorings)
            series = {
                key: each.keys
                for key, each in contents.series.items()
                if each.mooring in (None, folder) and not (each.end_s < start or each.start_s > end)
            }
            moorings[name] = Mooring(group, _roles(group, contents.records), series)
        used = {key for mooring in moorings.values() for key in mooring.series}
        contents.left += [
            f"{each.keys['files']}: no instrument of {folder} recorded at the time of this series"
            for key, each in contents.series.items()
            if each.mooring == folder and key not in used
        ]
    return moorings


def _deployments(instruments: Mapping[str, Drafted]) -> list[dict[str, Drafted]]:
    """Group instruments by overlap of their records; unreadable ones join the other group where there is only one."""
    groups: list[dict[str, Drafted]] = []
    for name, each in instruments.items():
        joined = [group for group in groups if any(_overlap_in_time(each, other) for other in group.values())]
        groups = [group for group in groups if group not in joined]
        groups.append({key: other for group in joined for key, other in group.items()} | {name: each})
    unread = [group for group in groups if all(each.trouble for each in group.values())]
    read = [group for group in groups if group not in unread]
    return (
        [read[0] | {key: each for group in unread for key, each in group.items()}] if len(read) == 1 else read + unread
    )


def _overlap_in_time(first: Drafted, other: Drafted, *, share: float = 0.1) -> bool:
    """Return whether two records overlap by a share of the shorter one, as those of one deployment."""
    # NaN, of records that could not be read, propagates.
    shorter = np.minimum(first.end_s - first.start_s, other.end_s - other.start_s)
    overlap = np.minimum(first.end_s, other.end_s) - np.maximum(first.start_s, other.start_s)
    return bool(overlap >= np.maximum(share * shorter, 0.0))


def _roles(instruments: Mapping[str, Drafted], records: Mapping[str, Record]) -> Roles:
    """Identify the affected instrument: the only one with headings, or that whose heading explains the directions."""
    turning = [name for name, each in instruments.items() if each.sectors]
    unread = [name for name, each in instruments.items() if each.trouble]
    listed = []  # content of each record, to help the user to identify the affected instrument
    for name, each in instruments.items():
        depth = "" if math.isnan(each.depth_m) else f" at {each.depth_m:.0f} m"
        read = f"{each.bins} bin{'s' * (each.bins != 1)}{depth}, headings in {each.sectors} of 36 sectors"
        listed.append(f"{name}: {'could not be read' if each.trouble else read}")
    affected, evidence = None, f"the instrument whose compass is near iron; {'; '.join(listed)}"
    if len(turning) == 1 and not unread:
        affected, evidence = turning[0], "the only instrument with headings"
    elif len(turning) > 1 and not unread:
        affected, evidence = _by_directions(instruments, turning, records) or (affected, evidence)
    others = [
        name
        for name, each in instruments.items()
        if name != affected and (affected is None or _overlap_in_time(instruments[affected], each) or each.trouble)
    ]
    return Roles(affected, evidence, tuple(others) if len(instruments) > 1 else ())


def _by_directions(
    instruments: Mapping[str, Drafted], turning: Sequence[str], records: Mapping[str, Record]
) -> tuple[str, str] | None:
    """Find the compass whose heading explains the difference of current directions from every other instrument."""
    shares: dict[tuple[str, str], ExplainedShare] = {}
    for first, other in combinations(turning, 2):
        both = [
            apply_deployment(
                records[instruments[name].files[0]],
                start_s=instruments[name].start_s,
                end_s=instruments[name].end_s,
                water_depth=DEEPEST_M,  # unknown: no instrument is rejected
                latitude=45.0,  # depth by pressure differs by 0.5 % between pole and equator
                nominal_depth=None if math.isnan(instruments[name].depth_m) else instruments[name].depth_m,
            )
            for name in (first, other)
        ]
        if parsed := compare_headings(*both):
            shares[first, other], shares[other, first] = parsed
    for name in turning:
        pairs = [(shares[key], shares[key[::-1]], key[1]) for key in shares if key[0] == name]
        if pairs and all(is_affected(share_of_name, others) for share_of_name, others, _ in pairs):
            share = min(share_of_name.share for share_of_name, _, _ in pairs)
            other_shares = " and ".join(f"{other}'s {max(others.share, 0.0):.0%}" for _, others, other in pairs)
            return name, f"its heading explains {share:.0%} of the difference of directions, {other_shares}"
    return None


def _stem(path: Path, form: str) -> str:
    """Derive the common stem of the files of one instrument."""
    if form == "mmp_acm":
        return _name(SCANS.sub("", path.name).strip("_ ") if SCANS.search(path.name) else path.stem)
    return _name(path.name.removesuffix(path.suffix) if form != "pd0" or PIECE.search(path.name) else path.stem)


def _name(text: str) -> str:
    """Turn a text into a legal name."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).lstrip("_.-")[:50].rstrip("_.-") or "unnamed"


def _free(name: str, taken: Iterable[str]) -> str:
    used = set(taken)
    return next(first for k in range(1, 10000) if (first := name if k == 1 else f"{name}_{k}") not in used)


def _write(root: Path, links: Mapping[Path, Path], texts: Mapping[str, str], config: Mapping[str, str]) -> None:
    for file in texts:
        if (root / file).exists():
            advice = "draft with another --name or into another folder with --into, or move that file away"
            raise InputError(str(root / file), expected="no such file yet", found="one", advice=advice)
    for link, path in links.items():
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(path)
    for file, text in {**texts, **config}.items():
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_text(text, encoding="utf-8")
