"""``compass init``: a draft of config and YAML files from what exports hold; no file that is there is touched."""

from __future__ import annotations

import os
import re
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from compasslib import readers
from compasslib.command import gathered
from compasslib.config import draft
from compasslib.config.draft import Place, Told
from compasslib.config.values import shown
from compasslib.core.errors import InputError
from compasslib.core.records import Record
from compasslib.core.types import Floats
from compasslib.readers import headers, iaga2002, recognition

LEFT_OUT = ("config", "results")  # folders of a cruise that hold no exports
NAMELESS = ("raw", "data", "exports", "")  # folders whose name tells no mooring
MOORED_STEP_S = 60.0  # moored profilers average over longer; two that do not stand on one frame
IN_WATER = 0.5  # of the median depth
SHALLOWEST_M = 2.0  # a median depth that says anything
PIECE = re.compile(r"\.\d{3}$")  # of a PD0 file that was cut by its recorder
SCANS, COMPANION = re.compile(r"A(\d{7})\.\w+$"), re.compile(r"[CE](\d{7})\.\w+$")  # of a moored profiler
# What a format asks of a person; to draft, the files are read with these in place.
PROVISIONAL: dict[str, dict[str, object]] = {
    "pd12": {"orientation": "up", "bin_size": 1.0, "first_bin": 1.0},
    "netcdf": {"direction_reference": "magnetic"},
}
ASKED = ("orientation", "bin_size", "first_bin")
SILENT = ("table", "acm_table", "mmp_acm")  # formats that never tell to which north they count


@dataclass
class Found:
    """What stands in the files, sorted by what it is to be."""

    place: Place  # what the person said
    instruments: dict[str, dict[str, Told]] = field(default_factory=dict)  # mooring -> name -> what is told
    calibrations: dict[str, str] = field(default_factory=dict)  # name -> text
    series: dict[str, dict[str, object]] = field(default_factory=dict)  # covariates by name
    left: list[str] = field(default_factory=list)  # what has no place, and why


def run(asked: Namespace) -> int:
    """Write the drafts, say what a person must decide, and return 0.

    Raises:
        InputError: nothing can be drafted, or a file is there already.
    """
    root = Path(asked.into)
    given = _given(asked.files)
    paths = [path for path in given if _inside(path, root).isprintable()]  # a YAML file can name no other
    place = Place(asked.latitude, asked.longitude, asked.water_depth)
    found = _sorted(paths, root, asked.name, Found(place))
    texts = {
        f"config/moorings/{name}.yaml": draft.mooring(name, told, found.series, place)
        for name, told in found.instruments.items()
    } | {f"config/calibrations/{name}.yaml": text for name, text in found.calibrations.items()}
    found.left += [
        f"{shown(path.name)}: rename it in UTF-8, without control characters" for path in given if path not in paths
    ]
    left = [f"left out: {line}" for line in found.left]
    if not texts:
        gathered.tell(left)
        raise InputError(", ".join(asked.files), expected="exports of instruments", found="none", advice="name others")
    config = {"config/config.yaml": draft.CONFIG.format(moorings="config/moorings" if found.instruments else "[]")}
    _write(root, _links(paths, root), texts, {} if (root / "config/config.yaml").exists() else config)
    _say(root, texts)
    gathered.tell(left)
    return 0


def _given(files: Sequence[str]) -> list[Path]:
    paths = []
    for name in files:
        path = Path(name)
        if not path.exists():
            raise InputError(name, expected="a file or a folder", found="nothing there", advice="correct the path")
        paths += sorted(_below(path)) if path.is_dir() else [path]
    return list(dict.fromkeys(paths))


def _below(folder: Path) -> Iterable[Path]:
    for top, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name[0] != "." and not (Path(top) == folder and name in LEFT_OUT)]
        yield from (Path(top, name) for name in names if name[0] != ".")


def _inside(path: Path, root: Path) -> str:
    """Return the path of a file from the cruise folder; one that stands elsewhere is linked to below raw/."""
    whole, base = Path(os.path.abspath(path)), Path(os.path.abspath(root))
    if whole.is_relative_to(base):
        return whole.relative_to(base).as_posix()
    return f"raw/{_name(whole.parent.name)}/{whole.name}"


