"""Data of results/explore.html: the series and sections of every mooring, for one page that needs no network.

A mooring is one block of bytes: the times in float64, then each series in whole numbers of a step, which keep the page
small. A record with more samples than ``most`` is thinned to every k-th sample; a section is averaged to fewer columns.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.archive import netcdf, provenance, summary
from compasslib.archive.files import open_netcdf, read_json, read_variable
from compasslib.archive.gridded import read_section
from compasslib.preparation.references import combine_references
from compasslib.report import STYLE, words, write_page
from compasslib.report.sections import read_summary
from compasslib.types import Floats

VARIABLES = {
    "heading_recorded": "HEADING", "heading_corrected": "HEADING_CORRECTED", "flag": "HEADING_CORRECTED_QC",
    "sigma": "HEADING_CORRECTED_UNCERTAINTY", "temperature": "TEMP", "depth": "INSTRUMENT_DEPTH",
}  # fmt: skip
MISSING = np.iinfo(np.uint16).max  # in place of NaN


def write(path: str | Path, title: str, names: Sequence[str]) -> None:
    """Write the page of the moorings whose results are beside it, with the library that draws them."""
    root, share = Path(path).parent, min(1.0, 20.0 / max(len(names), 1))  # so that a thousand moorings have 20 MB
    rows = read_summary(root / "summary.csv") if names else {}
    data = json.dumps([collect(name, root, rows[name], share) for name in names], separators=(",", ":"))
    given = {"title": title, "software": provenance.software(), "data": data.replace("<", "\\u003c")}  # ends no script
    scripts = ("vendor/uPlot.iife.min.js", "templates/explore.js")
    write_page(path, "explore.html", styles=(STYLE, "vendor/uPlot.min.css"), scripts=scripts, **given)


def collect(name: str, root: Path, row: Mapping[str, str], share: float) -> dict[str, Any]:
    """Collect what the page shows of a mooring: its row of summary.csv, series, section, and spans to mark."""
    time_s, series, depth_m = read_series(root / name, most=int(10_000 * share))
    packed = [time_s.tobytes()]
    about = {key: pack(values, packed) for key, values in series.items() if np.isfinite(values).any()}
    gridded, section = root / name.partition("/")[0] / "gridded.nc", dict[str, Any]()
    if gridded.exists():
        means = read_section(gridded, columns=int(400 * share) + 1)
        parts = {"u_recorded": means.before.real, "v_recorded": means.before.imag}
        parts |= {"u_corrected": means.after.real, "v_corrected": means.after.imag}
        section = {key: pack(100.0 * values, packed, levels=400) for key, values in parts.items()}
        section |= {"edges": means.edges_s[[0, -1]].tolist(), "depths": means.depth_m.tolist()}
        section["reference"] = (np.nan_to_num(means.reference_share) >= 0.5).tolist()  # which has no recorded heading
    return {
        "name": name, "use": row["use"], "verdict": row["verdict"], "sigma": row["use_sigma_deg"], "n": len(time_s),
        "meaning": words.definitions().get(row["verdict"], "").removeprefix("Verdict: "),
        "depth": None if np.isnan(depth_m) else round(depth_m), "series": about, "section": section,
        "spans": list(describe_spans(root / name)),
        "bytes": base64.b64encode(zlib.compress(b"".join(packed), 9)).decode(),
    }  # fmt: skip


def read_series(folder: Path, most: int) -> tuple[Floats, dict[str, Floats], float]:
    """Read the times of a record, its series with NaN between samples that are far apart, and the depth of the bin."""
    with open_netcdf(folder / "corrected.nc") as nc:
        time_s = netcdf.seconds_since_1970(read_variable(nc, "TIME"))
        names = {key: name for key, name in VARIABLES.items() if name in nc.variables}
        series = {key: read_variable(nc, name).astype(float) for key, name in names.items()}
        tilts = [angles.sin_cos(read_variable(nc, name))[1] for name in ("PITCH", "ROLL") if name in nc.variables]
    if len(tilts) == 2:  # between the instrument's axis and the vertical
        series["tilt"] = np.arccos(np.prod(tilts, axis=0)) / angles.DEGREE
    bin_, pairs = summary.read_bin_currents(folder / "corrected.nc"), netcdf.read_pairs(folder / "overlap.nc")
    flows = {"recorded": bin_.recorded.velocity, "corrected": bin_.corrected.velocity}
    if len(pairs) and len(time_s):
        both, place = combine_references(pairs), np.zeros(len(pairs), dtype=int)
        place = np.clip(np.searchsorted(time_s, both.time_s), 1, max(len(time_s) - 1, 1))
        place -= both.time_s - time_s[place - 1] < time_s[place % len(time_s)] - both.time_s
        flows["reference"] = np.full(len(time_s), complex(np.nan, np.nan))
        flows["reference"][place] = summary.reference_current(both).velocity
        if both.lower_heading_deg is not None:
            series["heading_reference"] = np.full(len(time_s), np.nan)
            series["heading_reference"][place] = both.lower_heading_deg
    for key, flow in flows.items():
        series[f"direction_{key}"] = angles.direction(flow.real, flow.imag)
        if key != "recorded":  # a heading does not change a speed
            series[f"speed_{key}"] = 100.0 * np.abs(flow)
    thin = slice(None, None, -(-max(len(time_s), 1) // most))
    time_s, series = time_s[thin], {key: values[thin] for key, values in series.items()}
    step = np.diff(time_s)
    gaps = np.flatnonzero(step > 3.0 * np.median(step)) + 1 if len(step) else np.zeros(0, dtype=int)
    between = (time_s[gaps] + time_s[gaps - 1]) / 2.0
    return np.insert(time_s, gaps, between), {k: np.insert(v, gaps, np.nan) for k, v in series.items()}, bin_.depth_m


def pack(values: ArrayLike, packed: list[bytes], levels: int = 10_000) -> list[float]:
    """Append the values to the bytes as one of some levels each, row by row, and return the lowest and their step."""
    numbers = np.asarray(values, dtype=float)
    known = numbers[np.isfinite(numbers)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / levels or 1.0
    whole = np.where(np.isfinite(numbers), np.round((np.nan_to_num(numbers) - low) / step), MISSING)
    packed.append(whole.astype("<u2").tobytes())
    return [low, step]


def describe_spans(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the identified effects with a beginning or an end, and the doubtful spans, by name and UTC seconds."""
    findings = read_json(folder / "diagnosis.json")["findings"]
    spans = [(entry.get("when") or {}, words.effect_title(entry), "effect") for entry in findings]
    doubts = read_json(folder / "deviation.json")["applied"].get("doubts") or ()
    spans += [(doubt, "doubtful", "doubt") for doubt in doubts]
    for ends, text, kind in spans:
        stamps = [ends.get(end) for end in ("from", "to")]
        first, last = (np.datetime64(t.removesuffix("Z"), "s").astype(float) if t else None for t in stamps)
        if first is not None or last is not None or kind == "doubt":
            yield {"from": first, "to": last, "text": text, "kind": kind}
