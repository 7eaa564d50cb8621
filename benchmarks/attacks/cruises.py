"""Cruises with known truth to which errors are added: raw files as arrays, and the outcome of processing."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
import yaml

from compasslib import angles
from compasslib.archive import netcdf, summary
from compasslib.archive.files import read_json
from compasslib.errors import InputError
from compasslib.pipeline.process import process_mooring

HOUR_S = 3600.0
HEADING, FIXED, VARIABLE, VELOCITY = 18, 0x0000, 0x0080, 0x0100
BAD = -32768  # fill value of velocities in PD0
MARGIN_DEG, TIMES, COVERED, FAR_SIGMAS, FAR_SHARE = 2.0, 2.0, 0.85, 6.0, 0.01  # thresholds of ``is_wrong``
KEPT = 0.5  # share of the original flags 1 that are still set, above which a wrong product counts as called good


class NotApplicableError(Exception):
    """An attack that cannot be applied to a base."""


@dataclass
class Cruise:
    """One cruise of one mooring to which an attack adds an error; ``save`` writes the changes."""

    folder: Path
    base: str
    settings: dict[str, Any]
    time_s: np.ndarray  # times of the samples by the clock of the affected instrument, (n,)
    heading_deg: np.ndarray  # correct, magnetic, (n,)
    bases: Path
    opened: dict[str, Any] = field(default_factory=dict)
    true_north: bool = False  # whether the true heading is scored, not the magnetic one
    undecidable: bool = False  # whether no record can show the error, such as a constant, which is the same as A

    @classmethod
    def copy(cls, bases: Path, base: str, folder: Path) -> Cruise:
        """Copy a base to a new folder."""
        shutil.copytree(bases / base, folder)
        settings = yaml.safe_load((folder / "config/moorings/M.yaml").read_text())
        time_s, heading_deg = np.load(bases / f"{base}.npy")
        return cls(folder, base, settings, time_s, heading_deg, bases)

    @property
    def top(self) -> dict[str, Any]:
        return self.settings["instruments"]["top"]

    @property
    def deep(self) -> dict[str, Any]:
        return self.settings["instruments"]["deep"]

    @property
    def is_real(self) -> bool:
        return self.base.startswith("real")

    def path(self, role: str) -> Path:
        return self.folder / self.settings["instruments"][role]["files"]

    def record(self, role: str = "top") -> Pd0 | Table:
        """Open the samples of an instrument, which can be changed in place."""
        if role not in self.opened:
            kind = Table if self.settings["instruments"][role]["format"] == "table" else Pd0
            self.opened[role] = kind(self.path(role))
        return self.opened[role]

    def pd0(self, role: str = "top") -> Pd0:
        """Open the ensembles of an instrument that logs PD0.

        Raises:
            NotApplicableError: if the file is a table.
        """
        made = self.record(role)
        if not isinstance(made, Pd0):
            raise NotApplicableError
        return made

    def table(self) -> Table:
        """Open the rows of a reference that is a table.

        Raises:
            NotApplicableError: if the file is PD0.
        """
        made = self.record("deep")
        if not isinstance(made, Table):
            raise NotApplicableError
        return made

    def shift(self, role: str, by_s: np.ndarray | float) -> None:
        """Set the clock of an instrument ahead."""
        self.record(role).shift(by_s)
        if role == "top":
            nodes = np.linspace(self.time_s[0], self.time_s[-1], np.size(by_s)) if np.size(by_s) > 1 else self.time_s
            self.time_s = self.time_s + np.interp(self.time_s, nodes, np.broadcast_to(by_s, nodes.shape))

    def truth_at(self, time_s: np.ndarray) -> np.ndarray:
        """Look up the correct magnetic heading at times of the affected instrument's clock, NaN if unknown."""
        order = np.argsort(self.time_s, kind="stable")
        known = self.time_s[order]
        at = np.clip(np.searchsorted(known, time_s - 1.0), 0, len(known) - 1)
        return np.where(np.abs(known[at] - time_s) < 2.0, self.heading_deg[order][at], np.nan)

    def set_truth(self, heading_deg: np.ndarray) -> None:
        """Set the correct headings of the affected instrument at its samples, degrees."""
        self.time_s, self.heading_deg = self.record().time_s, heading_deg

    def cut_truth(self, within: tuple[float, float], *, keep: bool) -> None:
        """Exclude the samples outside a span, or inside it (``keep`` False), from scoring."""
        time = self.record().time_s
        inside = (time >= within[0]) & (time <= within[1])
        self.set_truth(np.where(inside == keep, self.truth_at(time), np.nan))

    def add_reference(self, name: str, record: Pd0 | Table) -> None:
        """Write a record next to the reference's file and add it as an instrument with the same settings."""
        path = self.path("deep").with_stem(name)
        record.save(path)
        described = deepcopy(self.deep) | {"files": str(path.relative_to(self.folder))}
        self.settings["instruments"][name] = described

    def another(self) -> str:
        """Name another base with files of the same kinds.

        Raises:
            NotApplicableError: if there is none.
        """
        others = {"pd0": "beam", "beam": "pd0", "plain": "strong", "weak": "plain", "fast": "weak", "strong": "fast"}
        others |= {"profiler": "fast"}
        if self.base not in others:
            raise NotApplicableError
        return others[self.base]

    def record_of(self, base: str, role: str) -> Pd0 | Table:
        """Read the samples of an instrument of another base."""
        settings = yaml.safe_load((self.bases / base / "config/moorings/M.yaml").read_text())["instruments"][role]
        return (Table if settings["format"] == "table" else Pd0)(self.bases / base / settings["files"])

    def declination_deg(self) -> float:
        """Compute the mean declination of the unmodified run, degrees east."""
        return float(np.mean(_declination(self, np.array(self.span()))))

    def span(self) -> tuple[float, float]:
        """Compute the times of deployment and recovery, seconds since 1970."""
        first, last = (str(self.settings[key]).replace("Z", "+00:00") for key in ("start", "end"))
        return datetime.fromisoformat(first).timestamp(), datetime.fromisoformat(last).timestamp()

    def save(self) -> None:
        """Write all opened files and the YAML file."""
        for role, content in self.opened.items():
            content.save(self.path(role))
        (self.folder / "config/moorings/M.yaml").write_text(yaml.safe_dump(self.settings, sort_keys=False))


