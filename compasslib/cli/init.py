"""``compass init``: draft the configuration files of a cruise from instrument exports; existing files are unchanged.

The schema refuses DECIDE, the value of what the files do not tell; the comment on the same line gives the evidence.
"""

from __future__ import annotations

import math
import os
import re
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from compasslib import angles, readers
from compasslib.cli.results import print_warnings
from compasslib.config.cruise import SCHEMAS, json_schemas
from compasslib.config.values import DECIDE, shown
from compasslib.errors import InputError
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.pairs import ExplainedShare, compare_headings, is_affected
from compasslib.readers import detect, nortek
from compasslib.readers.netcdf.variables import is_ocean_contour, read_position
from compasslib.records import DEEPEST_M, Record, iso_time
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
ASKED = ("orientation", "bin_size", "first_bin")
# Keys by which files are read for the draft where they are refused without; of the north, as the error says.
UP, TRUE = {"orientation": "up"}, {"direction_reference": "true"}
RETRIED: tuple[dict[str, str], ...] = ({}, UP, TRUE, UP | TRUE)

TO_READ = "write one in a copy, or add it by hand with columns"
SILENT = ("table", "acm_table", "mmp_acm")  # formats that never state whether directions are magnetic or true
ORIENTED = ("pd0", "nortek", "netcdf", "ocean_contour", "mat", "rdi_text")  # formats that may state the orientation
SCHEMA = "# yaml-language-server: $schema={}.json\n"
CONFIG = f"""{SCHEMA.format("schema/config")}# Drafted by compass init; config/README.md of the pipeline has every key.
moorings: config/moorings
# A deposit asks for these four; they stand in every product:
# attributes: {{license: ..., institution: ..., publisher_url: ..., principal_investigator: ...}}
"""
HEAD = f"# Drafted by compass init from the files. Replace every {DECIDE} by a value, then: compass check\n"
UNITS = {
    "orientation": "up or down; the files do not tell",
    "direction_reference": "magnetic, or true where the directions hold the declination",
    "bin_size": "m, from one bin that was sent to the next",
    "first_bin": "m, from the transducer to the middle of the first bin",
    "time_format": "as '%d/%m/%Y %H:%M' or '%m/%d/%Y %H:%M'",
    "latitude": "degrees north",
    "longitude": "degrees east, west negative",
    "water_depth": "m",
}
Row = tuple[str, Any, str]  # key, value and comment; a comment alone has no key


