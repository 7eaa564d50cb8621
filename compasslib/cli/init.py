"""``compass init``: draft the configuration files of a cruise from instrument exports; existing files are unchanged."""

import math
import os
import re
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import readers
from compasslib.calibrations.swing import observations
from compasslib.cli.results import print_warnings
from compasslib.config import draft
from compasslib.config.cruise import SCHEMAS, json_schemas
from compasslib.config.draft import Drafted
from compasslib.config.schema import KNOWN_SERIES
from compasslib.config.values import DECIDE, shown
from compasslib.errors import InputError
from compasslib.readers import detect, iaga2002, nmea, nortek
from compasslib.readers.netcdf.variables import is_ocean_contour, read_position
from compasslib.readers.table import read_series

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


@dataclass
class Contents:
    """Contents of the files, sorted by their use in the configuration."""

    root: Path  # cruise folder
    given: dict[str, float | None]  # latitude, longitude and water depth, as on the command line
    folders: dict[str, dict[str, Drafted]] = field(default_factory=dict)  # mooring or folder -> name -> instrument
    calibrations: dict[str, str] = field(default_factory=dict)  # name -> text
    # Keys of covariates by name, their mooring (None: all), and begin and end, UTC seconds.
    series: dict[str, tuple[dict[str, Any], str | None, float, float]] = field(default_factory=dict)
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
    config = {"config/config.yaml": draft.CONFIG.format(moorings="config/moorings" if texts else "[]")}
    config |= {f"{SCHEMAS}/{name}": text for name, text in json_schemas().items()}
    texts |= {f"config/calibrations/{name}.yaml": text for name, text in contents.calibrations.items()}
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
        if (form != "nortek" and nortek.header_of(path) in {*paths} - {path}) or (profiler and path in companions):
            continue  # read together with the header file of its conversion, or with its scans
        recorded = next((each for each in map(path.with_suffix, RECORDINGS) if each in paths), None)
        unpacked = path.with_suffix(".TXT")
        form = "ocean_contour" if form == "netcdf" and is_ocean_contour(path) else form
        try:
            table = tables[path] = detect.guess_columns(path) if form == "table" else None
        except InputError as error:  # a text in an unknown encoding
            contents.left.append(str(error))
            continue
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
            advice = "write one in a copy, with a row for each sample and cell, or add it by hand with columns"
            contents.left.append(f"{path}: a table whose header names no known columns; {advice}")
        elif table and table.kind == "pressure":
            companions.append(path)
        elif table and table.kind == "series":
            _add_series(path, table, mooring, contents)
        elif form in ("iaga2002", "nmea0183") or (table and table.kind != "instrument"):
            _add_calibration(path, form, table, contents)
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


def _add_calibration(path: Path, form: str, table: detect.GuessedTable | None, contents: Contents) -> None:
    """Add an observatory's series, a ship's log or a table of readings; a value is None if optional and unknown."""
    file, name = contents.inside(path), _free(_name(path.stem), contents.calibrations)
    keys: dict[str, Any] = {"file": file}
    comments = {"date": "when it was done", "longitude": draft.UNITS["longitude"]}
    place = {key: contents.given[key] for key in ("latitude", "longitude")}
    known = None not in place.values()
    if form == "iaga2002":
        kind, placed = "declination", True
        with suppress(InputError):  # compass check will report the error
            series = iaga2002.read([path])
            placed = bool(np.isfinite(series.latitude + series.longitude))
            logged, _, begin, end = contents.series.get(
                "declination_observatory", ({"files": []}, None, np.inf, -np.inf)
            )
            span = min(begin, float(series.time_s[0])), max(end, float(series.time_s[-1]))
            covariate = {"format": form, "files": [*logged["files"], file]}
            contents.series["declination_observatory"] = (covariate, None, *span)
        keys |= {} if placed else place if known else dict.fromkeys(place, DECIDE)
        comments["latitude"] = "degrees north, of the observatory"
    elif form == "nmea0183":
        kind, parsed = "swing", nmea.read_any(path)
        why = "no magnetic heading (HDG or HDM) with a course (RMC or VTG)"
        gap = 360.0 if parsed is None else observations.widest_gap(parsed[2].heading_deg)
        if parsed and gap > observations.REFUSED_GAP_DEG:
            why = f"headings that leave {gap:.0f}° of the circle empty"
        if parsed is None or gap > observations.REFUSED_GAP_DEG:
            contents.left.append(f"{path}: an NMEA 0183 log with {why}: no swing")
            return
        columns, talkers, _ = parsed
        keys |= {"format": form, **({"columns": columns} if columns else {})}
        keys |= {"talker": DECIDE} if talkers else {}
        comments["talker"] = f"{', '.join(talkers)} send headings; HC is a magnetic compass"
    else:
        assert table is not None
        kind, columns = table.kind, {role: header for role, header in table.columns.items() if role != header}
        unknown = DECIDE if kind == "swing" else None  # its courses are true, its compass magnetic
        keys |= {"columns": columns} if columns else {}
        keys |= place if known else dict.fromkeys(place, unknown)
        keys |= {} if "time_utc" in table.columns and unknown else {"date": unknown}
        comments["latitude"] = "degrees north, where and when it was done: needed to carry it to a mooring"
    contents.calibrations[name] = draft.calibration(kind, keys, comments)