def stamps(time_s: np.ndarray) -> np.ndarray:
    """Format times as text."""
    return np.char.add(np.datetime_as_string(np.rint(time_s).astype("datetime64[s]")), "Z")


class Table:
    """Rows of an instrument that is a table: time_utc, u_cm_s, v_cm_s, and heading_deg of the affected instrument."""

    def __init__(self, path: Path) -> None:
        self.frame = pd.read_csv(path)

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def time_s(self) -> np.ndarray:
        text = pd.to_datetime(self.frame["time_utc"].astype(str), utc=True, format="ISO8601").dt.tz_localize(None)
        return text.to_numpy().astype("datetime64[ms]").astype(float) / 1000.0

    @property
    def heading(self) -> np.ndarray:
        return self.frame["heading_deg"].to_numpy(dtype=float)

    def put_heading(self, values: np.ndarray) -> None:
        """Write headings unchanged, in any unit and range."""
        self.frame["heading_deg"] = values

    def set_heading(self, degrees: np.ndarray, where: Any = slice(None)) -> None:
        new = self.heading.copy()
        new[where] = np.mod(degrees, 360.0)
        self.put_heading(new)

    @property
    def flow(self) -> np.ndarray:
        """East + i north, mm/s, (n, 1)."""
        return 10.0 * (self.frame["u_cm_s"] + 1j * self.frame["v_cm_s"]).to_numpy()[:, None]

    @flow.setter
    def flow(self, values: np.ndarray) -> None:
        self.frame["u_cm_s"], self.frame["v_cm_s"] = values[:, 0].real / 10.0, values[:, 0].imag / 10.0

    def turn(self, degrees: Any) -> None:
        """Rotate the velocities clockwise."""
        self.flow = self.flow * np.exp(-1j * np.deg2rad(np.broadcast_to(degrees, len(self))))[:, None]

    def shift(self, by_s: Any) -> None:
        """Shift the time stamps of the samples to later times."""
        self.frame["time_utc"] = stamps(self.time_s + by_s)

    def take(self, which: np.ndarray) -> None:
        """Select samples by mask or index."""
        self.frame = self.frame[which] if which.dtype == bool else self.frame.iloc[which]

    def copy_samples(self, of: Table, to: np.ndarray, source: np.ndarray) -> None:
        """Overwrite samples by those of a record, except their times."""
        columns = [name for name in self.frame.columns if name != "time_utc"]
        self.frame.iloc[to, self.frame.columns.get_indexer(columns)] = of.frame[columns].to_numpy()[source]

    def save(self, path: Path) -> None:
        self.frame.to_csv(path, index=False, float_format="%.2f")