def _links(paths: Iterable[Path], root: Path) -> dict[Path, Path]:
    ends = {root / _inside(path, root): Path(os.path.abspath(path)) for path in paths}
    return {link: path for link, path in ends.items() if not os.path.lexists(link)}


def _sorted(paths: Sequence[Path], root: Path, name: str | None, found: Found) -> Found:
    tables: dict[Path, headers.Meaning | None] = {}
    groups: dict[tuple[str, str, str], list[Path]] = {}
    for path in paths:
        kind = recognition.recognise(path)
        form = kind.form if kind else None
        if COMPANION.search(path.name) and any(SCANS.search(other.name) for other in paths):
            continue  # it goes with its scans
        if form == "mmp_acm" and (text := path.with_suffix(".TXT")) in paths and text != path:
            found.left.append(f"{path}: its scans stand unpacked in {text.name}")
            continue
        if form == "table":
            tables[path] = headers.meaning(path)
        table = tables.get(path)
        if form is None or (form == "table" and table is None):
            what = "nobody knows what it is" if kind is None else f"{kind.name}; {kind.advice}"
            found.left.append(f"{path}: {'a table whose header tells no columns' if form == 'table' else what}")
        elif form in ("iaga2002", "nmea0183") or (table and table.kind != "instrument"):
            _aside(path, root, form, table, found)
        else:
            groups.setdefault((name or _mooring(path, root), form, _stem(path, form)), []).append(path)
    for (mooring, form, stem), files in groups.items():
        told = _told(form, files, root, tables.get(files[0]), paths)
        others = found.instruments.setdefault(mooring, {})
        others[_free(stem, others)] = told
    _heads(found)
    return found


def _aside(path: Path, root: Path, form: str, table: headers.Meaning | None, found: Found) -> None:
    """Take what is no instrument: a calibration's file, or a series beside the moorings."""
    file, name = _inside(path, root), _free(_name(path.stem), found.calibrations)
    if form == "iaga2002":
        found.series["declination_observatory"] = {"format": form, "files": [file]}
        place, comments = ({}, {}) if _tells_place(path) else _place(found.place, "degrees, of the observatory")
        found.calibrations[name] = draft.calibration("declination", {"file": file, **place}, comments)
    elif form == "nmea0183":
        found.calibrations[name] = draft.calibration("swing", {"file": file, "format": form}, {})
    elif table and table.kind == "series":
        found.series[_name(table.columns["value"])] = {"format": "table", "files": file, "columns": table.columns}
    elif table:
        columns = {role: header for role, header in table.columns.items() if role != header}
        where = "degrees, where it was done; needed to carry it to a mooring, as the date is"
        place, comments = _place(found.place, where)
        keys = {"file": file, **({"columns": columns} if columns else {}), **place, "date": None}
        found.calibrations[name] = draft.calibration(table.kind, keys, comments)


def _place(said: Place, where: str) -> tuple[dict[str, object], dict[str, str]]:
    """Return the keys of a calibration's place as the person said it, and the question where none was said."""
    unsaid = None in (said.latitude, said.longitude)
    keys: dict[str, object] = {"latitude": said.latitude, "longitude": said.longitude}
    return keys, {"latitude": f"{draft.DECIDE} {where}"} if unsaid else {}


def _tells_place(path: Path) -> bool:
    try:
        series = iaga2002.read([path])
    except InputError:
        return True  # a check refuses it in its own words
    return bool(np.isfinite(series.latitude + series.longitude))


def _told(form: str, files: Sequence[Path], root: Path, table: headers.Meaning | None, paths: Sequence[Path]) -> Told:
    keys: dict[str, object] = {key: None for key in ASKED if key in PROVISIONAL.get(form, {})}
    if table:
        keys["columns"] = {**table.columns, **({"scale": table.scale} if table.scale else {})}
    companions = [path for path in paths if form == "mmp_acm" and COMPANION.search(path.name)]
    companions = [path for path in companions if path.parent == files[0].parent]
    if companions:
        keys["pressure_files"] = [_inside(path, root) for path in companions]
    settings = {**keys, **PROVISIONAL.get(form, {}), "pressure_files": companions}
    inside = tuple(_inside(path, root) for path in files)
    try:
        record = readers.read(form, files, settings)
    except InputError as error:
        return Told(form, inside, keys, trouble=str(error))
    told = _of_record(form, inside, keys, record)
    if form != "netcdf":
        return told
    from compasslib.readers.netcdf import place

    where = place.of(files[0])
    both = (where["latitude"], where["longitude"]) if {"latitude", "longitude"} <= set(where) else None
    return replace(told, place=both, water_depth_m=where.get("water_depth"))


