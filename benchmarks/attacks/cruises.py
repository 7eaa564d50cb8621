"""Cruises with known truth that can be spoilt: four bases, their raw files as arrays, and what a run made of them."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from runs import DATA

from compasslib.archive import netcdf, summary
from compasslib.core.errors import InputError
from compasslib.simulation import draw
from compasslib.simulation.sealed import Wish
from compasslib.simulation.sealed_files import Export
from compasslib.stages import pipeline

REAL = DATA / "cruise_eh2"
HOUR_S = 3600.0
# Two simulated years with the reference as a table and as PD0, one whose profiler logs beams, and a real record.
SIMULATED = {
    "table": (2, Wish(), Export(deep="table")),
    "pd0": (3, Wish(), Export(deep="pd0")),
    "beam": (2, Wish(wide=True), Export(deep="pd0", coordinates="beam")),
}
HEADING, FIXED, VARIABLE, VELOCITY = 18, 0x0000, 0x0080, 0x0100
MARGIN_DEG, TIMES, COVERED, FAR_SIGMAS, FAR_SHARE = 2.0, 2.0, 0.85, 6.0, 0.01  # what counts as wrong


def build(folder: Path) -> list[str]:
    """Write the bases, run each untouched, and return their names."""
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    names = []
    for name, (seed, wish, export) in SIMULATED.items():
        cruise = folder / name
        (cruise / "config").mkdir(parents=True, exist_ok=True)
        (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
        draw.write(draw.Sealed("M", wish=wish, export=export, seed=seed), cruise, folder / "truth")
        time_s, heading_deg, *_ = np.load(folder / "truth/M.npy")
        np.save(folder / f"{name}.npy", np.stack([time_s, heading_deg]))
        names.append(name)
    return names + ([_real(folder)] if REAL.is_dir() else [])


def _real(folder: Path) -> str:
    cruise = folder / "real"
    (cruise / "config/moorings").mkdir(parents=True, exist_ok=True)
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    shutil.copytree(REAL / "raw/E1", cruise / "raw/M", dirs_exist_ok=True)
    for file in (cruise / "raw/M").iterdir():
        file.chmod(0o644)
    text = (REAL / "config/moorings/E1.yaml").read_text().replace("raw/E1", "raw/M").replace("name: E1", "name: M")
    (cruise / "config/moorings/M.yaml").write_text(text)
    truth = pd.read_csv(REAL / "truth_E1.csv")
    time_s = pd.to_datetime(truth["time_utc"]).to_numpy().astype("datetime64[s]").astype(float)
    np.save(folder / "real.npy", np.stack([time_s, truth["heading_true_magnetic_deg"].to_numpy()]))
    return "real"


@dataclass
class Cruise:
    """One cruise of one mooring that an attack may spoil; ``save`` writes what was changed."""

    folder: Path
    base: str
    settings: dict[str, Any]
    time_s: np.ndarray  # as the affected instrument stamps its samples, (n,)
    heading_deg: np.ndarray  # correct, magnetic, (n,)
    bases: Path
    opened: dict[str, Any] = field(default_factory=dict)
    true_north: bool = False  # whether the true heading is looked at, not the magnetic one

    @classmethod
    def copy(cls, bases: Path, base: str, folder: Path) -> Cruise:
        """Return a copy of a base in a new folder."""
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
    def deep_is_table(self) -> bool:
        return self.deep["format"] == "table"

    def path(self, role: str) -> Path:
        return self.folder / self.settings["instruments"][role]["files"]

    def pd0(self, role: str = "top") -> Pd0:
        """Return the ensembles of an instrument, to be changed in place."""
        return self.opened.setdefault(role, Pd0(self.path(role)))

    def table(self) -> pd.DataFrame:
        """Return the reference's table, to be changed in place."""
        return self.opened.setdefault("table", pd.read_csv(self.path("deep")))

    def times(self, frame: pd.DataFrame) -> np.ndarray:
        """Return the seconds since 1970 of a table's rows."""
        stamps = pd.to_datetime(frame["time_utc"].astype(str), utc=True, format="ISO8601").dt.tz_localize(None)
        return stamps.to_numpy().astype("datetime64[ms]").astype(float) / 1000.0

    def shift(self, role: str, by_s: np.ndarray | float) -> None:
        """Set the clock of an instrument ahead."""
        if role == "deep" and self.deep_is_table:
            frame = self.table()
            frame["time_utc"] = stamps(self.times(frame) + by_s)
            return
        self.pd0(role).shift(by_s)
        if role == "top":
            self.time_s = self.time_s + np.interp(self.time_s, *_along(self.time_s, by_s))

    def declination_deg(self) -> float:
        """Return the declination that the untouched run used, its mean."""
        return float(np.mean(_declination(self, np.array(self.span()))))

    def span(self) -> tuple[float, float]:
        """Return when the mooring was deployed and recovered, seconds since 1970."""
        first, last = (str(self.settings[key]).replace("Z", "+00:00") for key in ("start", "end"))
        return datetime.fromisoformat(first).timestamp(), datetime.fromisoformat(last).timestamp()

    def save(self) -> None:
        """Write everything that was opened, and the YAML file."""
        for role, content in self.opened.items():
            if isinstance(content, Pd0):
                content.save(self.path(role))
            else:
                content.to_csv(self.path("deep"), index=False, float_format="%.2f")
        (self.folder / "config/moorings/M.yaml").write_text(yaml.safe_dump(self.settings, sort_keys=False))