class Pd0:
    """Valid ensembles of a PD0 file, all of one length, as bytes that can be changed; checksums are recomputed."""

    def __init__(self, path: Path) -> None:
        raw = np.frombuffer(path.read_bytes(), np.uint8)
        self.size = int(raw[2:4].view("<u2")[0]) + 2
        starts = [match.start() for match in re.finditer(re.escape(raw[:4].tobytes()), raw.tobytes())]
        whole = [k for k in starts if k + self.size <= raw.size]
        rows = np.stack([raw[k : k + self.size] for k in whole])
        good = (rows[:, :-2].sum(axis=1, dtype=np.uint32) & 0xFFFF) == rows[:, -2:].copy().view("<u2")[:, 0]
        self.rows = rows[good].copy()
        self.starts: dict[int, int] = {}
        for k in range(int(self.rows[0, 5])):
            place = int(self.rows[0, 6 + 2 * k : 8 + 2 * k].view("<u2")[0])
            self.starts[int(self.rows[0, place : place + 2].view("<u2")[0])] = place

    def __len__(self) -> int:
        return len(self.rows)

    def get(self, block: int, offset: int, kind: str = "<u2") -> np.ndarray:
        """Read one value per ensemble, (n,)."""
        place = self.starts[block] + offset
        return self.rows[:, place : place + np.dtype(kind).itemsize].copy().view(kind)[:, 0]

    def put(self, block: int, offset: int, values: Any, kind: str = "<u2", where: Any = slice(None)) -> None:
        """Write one value per ensemble."""
        place = self.starts[block] + offset
        old = self.get(block, offset, kind)
        old[where] = values
        self.rows[:, place : place + np.dtype(kind).itemsize] = old[:, None].view(np.uint8)

    @property
    def heading(self) -> np.ndarray:
        return self.get(VARIABLE, HEADING) / 100.0

    def set_heading(self, degrees: np.ndarray, where: Any = slice(None)) -> None:
        self.put(VARIABLE, HEADING, np.rint(100.0 * np.mod(degrees, 360.0)).astype(int) % 36000, where=where)

    @property
    def velocity(self) -> np.ndarray:
        """mm/s, (n, cells, 4); -32768 where bad."""
        cells, place = int(self.get(FIXED, 9, "u1")[0]), self.starts[VELOCITY] + 2
        flat = self.rows[:, place : place + 8 * cells].copy().view("<i2")
        return flat.reshape(len(self), cells, 4)

    @velocity.setter
    def velocity(self, values: np.ndarray) -> None:
        cells, place = values.shape[1], self.starts[VELOCITY] + 2
        flat = values.astype("<i2").reshape(len(self), -1).view(np.uint8)
        self.rows[:, place : place + 8 * cells] = flat

    @property
    def is_beam(self) -> bool:
        """Whether the velocities are along the beams, not rotated by a compass."""
        return not int(self.get(FIXED, 25, "u1")[0]) & 0b11000

    @property
    def flow(self) -> np.ndarray:
        """East + i north, mm/s, (n, cells), NaN where bad.

        Raises:
            NotApplicableError: if the velocities are along the beams.
        """
        if self.is_beam:
            raise NotApplicableError
        pair = self.velocity[..., :2].astype(float)
        pair[(pair == BAD).any(-1)] = np.nan
        return pair[..., 0] + 1j * pair[..., 1]

    @flow.setter
    def flow(self, values: np.ndarray) -> None:
        pair = np.rint(np.stack([values.real, values.imag], axis=-1))
        new = self.velocity.copy()
        new[..., :2] = np.where(np.isfinite(pair).all(-1, keepdims=True), np.clip(pair, -32767, 32767), BAD)
        self.velocity = new

    def turn(self, degrees: Any) -> None:
        """Rotate velocities in earth coordinates clockwise; those along the beams are not changed."""
        if self.is_beam:
            return
        old = self.velocity.astype(float)
        flow = (old[..., 0] + 1j * old[..., 1]) * np.exp(-1j * np.deg2rad(np.broadcast_to(degrees, len(self))))[:, None]
        new = np.rint(np.stack([flow.real, flow.imag, old[..., 2], old[..., 3]], axis=-1))
        self.velocity = np.where((old[..., :2] == BAD).any(-1, keepdims=True), old, new)

    def take(self, which: np.ndarray) -> None:
        """Select ensembles by mask or index."""
        self.rows = self.rows[which]

    def copy_samples(self, of: Pd0, to: np.ndarray, source: np.ndarray) -> None:
        """Overwrite ensembles by those of a record, except their times.

        Raises:
            NotApplicableError: if length or coordinates differ.
        """
        if of.size != self.size or of.is_beam != self.is_beam:
            raise NotApplicableError
        times = self.time_s
        self.rows[to] = of.rows[source]
        self.shift(times - self.time_s)

    def put_heading(self, values: np.ndarray) -> None:
        """Write headings unchanged, in any unit and range, as sixteen bits."""
        self.put(VARIABLE, HEADING, np.rint(100.0 * values).astype(np.int64) & 0xFFFF)

    @property
    def time_s(self) -> np.ndarray:
        year, month, day, hour, minute, second, cent = (self.get(VARIABLE, 4 + k, "u1").astype(int) for k in range(7))
        months = (np.where(year < 70, 2000, 1900) + year - 1970) * 12 + month - 1
        days = months.astype("datetime64[M]").astype("datetime64[D]").astype(float) + day - 1
        return days * 86400.0 + hour * 3600.0 + minute * 60.0 + second + cent / 100.0

    def shift(self, by_s: Any) -> None:
        """Shift the time stamps of the ensembles to later times."""
        time = np.rint(self.time_s + by_s).astype("datetime64[s]")
        months = time.astype("datetime64[M]")
        year = months.astype("datetime64[Y]").astype(int) + 1970
        day = (time.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(int) + 1
        left = time.astype(np.int64) % 86400
        parts = (year % 100, months.astype(int) % 12 + 1, day, left // 3600, left // 60 % 60, left % 60, 0 * left)
        place = self.starts[VARIABLE]
        newer = self.starts[FIXED] < place and min(x for x in self.starts.values() if x > place) - place >= 65
        for k, part in enumerate(parts):
            self.put(VARIABLE, 4 + k, part, "u1")
            if newer:
                self.put(VARIABLE, 58 + k, part, "u1")
        if newer:
            self.put(VARIABLE, 57, year // 100, "u1")

    def save(self, path: Path) -> None:
        """Write the file with correct checksums."""
        sums = (self.rows[:, :-2].sum(axis=1, dtype=np.uint32) & 0xFFFF).astype("<u2")
        self.rows[:, -2:] = sums[:, None].view(np.uint8)
        path.write_bytes(self.rows.tobytes())


@dataclass(frozen=True)
class Outcome:
    """Outcome of processing a cruise."""

    refused: str = ""
    warnings: tuple[str, ...] = ()
    rms_deg: float = float("nan")  # of headings flagged 1
    covered: float = float("nan")  # share of their stated 95 % intervals that contain the truth
    far: float = 0.0  # share of their errors beyond 6 sigma
    good: float = 0.0  # share of all samples flagged 1
    verdict: str = ""
    findings: tuple[str, ...] = ()  # their names
    turned_deg: float = float("nan")  # rms angle to the true currents where the heading is flagged 1


def run(cruise: Cruise, into: Path, plain: Path | None = None) -> Outcome:
    """Process a cruise as ``compass correct`` does, and compare it with the truth.

    The errors of all samples are written to ``errors.npz`` in the folder of the results.

    Args:
        plain: results of the unmodified cruise, from which the true currents are computed.
    """
    try:
        made = process_mooring(cruise.folder, cruise.settings["name"], into)
    except InputError as error:
        return Outcome(refused=str(error))
    names = cruise.settings.get("reference") or []
    roles = [cruise.settings["compromised"], *([names] if isinstance(names, str) else names)]
    row = summary.summary_row("M", made, roles)
    warnings = tuple(filter(None, str(row["warnings"]).split(" | ")))
    findings = tuple(str(row["effects"]).split())
    product = netcdf.read_corrected(made / "corrected.nc")
    scores = _scored(cruise, product, into)
    if plain is not None:
        scores["turned_deg"] = _turned(product, plain)
    return Outcome(warnings=warnings, verdict=str(row["verdict"]), findings=findings, **scores)


def _scored(cruise: Cruise, product: Any, into: Path) -> dict[str, float]:
    time = product.record.time_s
    truth, heading = cruise.truth_at(time), product.heading_corrected_deg
    if cruise.true_north:
        truth, heading = truth + _declination(cruise, time), heading + product.declination_deg
    error, sigma = angles.wrap180(heading - truth), product.heading_uncertainty_deg
    flag = product.heading_corrected_quality
    np.savez_compressed(into / "errors.npz", time_s=time, error_deg=error, sigma_deg=sigma, flag=flag)
    looked = np.isfinite(error) & (flag == 1)
    if not looked.any():
        return {"good": 0.0}
    good = float(looked.sum() / max(np.isfinite(truth).sum(), 1))
    return scores_of(error[looked], sigma[looked]) | {"good": good}


def scores_of(error: np.ndarray, sigma: np.ndarray) -> dict[str, float]:
    """Compute the rms error, the share within the stated 95 % intervals, and that beyond 6 sigma."""
    return {
        "rms_deg": float(np.sqrt(np.mean(error**2))),
        "covered": float(np.mean(np.abs(error) <= 1.96 * sigma)),
        "far": float(np.mean(np.abs(error) > FAR_SIGMAS * sigma)),
    }


def keep_errors_of_file(cruise: Cruise, path: Path, into: Path) -> None:
    """Write the heading errors of a corrected.nc of any version to ``errors.npz``."""
    with netCDF4.Dataset(path) as nc:
        days, heading, sigma, flag = (
            np.ma.filled(nc[name][:].astype(float), np.nan)
            for name in ("TIME", *(f"HEADING_CORRECTED{end}" for end in ("", "_UNCERTAINTY", "_QC")))
        )
        time_s = np.asarray(netCDF4.num2date(days, nc["TIME"].units).tolist(), dtype="datetime64[ms]")
    time_s = np.rint(time_s.astype(np.int64) / 1000.0)
    error = angles.wrap180(heading - cruise.truth_at(time_s))
    into.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(into / "errors.npz", time_s=time_s, error_deg=error, sigma_deg=sigma, flag=flag)


def _turned(product: Any, plain: Path) -> float:
    """Compute the rms angle between the currents of a product and the true ones, weighted by speed, degrees."""
    if not (plain / "corrected.nc").exists():
        return float("nan")
    before = netcdf.read_corrected(plain / "corrected.nc")
    with np.load(plain / "errors.npz") as kept:
        error_deg = kept["error_deg"]
    _, a, b = np.intersect1d(product.record.time_s, before.record.time_s, return_indices=True)
    found, true = ((x.north + 1j * x.east)[k] for x, k in ((product, a), (before, b)))
    bins = min(found.shape[1], true.shape[1])
    both = found[:, :bins] * np.conj(true[:, :bins] * np.exp(-1j * np.deg2rad(error_deg[b]))[:, None])
    looked = np.isfinite(both) & (product.heading_corrected_quality[a] == 1)[:, None]
    if not looked.any():
        return float("nan")
    return float(np.rad2deg(np.sqrt(np.average(np.angle(both[looked]) ** 2, weights=np.abs(both[looked])))))


def _declination(cruise: Cruise, time_s: np.ndarray) -> np.ndarray:
    kept = json.loads((cruise.bases / f"{cruise.base}.declination.json").read_text())
    return np.interp(time_s, kept["time_s"], kept["declination_deg"])


def keep_declination(cruise: Cruise, made: Path) -> None:
    """Store the declination of the unmodified run, which is that of the field model."""
    field = read_json(made / "work/field.json")
    kept = {key: list(field[key]) for key in ("time_s", "declination_deg")}
    (cruise.bases / f"{cruise.base}.declination.json").write_text(json.dumps(kept))


def plain(text: str) -> str:
    """Remove numbers and instrument from a warning, to recognize it with other numbers or of another instrument."""
    return re.sub(r"[-+]?\d[\d.,:TZ%-]*", "#", re.sub(r"^(top|deep)\d?: ", "", text))


def is_wrong(outcome: Outcome, untouched: Outcome, least_deg: float = MARGIN_DEG) -> bool:
    """Return whether headings flagged 1 are wrong by more than their stated uncertainty."""
    if outcome.refused or not outcome.good or outcome.rms_deg <= max(least_deg, TIMES * untouched.rms_deg):
        return False
    return outcome.covered < COVERED or outcome.far > FAR_SHARE


def is_called_good(outcome: Outcome, untouched: Outcome) -> bool:
    """Return whether headings are wrong and more than ``KEPT`` of the original flags 1 are still set."""
    return is_wrong(outcome, untouched) and outcome.good > KEPT * untouched.good


def new_warnings(outcome: Outcome, untouched: Outcome) -> list[str]:
    """List warnings, findings and a verdict that the unmodified cruise did not have.

    A verdict of ``consistent`` does not count as a warning.
    """
    before = {plain(text) for text in untouched.warnings}
    new = [text for text in outcome.warnings if plain(text) not in before]
    new += [f"finding {name}" for name in outcome.findings if name not in untouched.findings]
    if outcome.verdict not in ("", "consistent", untouched.verdict):
        new.append(f"verdict {outcome.verdict}")
    return new


Attack = Callable[[Cruise, np.random.Generator], str]  # returns its description; raises NotApplicableError