def _of_record(form: str, files: tuple[str, ...], keys: Mapping[str, object], record: Record) -> Told:
    start, end, surfaced = _in_water(record)
    level = record.depth_m if np.isfinite(record.depth_m).any() else record.pressure_dbar
    inside = (record.time_s >= start) & (record.time_s <= end) & np.isfinite(level)
    depth = float(np.median(level[inside])) if inside.any() else np.nan
    speed = np.hypot(record.east, record.north)
    north = None if form in SILENT else record.direction_reference
    return Told(
        form, files, keys, "", start, end, surfaced,
        step_s=float(np.median(np.diff(record.time_s))) if len(record.time_s) > 1 else np.nan,
        bins=record.east.shape[1],
        has_compass=bool(np.isfinite(record.heading_deg).any()),
        depth_m=depth if depth > 0.0 else np.nan,
        depth_range_m=float(np.ptp(np.quantile(level[inside], [0.01, 0.99]))) if inside.any() else np.nan,
        looks_up=record.looks_up if form in ("pd0", "nortek", "netcdf", "rdi_text") else None,
        heading_bias_deg=record.heading_bias_deg or record.velocity_bias_deg,
        direction_reference=north,
        speed=float(np.nanmedian(speed)) if np.isfinite(speed).any() else np.nan,
        serial_number=record.serial_number,
    )  # fmt: skip


def _in_water(record: Record) -> tuple[float, float, bool]:
    """Return the first and last time in the water, and whether pressure or depth tells them."""
    times = record.time_s[np.isfinite(record.time_s)]
    for level in (record.pressure_dbar, record.depth_m):
        known = level[np.isfinite(level)]
        if 2 * len(known) > len(level) and np.median(known) > SHALLOWEST_M and np.ptp(known) > SHALLOWEST_M:
            deep: Floats = record.time_s[level > IN_WATER * np.median(known)]
            return float(deep.min()), float(deep.max()), True
    return float(times.min()), float(times.max()), False


def _heads(found: Found) -> None:
    """Take two quick PD0 profilers of one folder for two heads of one frame."""
    for mooring, instruments in list(found.instruments.items()):
        quick = [one for one in instruments.values() if one.format == "pd0" and one.step_s < MOORED_STEP_S]
        if len(quick) == len(instruments) == 2 and all(len(one.files) == 1 for one in quick):
            files = [one.files[0] for one in quick]
            keys = {"file": files, "latitude": None, "longitude": None, "date": None}
            ask = f"{draft.DECIDE} degrees, where it was done; needed to carry it to a mooring, as the date is"
            found.calibrations[_free(mooring, found.calibrations)] = draft.calibration(
                "two_heads", keys, {"file": "head a and head b: they sample too quickly to be moored", "latitude": ask}
            )
            del found.instruments[mooring]


def _mooring(path: Path, root: Path) -> str:
    """Return the mooring's name: the folder of its files, where that has a name of its own."""
    folders = (path.absolute().parent.name, Path(os.path.abspath(root)).name)
    return next((_name(name) for name in folders if name.lower() not in NAMELESS), "M1")


def _stem(path: Path, form: str) -> str:
    """Return what the files of one instrument have in common."""
    if form == "mmp_acm":
        return _name(path.suffix.lstrip(".").lower() + "_" + SCANS.sub("", path.name).strip("_ "))
    return _name(path.name.removesuffix(path.suffix) if form != "pd0" or PIECE.search(path.name) else path.stem)


def _name(text: str) -> str:
    """Return a text as a name may be written."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).lstrip("_.-")[:50].rstrip("_.-") or "unnamed"


def _free(name: str, taken: Iterable[str]) -> str:
    used = set(taken)
    return next(one for k in range(1, 10000) if (one := name if k == 1 else f"{name}_{k}") not in used)


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


def _say(root: Path, texts: Mapping[str, str]) -> None:
    for file, text in texts.items():
        n = draft.decisions(text)
        print(f"{root / file}: " + (f"{n} value{'s' * (n != 1)} to decide" if n else "nothing to decide"))
    print(f"then: compass check {root}")