def _add_series(path: Path, table: detect.GuessedTable, mooring: str, contents: Contents) -> None:
    keys: dict[str, Any] = {"format": "table", "files": contents.inside(path), "columns": table.columns}
    try:
        time_s, _, _ = read_series({"files": [path], "columns": table.columns})
    except InputError as error:
        asked = dict.fromkeys(_named_keys(error, readers.TABLE_KEYS), DECIDE)
        if not asked:
            contents.left.append(str(error))
            return
        keys, time_s = keys | asked, np.array([-np.inf, np.inf])
    name = _name(table.columns["value"])
    name = _free(f"{name}_logged" if name in KNOWN_SERIES else name, contents.series)
    contents.series[name] = (keys, mooring, float(time_s[0]), float(time_s[-1]))


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
    north = form not in (*draft.SILENT, "netcdf", "mat") or (table and table.north)
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
        groups, used = _deployments(instruments), set[str]()
        for group in groups:
            start, end = min(each.span_s[0] for each in group.values()), max(each.span_s[1] for each in group.values())
            dated = len(groups) > 1 and math.isfinite(start)
            name = _free(f"{folder}_{datetime.fromtimestamp(start, UTC):%Y}" if dated else folder, texts)
            series = {
                key: keys
                for key, (keys, of, begins, ends) in contents.series.items()
                if of in (None, folder) and not (ends < start or begins > end)
            }
            used |= {*series}
            texts[name] = draft.mooring(name, group, _roles(group), series, contents.given)
        contents.left += [
            f"{keys['files']}: no instrument of {folder} recorded at the time of this series"
            for key, (keys, of, _, _) in contents.series.items()
            if of == folder and key not in used
        ]
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
    """Identify the affected instrument, None where the files do not show it, the evidence, and possible references."""
    turning = [name for name, each in instruments.items() if each.record and each.sectors]
    listed = []  # content of each record, to help the user to identify the affected instrument
    for name, each in instruments.items():
        if each.record is None:
            listed.append(f"{name}: could not be read")
            continue
        bins, depth = each.record.east.shape[1], f" at {each.depth_m:.0f} m" if each.depth_m > 0.0 else ""
        listed.append(f"{name}: {bins} bin{'s' * (bins != 1)}{depth}, headings in {each.sectors} of 36 sectors")
    affected, evidence = None, f"the instrument whose compass is near iron; {'; '.join(listed)}"
    if len(turning) == 1 and all(each.record for each in instruments.values()):
        affected, evidence = turning[0], "the only instrument with headings"
    others = [
        name
        for name, each in instruments.items()
        if name != affected and (affected is None or _overlap_in_time(instruments[affected], each) or each.trouble)
    ]
    return affected, evidence, others if len(instruments) > 1 else []


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