@dataclass(frozen=True)
class Drafted:
    """One instrument as found in its files."""

    format: str
    files: tuple[str, ...]  # relative to the cruise folder
    keys: Mapping[str, Any]  # keys of the instrument other than format and files, as read; DECIDE if unknown
    record: Record | None = None
    trouble: str = ""  # reason why the files could not be read
    north: str | None = None  # reference of directions in the header of a table
    where: Mapping[str, float] = field(default_factory=dict)  # latitude, longitude, water depth, as far as stated

    @cached_property
    def in_water_s(self) -> tuple[float, float] | None:
        """First and last time below half the median pressure or depth; None if they do not show the time in the water.

        The median and the range must exceed 2 m.
        """
        for level in (self.record.pressure_dbar, self.record.depth_m) if self.record else ():
            known = level[np.isfinite(level)]
            if self.record and 2 * len(known) > len(level) and min(np.median(known), np.ptp(known)) > 2.0:
                deep = self.record.time_s[level > np.median(known) / 2.0]
                return float(deep.min()), float(deep.max())
        return None

    @cached_property
    def span_s(self) -> tuple[float, float]:
        """Begin and end of the time in the water, or else of the record; NaN without one."""
        times = self.record.time_s[np.isfinite(self.record.time_s)] if self.record else np.zeros(0)
        return self.in_water_s or ((float(times.min()), float(times.max())) if len(times) else (math.nan, math.nan))

    @cached_property
    def depths_m(self) -> Floats:
        """Known depths, or else pressures, in the water."""
        if self.record is None:
            return np.zeros(0)
        level = self.record.depth_m if np.isfinite(self.record.depth_m).any() else self.record.pressure_dbar
        start, end = self.span_s
        return level[(self.record.time_s >= start) & (self.record.time_s <= end) & np.isfinite(level)]

    @property
    def depth_m(self) -> float:
        """Median depth, 0 if unknown."""
        return max(float(np.median(self.depths_m)), 0.0) if self.depths_m.size else 0.0

    @property
    def sectors(self) -> int:
        """Number of the 36 sectors that contain headings."""
        headings = self.record.heading_deg if self.record else np.zeros(0)
        return len(np.unique(headings[np.isfinite(headings)] // angles.SECTOR_DEG))


@dataclass
class Contents:
    """Contents of the files, sorted by their use in the configuration."""

    root: Path  # cruise folder
    given: dict[str, float | None]  # latitude, longitude and water depth, as on the command line
    folders: dict[str, dict[str, Drafted]] = field(default_factory=dict)  # mooring or folder -> name -> instrument
    left: list[str] = field(default_factory=list)  # files that are not used, and why

    def inside(self, path: Path) -> str:
        """Return the path of a file relative to the cruise; below raw/ for outside files, which are linked there."""
        whole, base = Path(os.path.abspath(path)), Path(os.path.abspath(self.root))
        if whole.is_relative_to(base):
            return whole.relative_to(base).as_posix()
        return f"raw/{_name(whole.parent.name)}/{whole.name}"


def init(asked: Namespace) -> int:
    """Write the drafts, print how many decisions each leaves to the user, and return 0."""
    root = Path(asked.into)
    contents = Contents(root, {key: getattr(asked, key) for key in ("latitude", "longitude", "water_depth")})
    listed = dict[Path, None]()
    for entry in map(Path, asked.files):
        if not entry.exists():
            raise InputError(str(entry), "a file or a folder", "nothing there", "correct the path")
        listed |= dict.fromkeys(sorted(_below(entry)) if entry.is_dir() else [entry])
    paths = [path for path in listed if contents.inside(path).isprintable()]  # a YAML file cannot name others
    _sort(paths, asked.name, contents)
    texts = {f"config/moorings/{name}.yaml": text for name, text in _moorings(contents).items()}
    config = {"config/config.yaml": CONFIG}
    config |= {f"{SCHEMAS}/{name}": text for name, text in json_schemas().items()}
    unnamed = [path for path in listed if path not in paths]
    contents.left += [f"{shown(path.name)}: rename it in UTF-8, without control characters" for path in unnamed]
    left = [f"left out: {line}" for line in contents.left]
    if not texts:
        print_warnings(left)
        raise InputError(", ".join(asked.files), expected="exports of instruments", found="none", advice="name others")
    for file in texts:
        if (root / file).exists():
            advice = "draft with another --name or into another folder with --into, or move that file away"
            raise InputError(str(root / file), expected="no such file yet", found="one", advice=advice)
    for path in paths:
        if not os.path.lexists(link := root / contents.inside(path)):
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(os.path.abspath(path))
    for file, text in {**texts, **config}.items():
        if not (root / file).exists():
            (root / file).parent.mkdir(parents=True, exist_ok=True)
            (root / file).write_text(text, encoding="utf-8")
    for file, text in texts.items():
        n = len(re.findall(rf"^[^#\n]*: {DECIDE}\b", text, re.MULTILINE))
        print(f"{root / file}: {n} DECIDE entr{'y' if n == 1 else 'ies'} to replace by a value")
    print(f"then: compass check {root}")
    print_warnings(left)
    return 0


def _below(folder: Path) -> Iterable[Path]:
    for top, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name[0] != "." and not (Path(top) == folder and name in LEFT_OUT)]
        yield from (Path(top, name) for name in names if name[0] != ".")


def _sort(paths: Sequence[Path], name: str | None, contents: Contents) -> None:
    """Sort files by their use, and read the instruments."""
    groups: dict[tuple[str, str, str], list[Path]] = {}
    tables: dict[Path, detect.GuessedTable | None] = {}
    profiler = any(SCANS.search(path.name) for path in paths)
    companions = [path for path in paths if COMPANION.search(path.name)]
    for path in paths:
        kind = detect.detect_kind(path)
        form = kind.form if kind else None
        if (form != "nortek" and nortek.header_of(path) in paths) or (profiler and path in companions):
            continue  # read together with the header file of its conversion, or with its scans
        recorded = next((each for each in map(path.with_suffix, RECORDINGS) if each in paths), None)
        unpacked = path.with_suffix(".TXT")
        form = "ocean_contour" if form == "netcdf" and is_ocean_contour(path) else form
        table = tables[path] = detect.guess_columns(path) if form == "table" else None
        # Named after the folder of its files, unless that has a generic name.
        folders = (path.absolute().parent.name, Path(os.path.abspath(contents.root)).name)
        mooring = name or next((_name(folder) for folder in folders if folder.lower() not in NAMELESS), "M1")
        if path.suffix.lower() == nortek.HEADER and recorded:
            contents.left.append(f"{path}: converted from {recorded.name}, which is read")
        elif form == "mmp_acm" and unpacked in paths and unpacked != path:
            contents.left.append(f"{path}: its scans stand unpacked in {unpacked.name}")
        elif form is None:
            contents.left.append(f"{path}: {f'{kind.name}; {kind.advice}' if kind else 'its kind is not known'}")
        elif form == "table" and table is None:
            contents.left.append(f"{path}: a table whose header names no known columns; {TO_READ}")
        elif table and table.kind == "pressure":
            companions.append(path)
        elif form in ("iaga2002", "nmea0183") or (table and table.kind != "instrument"):
            what = f"a table of {table.kind} readings" if table else kind.name if kind else ""
            contents.left.append(f"{path}: {what}; name it under covariates of a mooring, or in config/calibrations")
        else:
            groups.setdefault((mooring, form, _stem(path, form)), []).append(path)
    for (mooring, form, stem), files in groups.items():
        with_scans = [path for path in companions if form == "mmp_acm" and path.parent == files[0].parent]
        others = contents.folders.setdefault(mooring, {})
        others[_free(stem, others)] = _read(form, files, tables[files[0]], with_scans, contents)
    advice = "name it under pressure_files of a profiler, or under covariates"
    profilers = {files[0].parent for (_, form, _), files in groups.items() if form == "mmp_acm"}
    alone = [path for path in companions if not COMPANION.search(path.name) and path.parent not in profilers]
    contents.left += [f"{path}: a table of pressure alone; {advice}" for path in alone]


def _read(
    form: str, files: Sequence[Path], table: detect.GuessedTable | None, companions: Sequence[Path], contents: Contents
) -> Drafted:
    """Read an instrument, with provisional values of the keys that only the user can decide."""
    keys: dict[str, Any] = {key: DECIDE for key in ASKED if key in PROVISIONAL.get(form, {})}
    if table:
        keys["columns"] = {**table.columns, **({"scale": table.scale} if table.scale else {})}
    if companions:
        keys["pressure_files"] = [contents.inside(path) for path in companions]
    settings = {**keys, **PROVISIONAL.get(form, {}), "pressure_files": companions}
    inside = tuple(contents.inside(path) for path in files)
    asked, trouble = set[str](), ""
    for retried in (each for each in RETRIED if {*each} <= asked or not each):
        try:
            record = readers.read(form, files, settings | retried)
        except InputError as error:
            trouble = trouble or str(error)
            asked |= {*_named_keys(error, readers.get_format(form).keys)}
            continue
        keys |= dict.fromkeys({"orientation"} & {*record.unstated, *retried}, DECIDE)
        where: dict[str, float] = {}
        if form == "netcdf":
            where = read_position(files[0])
        return Drafted(form, inside, keys, record, north=table.north if table else None, where=where)
    north = form not in (*SILENT, "netcdf", "mat") or (table and table.north)
    unread = [] if north else ["direction_reference"]  # what the file says of it is not known yet
    return Drafted(form, inside, keys | dict.fromkeys([*sorted(asked), *unread], DECIDE), trouble=trouble)


def _named_keys(error: InputError, keys: Iterable[str]) -> list[str]:
    """Find the keys that the advice of an error names."""
    advice = str(error).rpartition("; ")[2] if "; " in str(error) else ""
    return [key for key in keys if key != "columns" and re.search(rf"\b{key}\b", advice)]


def _moorings(contents: Contents) -> dict[str, str]:
    """Compose the file of each mooring: the instruments of a folder that recorded at the same time."""
    texts: dict[str, str] = {}
    for folder, instruments in contents.folders.items():
        groups = _deployments(instruments)
        for group in groups:
            start = min(each.span_s[0] for each in group.values())
            dated = len(groups) > 1 and math.isfinite(start)
            name = _free(f"{folder}_{datetime.fromtimestamp(start, UTC):%Y}" if dated else folder, texts)
            texts[name] = _compose(name, group, _roles(group), contents.given)
    return texts


def _deployments(instruments: Mapping[str, Drafted]) -> list[dict[str, Drafted]]:
    """Group instruments by overlap of their records; unreadable ones join the other group where there is only one."""
    groups: list[dict[str, Drafted]] = []
    for name, each in instruments.items():
        joined = [group for group in groups if any(_overlap_in_time(each, other) for other in group.values())]
        groups = [group for group in groups if group not in joined]
        groups.append({key: other for group in joined for key, other in group.items()} | {name: each})
    unread = [group for group in groups if all(each.trouble for each in group.values())]
    read = [group for group in groups if group not in unread]
    if len(read) == 1:
        return [read[0] | {key: each for group in unread for key, each in group.items()}]
    return read + unread


def _overlap_in_time(first: Drafted, other: Drafted, *, share: float = 0.1) -> bool:
    """Return whether two records overlap by a share of the shorter one, as those of one deployment."""
    (start, end), (other_start, other_end) = first.span_s, other.span_s
    # NaN, of records that could not be read, propagates.
    shorter = np.minimum(end - start, other_end - other_start)
    overlap = np.minimum(end, other_end) - np.maximum(start, other_start)
    return bool(overlap >= np.maximum(share * shorter, 0.0))


def _roles(instruments: Mapping[str, Drafted]) -> tuple[str | None, str, list[str]]:
    """Identify the affected instrument, with the evidence, and list those that recorded at the same time.

    It is the only one with headings, or that whose heading explains the directions; None if the files do not show it.
    """
    turning = {name: each.record for name, each in instruments.items() if each.record and each.sectors}
    listed = []  # content of each record, to help the user to identify the affected instrument
    for name, each in instruments.items():
        if each.record is None:
            listed.append(f"{name}: could not be read")
            continue
        bins, depth = each.record.east.shape[1], f" at {each.depth_m:.0f} m" if each.depth_m > 0.0 else ""
        listed.append(f"{name}: {bins} bin{'s' * (bins != 1)}{depth}, headings in {each.sectors} of 36 sectors")
    affected, evidence = None, f"the instrument whose compass is near iron; {'; '.join(listed)}"
    if all(each.record for each in instruments.values()):
        if len(turning) == 1:
            affected, evidence = next(iter(turning)), "the only instrument with headings"
        elif len(turning) > 1:
            affected, evidence = _by_directions(instruments, turning) or (affected, evidence)
    others = [
        name
        for name, each in instruments.items()
        if name != affected and (affected is None or _overlap_in_time(instruments[affected], each) or each.trouble)
    ]
    return affected, evidence, others if len(instruments) > 1 else []


def _by_directions(instruments: Mapping[str, Drafted], turning: Mapping[str, Record]) -> tuple[str, str] | None:
    """Find the compass whose heading explains the difference of current directions from every other instrument."""
    cut = {
        name: apply_deployment(
            record,
            start_s=instruments[name].span_s[0],
            end_s=instruments[name].span_s[1],
            water_depth=DEEPEST_M,  # unknown: no instrument is rejected
            latitude=45.0,  # depth by pressure differs by 0.5 % between pole and equator
            nominal_depth=instruments[name].depth_m or None,
        )
        for name, record in turning.items()
    }
    shares: dict[tuple[str, str], ExplainedShare] = {}
    for first, other in combinations(turning, 2):
        if parsed := compare_headings(cut[first], cut[other]):
            shares[first, other], shares[other, first] = parsed
    for name in turning:
        pairs = [(shares[key], shares[key[::-1]], key[1]) for key in shares if key[0] == name]
        if pairs and all(is_affected(share, others) for share, others, _ in pairs):
            share = min(each.share for each, _, _ in pairs)
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


# The text of a mooring file.


def _compose(
    name: str, group: Mapping[str, Drafted], roles: tuple[str | None, str, Sequence[str]],
    given: Mapping[str, float | None],
) -> str:  # fmt: skip
    """Compose the text of config/moorings/NAME.yaml.

    Args:
        group: instruments that recorded at the same time.
        roles: the affected one, None if the files do not show it, with the evidence, and possible references.
        given: latitude, longitude and water depth, as far as the user gave them.
    """
    affected, evidence, others = roles
    instruments = sorted(group.items(), key=lambda item: item[0] != affected)
    lines = [
        _line("name", name),
        *_place([each.where for _, each in instruments], given),
        *_window(list(group.values())),
        _line("declination", "auto", "by IGRF at this place, along time; or degrees east"),
        _line("compromised", affected or DECIDE, evidence),
        _reference(affected, others),
        "instruments:\n",
        *(line for role, each in instruments for line in _instrument(role, each)),
    ]
    return "".join([SCHEMA.format("../schema/mooring"), HEAD, *lines])


def _line(key: str, value: object, comment: str = "", indent: int = 0) -> str:
    text = f"{' ' * indent}{key}: {_flow(value)}"
    return f"{text}  # {comment}\n" if comment else f"{text}\n"


def _flow(value: object) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=math.inf, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...").removesuffix(os.linesep)


def _place(stated: Sequence[Mapping[str, float]], given: Mapping[str, float | None]) -> Iterator[str]:
    for key, value in given.items():
        recorded = next((each[key] for each in stated if key in each), None)
        if value is not None:
            yield _line(key, value)
        elif recorded is not None:
            yield _line(key, recorded, f"{UNITS[key]}, as the file says")
        else:
            yield _line(key, DECIDE, UNITS[key])


def _window(instruments: Iterable[Drafted]) -> list[str]:
    """Draft start and end: the time in the water by pressure or depth, else DECIDE with the span of the records."""
    submerged = [each.in_water_s for each in instruments if each.in_water_s]
    spans = submerged or [each.span_s for each in instruments if not math.isnan(each.span_s[0])]
    if not spans:
        return [_line("start", DECIDE, "UTC, in the water"), _line("end", DECIDE, "UTC")]
    start = iso_time(math.ceil(min(first for first, _ in spans)))
    end = iso_time(math.floor(max(last for _, last in spans)))
    if submerged:
        return [_line("start", start, "in the water, by pressure or depth"), _line("end", end)]
    return [
        _line("start", DECIDE, f"UTC, in the water; the first sample is of {start}"),
        _line("end", DECIDE, f"UTC; the last sample is of {end}"),
    ]


def _reference(affected: str | None, others: Sequence[str]) -> str:
    if not others:
        return "# reference: none recorded at the same time; without one only a calibration can correct\n"
    if affected and len(others) == 1:
        return _line("reference", others[0], "the other instrument that recorded at the same time")
    return _line("reference", DECIDE, f"away from iron; one name or a list of names: {', '.join(others)}")


def _instrument(name: str, drafted: Drafted, *, still_m: float = 0.3) -> list[str]:
    """Draft an instrument; its depth is not stated if it changes by less than by tides and weather."""
    depth: tuple[Any, str] = round(drafted.depth_m, 1), "m, the median of what it recorded"
    if drafted.depth_m == 0.0:
        depth = DECIDE, "m, of the transducer; the files do not tell"
    elif (change := float(np.ptp(np.quantile(drafted.depths_m, [0.01, 0.99])))) < still_m:
        found = f"m; recorded as {drafted.depth_m:.1f} with no change beyond {change:.2g}"
        depth = DECIDE, f"{found}: entered, or its pressure is stuck"
    rows: list[Row] = [
        ("format", drafted.format, ""),
        ("files", list(drafted.files) if len(drafted.files) > 1 else drafted.files[0], ""),
        ("depth", *depth),
        *(_directions(drafted, drafted.record) if drafted.record else []),
    ]
    keys = {key: value for key, value in drafted.keys.items() if key != "columns"}
    rows += [(key, value, UNITS.get(key, "") if value == DECIDE else "") for key, value in keys.items()]
    lines = [f"  {name}:\n", *([f"    # could not be read: {drafted.trouble}\n"] if drafted.trouble else [])]
    lines += [_line(*row, indent=4) if row[0] else f"    # {row[2]}\n" for row in rows]
    if columns := dict(drafted.keys.get("columns") or {}):
        scale, comment = columns.pop("scale", DECIDE), "to m/s, by the headers"
        lines += ["    columns:\n", *(_line(role, header, indent=6) for role, header in columns.items())]
        if scale == DECIDE:
            speed = np.hypot(drafted.record.east, drafted.record.north) if drafted.record else np.full(1, np.nan)
            known = np.isfinite(speed).any()
            median = f"; with 1 the median speed would be {np.nanmedian(speed):.3g} m/s" if known else ""
            comment = f"to m/s, as 0.01 for cm/s{median}"
        lines.append(_line("scale", scale, comment, indent=6))
    if drafted.record and (number := drafted.record.serial_number):
        lines.append(_line("attributes", {"serial_number": number}, indent=4))
    return lines


def _directions(drafted: Drafted, record: Record) -> list[Row]:
    """Draft orientation, reference of directions and declination."""
    rows: list[Row] = []
    silent = drafted.format in SILENT
    if drafted.format in ORIENTED and drafted.keys.get("orientation") != DECIDE:
        rows.append(("orientation", "up" if record.looks_up else "down", "as the files say"))
    north = drafted.north if silent else record.direction_reference
    bias = 0.0 if silent else record.heading_bias_deg or record.velocity_bias_deg or 0.0
    if north is None or "direction_reference" in record.unstated:
        return [*rows, ("direction_reference", DECIDE, UNITS["direction_reference"])]
    if north == "true" or silent or (drafted.format == "netcdf" and not bias):
        return [*rows, ("direction_reference", north, "as the files say")]
    if bias:  # a value here would override that of the file
        return [*rows, ("", None, f"the file's heading bias or declination, {bias:+.2f}, is taken out")]
    ask = "degrees east that are in the directions already, 0 for none; the files tell of none"
    return [*rows, ("declination_applied", DECIDE, ask)]
