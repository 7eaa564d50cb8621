"""Summaries of a mooring's results: row of summary.csv, lookup table, histograms, and the current of one bin."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.archive import netcdf
from compasslib.archive.files import (
    atomic_write,
    open_netcdf,
    read_csv,
    read_json,
    read_series,
    read_variable,
    write_csv,
)
from compasslib.archive.netcdf import seconds_since_1970
from compasslib.deviation.assessment import BIN_DEG, BINS, QUANTITIES, Counts
from compasslib.deviation.correction import LOOKUP_COLUMNS
from compasslib.records import BAD, Pairs
from compasslib.types import Complexes, Floats

COLUMNS = (
    *("name", "method", "n_pairs", "share_corrected", "rms_before_deg", "rms_after_deg", "max_deviation_deg", "folded"),
    *("verdict", "effects", "side", "warnings", "use", "use_why", "use_sigma_deg", "use_unseen_deg"),
)
STOPPED = "stopped"  # verdict of a mooring that has no results because its files cannot be used


def summary_row(name: str, folder: str | Path, roles: Iterable[str] | None = None) -> dict[str, Any]:
    """Summarize a mooring: shares, degrees, held-out rms.

    Args:
        roles: its instruments; None, without a configuration, for those of all records present.
    """
    folder = Path(folder)
    files = ("deviation.json", "assessment.json", "diagnosis.json", "work/field.json")
    fit, verdict, diagnosis, field = (read_json(folder / file) for file in files)
    heading, deviation = read_series(folder / "corrected.nc", "HEADING_CORRECTED", "DEVIATION")
    corrected = np.isfinite(heading)
    sides = [finding["side"] for finding in diagnosis["findings"]] + ["water"] * bool(diagnosis.get("current"))
    insufficient = diagnosis["why"] if diagnosis["verdict"] == "insufficient" else ""
    unexplained = []
    if left := diagnosis["unexplained"]:  # the verdict does not state its size
        unexplained = [
            f"a mismatch of {left['rms_effect_deg']:.1f}° rms {left['where']['text']} is unexplained and not "
            "corrected; it is included in the uncertainty"
        ]
    present = [path.stem for path in (folder / "work").glob("*.nc")] if roles is None else roles
    warnings = [
        *dict.fromkeys(text for text in (verdict["refuted"], fit["why"], insufficient) if text),
        *(*diagnosis.get("warnings", ()), *unexplained, *netcdf.read_pairs(folder / "overlap.nc").warnings),
        *(*fit["warnings"], *field["warnings"]),
    ]
    for role in sorted(present):
        warnings += [f"{role}: {text}" for text in netcdf.read_notes(folder / f"work/{role}.nc", "warnings")]
    use = verdict["use"]
    return {
        "name": name,
        "method": fit["fitted"]["method"],
        "n_pairs": fit["n_pairs"],
        "share_corrected": _rounded(corrected.mean() if corrected.size else 0.0, 4),
        "rms_before_deg": _rounded(verdict["before"]["rms_deg"], 2),
        "rms_after_deg": _rounded(verdict["after"]["rms_deg"], 2),
        "max_deviation_deg": _rounded(np.nanmax(np.abs(deviation)) if corrected.any() else None, 1),
        "folded": fit["folded"],
        "verdict": diagnosis["verdict"],
        "effects": " ".join(finding["effect"] for finding in diagnosis["findings"]),
        "side": " ".join(dict.fromkeys(sides)),
        "warnings": " | ".join(warnings),
        "use": use["answer"],
        "use_why": use["why"],
        "use_sigma_deg": _rounded(use["sigma_deg"], 2),
        "use_unseen_deg": _rounded(use["unseen_deg"], 1),
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(float(value), digits)


def stopped_row(name: str, why: str) -> dict[str, Any]:
    """Compose the row of a stopped mooring: no numbers, the verdict ``stopped`` and the reason as a warning."""
    said = {"name": name, "verdict": STOPPED, "warnings": why, "use": "no", "use_why": why}
    return dict.fromkeys(COLUMNS, None) | said


def write_summary(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write summary.csv."""
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def format_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format the first columns of the rows as a table for a terminal."""
    shown = COLUMNS[:8]
    lines = [shown, *(["" if r[c] is None else str(r[c]) for c in shown] for r in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(shown))]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(line, widths, strict=True)) for line in lines)


def write_lookup(path: str | Path, table: Mapping[str, Floats]) -> None:
    """Write table.csv, the lookup table of headings; only its header where the table is empty."""
    forms = ("{:.0f}", "{:.3f}", "{:.3f}", "{:.3f}", "{:.0f}")
    write_csv(path, LOOKUP_COLUMNS, [table[name] for name in LOOKUP_COLUMNS], forms)


def write_histograms(path: str | Path, histograms: Mapping[str, Counts]) -> None:
    """Write histograms.csv, one row per bin."""
    begin = np.concatenate([QUANTITIES[name] + BIN_DEG * np.arange(BINS) for name in histograms])
    columns = (np.repeat(list(histograms), BINS), begin, begin + BIN_DEG, np.concatenate(list(histograms.values())))
    write_csv(path, ("quantity", "from_deg", "to_deg", "count"), columns, ("", "{:g}", "{:g}", "{:.0f}"))


def read_histograms(path: str | Path) -> dict[str, NDArray[np.int_]]:
    """Read the counts of histograms.csv by quantity, (72,) each."""
    columns = read_csv(path, ("quantity",))
    return {name: columns["count"][columns["quantity"] == name].astype(int) for name in QUANTITIES}


GAP = complex(np.nan, np.nan)


@dataclass(frozen=True)
class CurrentSeries:
    """Time series of a current, east + i north, m/s; NaN where it is missing."""

    time_s: Floats  # (n,)
    velocity: Complexes  # (n,)


@dataclass(frozen=True)
class BinCurrents:
    """The current of one bin by the recorded and by the corrected heading."""

    depth_m: float  # median depth of the bin; NaN where no bin has a sample
    recorded: CurrentSeries
    corrected: CurrentSeries

    @property
    def mean(self) -> tuple[complex, complex]:
        """Mean recorded and corrected currents, m/s, over samples that have both; if none has, over all recorded."""
        before, after = self.recorded.velocity, self.corrected.velocity
        both = np.isfinite(before) & np.isfinite(after)
        each = before[both if both.any() else np.isfinite(before)], after[both]
        recorded, corrected = (complex(flow.mean()) if flow.size else GAP for flow in each)
        return recorded, corrected


def read_bin_currents(path: str | Path) -> BinCurrents:
    """Read the current of the nearest bin that has at least 0.9 of the samples of the fullest bin."""
    with open_netcdf(path) as nc:
        time_s = seconds_since_1970(read_variable(nc, "TIME"))
        count = np.sum(read_variable(nc, "UCUR_RECORDED_QC") < BAD, axis=0)
        shown = int(np.argmax(count >= 0.9 * count.max()))
        bins, flows = slice(shown, shown + 1), []
        for end in ("_RECORDED", ""):
            names = (f"UCUR{end}", f"VCUR{end}", f"UCUR{end}_QC")
            east, north, quality = (read_variable(nc, name, bins=bins)[:, 0] for name in names)
            flows.append(CurrentSeries(time_s, np.where(quality < BAD, east + 1j * north, GAP)))
        depth = read_variable(nc, "DEPTH", bins=bins)[:, 0]
    known = depth[np.isfinite(depth)] if count.any() else np.zeros(0)
    return BinCurrents(float(np.median(known)) if known.size else float("nan"), *flows)


def reference_current(pairs: Pairs) -> CurrentSeries:
    """Extract the reference's current at the pairs."""
    return CurrentSeries(pairs.time_s, pairs.lower_east + 1j * pairs.lower_north)