def _along(time_s: np.ndarray, by_s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    nodes = np.linspace(time_s[0], time_s[-1], np.size(by_s)) if np.size(by_s) > 1 else time_s
    return nodes, np.broadcast_to(by_s, nodes.shape)


def stamps(time_s: np.ndarray) -> np.ndarray:
    """Return times as text."""
    return np.char.add(np.datetime_as_string(np.rint(time_s).astype("datetime64[s]")), "Z")


class Pd0:
    """The good ensembles of a PD0 file of one length each, as bytes that can be changed; checksums are made anew."""

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
        """Return one value an ensemble, (n,)."""
        place = self.starts[block] + offset
        return self.rows[:, place : place + np.dtype(kind).itemsize].copy().view(kind)[:, 0]

    def put(self, block: int, offset: int, values: Any, kind: str = "<u2", where: Any = slice(None)) -> None:
        """Write one value an ensemble."""
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

    def turned(self, degrees: Any) -> np.ndarray:
        """Return the earth velocities turned clockwise."""
        old = self.velocity.astype(float)
        bad = (old[..., :2] == -32768).any(-1)
        flow = (old[..., 0] + 1j * old[..., 1]) * np.exp(-1j * np.deg2rad(np.broadcast_to(degrees, len(self))))[:, None]
        new = old.copy()
        new[..., 0], new[..., 1] = np.rint(flow.real), np.rint(flow.imag)
        new[bad] = old[bad]
        return new

    @property
    def time_s(self) -> np.ndarray:
        year, month, day, hour, minute, second, cent = (self.get(VARIABLE, 4 + k, "u1").astype(int) for k in range(7))
        months = (np.where(year < 70, 2000, 1900) + year - 1970) * 12 + month - 1
        days = months.astype("datetime64[M]").astype("datetime64[D]").astype(float) + day - 1
        return days * 86400.0 + hour * 3600.0 + minute * 60.0 + second + cent / 100.0

    def shift(self, by_s: Any) -> None:
        """Stamp the ensembles later."""
        time = np.rint(self.time_s + by_s).astype("datetime64[s]")
        months = time.astype("datetime64[M]")
        year = months.astype("datetime64[Y]").astype(int) + 1970
        day = (time.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(int) + 1
        left = time.astype(np.int64) % 86400
        parts = (year % 100, months.astype(int) % 12 + 1, day, left // 3600, left // 60 % 60, left % 60, 0 * left)
        newer = self.starts[FIXED] < self.starts[VARIABLE] and self._variable_length() >= 65
        for k, part in enumerate(parts):
            self.put(VARIABLE, 4 + k, part, "u1")
            if newer:
                self.put(VARIABLE, 58 + k, part, "u1")
        if newer:
            self.put(VARIABLE, 57, year // 100, "u1")

    def _variable_length(self) -> int:
        after = [place for place in self.starts.values() if place > self.starts[VARIABLE]]
        return min(after) - self.starts[VARIABLE]

    def octets(self) -> bytes:
        """Return the file's bytes with right checksums."""
        sums = (self.rows[:, :-2].sum(axis=1, dtype=np.uint32) & 0xFFFF).astype("<u2")
        self.rows[:, -2:] = sums[:, None].view(np.uint8)
        return self.rows.tobytes()

    def save(self, path: Path) -> None:
        path.write_bytes(self.octets())


@dataclass(frozen=True)
class Outcome:
    """What a run made of a cruise."""

    refused: str = ""
    warnings: tuple[str, ...] = ()
    rms_deg: float = float("nan")  # of headings flagged 1
    covered: float = float("nan")  # share of their stated 95 % intervals that hold the truth
    far: float = 0.0  # share of their errors beyond 6 sigma
    good: float = 0.0  # share of all samples flagged 1
    verdict: str = ""


def run(cruise: Cruise, into: Path) -> Outcome:
    """Process a cruise as ``compass correct`` does, and hold it against the truth."""
    try:
        made = pipeline.process(cruise.folder, cruise.settings["name"], into)
    except InputError as error:
        return Outcome(refused=str(error))
    row = summary.row("M", made, [cruise.settings["compromised"], *filter(None, [cruise.settings.get("reference")])])
    product = netcdf.read_corrected(made / "corrected.nc")
    warnings = tuple(filter(None, str(row["warnings"]).split(" | ")))
    return Outcome(warnings=warnings, verdict=str(row["verdict"]), **_scored(cruise, product))


def _scored(cruise: Cruise, product: Any) -> dict[str, float]:
    time, order = product.record.time_s, np.argsort(cruise.time_s, kind="stable")
    known = cruise.time_s[order]
    at = np.clip(np.searchsorted(known, time - 1.0), 0, len(known) - 1)
    truth = np.where(np.abs(known[at] - time) < 2.0, cruise.heading_deg[order][at], np.nan)
    heading = product.heading_corrected_deg
    if cruise.true_north:
        truth, heading = truth + _declination(cruise, time), heading + product.declination_deg
    error = np.mod(heading - truth + 180.0, 360.0) - 180.0
    looked = np.isfinite(error) & (product.heading_corrected_quality == 1)
    if not looked.any():
        return {"good": 0.0}
    error, sigma = np.abs(error[looked]), product.heading_uncertainty_deg[looked]
    return {
        "rms_deg": float(np.sqrt(np.mean(error**2))),
        "covered": float(np.mean(error <= 1.96 * sigma)),
        "far": float(np.mean(error > FAR_SIGMAS * sigma)),
        "good": float(looked.sum() / max(np.isfinite(truth).sum(), 1)),
    }


def _declination(cruise: Cruise, time_s: np.ndarray) -> np.ndarray:
    kept = json.loads((cruise.bases / f"{cruise.base}.declination.json").read_text())
    return np.interp(time_s, kept["time_s"], kept["declination_deg"])


def keep_declination(cruise: Cruise, made: Path) -> None:
    """Keep the declination of the untouched run, the model's."""
    field = netcdf.read_json(made / "work/field.json")
    kept = {key: list(field[key]) for key in ("time_s", "declination_deg")}
    (cruise.bases / f"{cruise.base}.declination.json").write_text(json.dumps(kept))


def plain(text: str) -> str:
    """Return a warning without its numbers, so that the same one with other numbers is not new."""
    return re.sub(r"[-+]?\d[\d.,:TZ%-]*", "#", text)


def silent_wrong(outcome: Outcome, untouched: Outcome) -> bool:
    """Tell whether headings flagged good are wrong, and nothing new was said."""
    if outcome.refused or not outcome.good or outcome.rms_deg <= max(MARGIN_DEG, TIMES * untouched.rms_deg):
        return False
    honest = outcome.covered >= COVERED and outcome.far <= FAR_SHARE
    return not honest and not new_warnings(outcome, untouched)


def new_warnings(outcome: Outcome, untouched: Outcome) -> list[str]:
    """Return what is said of a spoilt cruise and was not said before."""
    before = {plain(text) for text in untouched.warnings}
    return [text for text in outcome.warnings if plain(text) not in before]


Attack = Callable[[Cruise, np.random.Generator], str | None]  # what was done; None where it does not go with this base
