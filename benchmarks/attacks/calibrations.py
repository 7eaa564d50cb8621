"""Calibrations with known truth to which errors are added: bench, swing, magnetometer log, observatory series."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import cruises
import numpy as np
import pandas as pd
import yaml
from cruises import MARGIN_DEG, Outcome

from compasslib import angles, calibrations, earthfield
from compasslib.calibrations import result
from compasslib.config import calibrations as configured
from compasslib.config import cruise
from compasslib.demo.compass import Iron
from compasslib.errors import InputError
from tests.world import observatory, swing

PLACE = (48.4, -4.5)
STATION = (58.0, -30.0)  # where the declination is not near zero
DATE = "2022-09-29"
START_S = datetime.fromisoformat(f"{DATE}T08:00:00+00:00").timestamp()
Curve = Callable[[np.ndarray], np.ndarray]


@dataclass
class Recording:
    """One calibration to which an attack adds an error: its readings, its YAML file, and the truth."""

    kind: str
    frame: pd.DataFrame
    settings: dict[str, Any]
    truth: Callable[[np.ndarray], np.ndarray] | float  # deviation by recorded heading; for a series, its constant
    text: list[str] = field(default_factory=list)  # lines of a file that is not a table

    def write(self, folder: Path) -> None:
        """Write a cruise that contains only this calibration."""
        (folder / "config/calibrations").mkdir(parents=True)
        (folder / "raw").mkdir()
        (folder / "config/config.yaml").write_text("moorings: []\n")
        (folder / "config/calibrations/K.yaml").write_text(yaml.safe_dump(self.settings, sort_keys=False))
        self.save(folder / str(self.settings["file"]))

    def save(self, path: Path) -> None:
        """Write the readings."""
        path.write_text("".join(self.text) if self.text else self.frame.to_csv(index=False))


def run(made: Recording, folder: Path) -> Outcome:
    """Calibrate, and compare the table, or the constant, with the truth."""
    made.write(folder)
    try:
        given = cruise.load_cruise(folder).calibrations["K"]
        settings = calibrations.resolve_settings(configured.settings(given))
        files = [folder / file for file in given.files]
        got = calibrations.calibrate(str(given.kind), files, settings)
    except InputError as error:
        return Outcome(refused=str(error))
    page = result.to_json("K", got, settings, {})
    warnings = (*page["warnings"], *([f"no calibration: {page['why']}"] if page["why"] else []))
    if isinstance(made.truth, float):
        if not got.coefficients.size:
            return Outcome(refused=page["why"] or "no coefficients", warnings=warnings)
        error = np.array([got.coefficients[0] - made.truth])
        sigma = np.array([float(got.covariance[0, 0]) ** 0.5])
    else:
        if got.table is None or not got.coefficients.size:
            return Outcome(refused=page["why"] or "no table", warnings=warnings)
        known = np.isfinite(got.table.deviation_deg)
        true = made.truth(got.table.heading_deg[known])
        error = angles.wrap180(got.table.deviation_deg[known] - true)
        sigma = got.table.sigma_deg[known]
    return Outcome(warnings=warnings, good=1.0, **cruises.scores_of(error, sigma))


def inverse(recorded: np.ndarray, correct: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Construct the deviation by recorded heading from noise-free readings over the full circle."""
    order = np.argsort(np.mod(recorded, 360.0))
    x, y = np.mod(recorded, 360.0)[order], angles.wrap180(correct - recorded)[order]
    return lambda heading: np.interp(np.mod(heading, 360.0), x, y, period=360.0)


def curve(rng: np.random.Generator, largest_deg: float) -> tuple[Curve, Curve]:
    """Draw a compass near iron as two functions: recorded by correct heading, and deviation by recorded heading."""
    b, c = np.deg2rad(rng.uniform(0.3, 1.0) * largest_deg) * np.array([np.cos(t := rng.uniform(0, 6.3)), np.sin(t)])
    quadrantal = 0.1 * np.deg2rad(largest_deg) * np.exp(1j * rng.uniform(0, 6.3))

    def record(correct: np.ndarray) -> np.ndarray:
        turn = np.exp(1j * np.deg2rad(correct))
        return np.mod(np.rad2deg(np.angle(turn + (b - 1j * c) + quadrantal / turn)), 360.0)

    fine = np.arange(0.0, 360.0, 0.25)
    return record, inverse(record(fine), fine)


def platform(rng: np.random.Generator) -> Recording:
    record, truth = curve(rng, 12.0)
    reference = np.repeat(10.0 * np.arange(36) + rng.uniform(0, 10), 2)
    recorded = np.mod(record(reference) + rng.normal(0, 0.4, reference.size), 360.0)
    frame = pd.DataFrame({"reference_deg": reference, "recorded_deg": recorded.round(2)})
    return Recording("platform", frame, _settings("platform"), truth)


def swung(rng: np.random.Generator) -> Recording:
    iron = Iron((*rng.uniform(-2500, 2500, 2).tolist(), 0.0))
    boat = swing.Boat(
        plan=str(rng.choice([swing.LEGS, swing.CIRCLES])), speed_kn=float(rng.uniform(4, 8)), iron=iron,
        water_kn=complex(*rng.uniform(-0.3, 0.3, 2)),
    )  # fmt: skip
    declination = float(earthfield.igrf(*PLACE, START_S)[0][0])
    made = swing.sail(rng, boat, declination, START_S)
    fine = np.arange(0.0, 360.0, 0.25)
    zero = np.zeros(fine.size)
    recorded = swing.recorded_heading(swing.FIELD_NT, fine, tilt_deg=(zero, zero), iron=iron)
    frame = pd.DataFrame({
        "time_utc": np.char.add(np.datetime_as_string(made.time_s.astype("datetime64[s]")), "Z"),
        "compass_deg": made.compass_deg, "cog_deg": made.course_deg, "speed_kn": made.speed_kn,
    })  # fmt: skip
    return Recording("swing", frame, _settings("swing"), inverse(recorded, fine))


def magnetometer(rng: np.random.Generator) -> Recording:
    """Simulate the log of a level magnetometer turned about the vertical, with hard iron on two axes."""
    hard = rng.uniform(-4000, 4000, 2)
    turn = np.deg2rad(np.linspace(0, 1080, 720) + rng.uniform(0, 360))
    x, y = (
        21000 * np.cos(turn) + hard[0] + rng.normal(0, 40, 720),
        -21000 * np.sin(turn) + hard[1] + rng.normal(0, 40, 720),
    )
    z = 43000 + rng.normal(0, 40, 720)
    frame = pd.DataFrame({"x": x.round(), "y": y.round(), "z": z.round()})
    fine = np.deg2rad(np.arange(0.0, 360.0, 0.25))
    recorded = np.rad2deg(np.arctan2(21000 * np.sin(fine) - hard[1], 21000 * np.cos(fine) + hard[0]))
    return Recording("magnetometer", frame, _settings("magnetometer"), inverse(recorded, np.rad2deg(fine)))


def series(rng: np.random.Generator, folder: Path) -> Recording:
    """Simulate a year of hourly observatory data with a constant declination anomaly of local rocks."""
    truth, count = float(rng.uniform(-0.3, 0.3)), 366 * 24
    time_s = START_S + 3600.0 * np.arange(count)
    declination, horizontal, vertical = (np.broadcast_to(x, count) for x in earthfield.igrf(*STATION, time_s))
    hour = 2 * np.pi * time_s / 86400.0
    slow = np.convolve(rng.normal(0, 1, count + 200), np.ones(200) / 200, "valid")[:count]
    path = folder / "made.hor"
    daily = 0.08 * np.sin(hour) + 0.05 * rng.normal(size=count) + 0.2 * slow
    observatory.write(path, time_s, (declination + truth + daily, horizontal + 30 * np.cos(hour), vertical), STATION)
    settings = {"kind": "declination", "file": "raw/k.hor", "format": "iaga2002"}
    return Recording("declination", pd.DataFrame(), settings, truth, path.read_text().splitlines(keepends=True))


def _settings(kind: str) -> dict[str, Any]:
    return {"kind": kind, "file": "raw/k.csv", "latitude": PLACE[0], "longitude": PLACE[1], "date": DATE}


def _with_columns(text: list[str], change: Callable[[np.ndarray], np.ndarray]) -> list[str]:
    """Apply a function to the four components of an IAGA-2002 file, (n, 4)."""
    first = next(k for k, line in enumerate(text) if line.startswith("DATE")) + 1
    new = change(np.array([[float(x) for x in line.split()[3:7]] for line in text[first:]]))
    rows = zip(text[first:], new, strict=True)
    return [*text[:first], *(line[:30] + " ".join(f"{x:9.2f}" for x in row) + "\n" for line, row in rows)]


def _as_dhzf(text: list[str], minutes: float) -> list[str]:
    """Convert X and Y to D and H, with D in degrees times a factor, of which 60 is correct."""
    named = [line.replace("XYZF", "DHZF").replace("NWHX", "NWHD").replace("NWHY", "NWHH") for line in text]
    return _with_columns(named, lambda v: np.stack(
        [minutes * np.rad2deg(np.arctan2(v[:, 1], v[:, 0])), np.hypot(v[:, 0], v[:, 1]), *v.T[2:]], 1))  # fmt: skip


def _filled(text: list[str], rng: np.random.Generator, value: float) -> list[str]:
    hit = rng.random(366 * 24) < 0.03
    return _with_columns(text, lambda v: np.where(hit[:, None], value, v))


def _put(frame: pd.DataFrame, column: str, values: Any, where: Any) -> pd.DataFrame:
    new = frame.copy()
    new.loc[where, column] = values
    return new


# Mistakes in the lines of a series, and in the table of each other kind.
SERIES: dict[str, Callable[[list[str], np.random.Generator], list[str]]] = {
    "D in degrees": lambda text, rng: _as_dhzf(text, 1.0),
    "D of the wrong sign": lambda text, rng: _as_dhzf(text, -60.0),
    "X and Y exchanged": lambda text, rng: _with_columns(text, lambda v: v[:, [1, 0, 2, 3]]),
    "longitude's sign": lambda text, rng: [x.replace("330.000", " 30.000") for x in text],
    "a factor of ten in Y": lambda text, rng: _with_columns(text, lambda v: v * [1, 10, 1, 1]),
    "a factor of ten in all": lambda text, rng: _with_columns(text, lambda v: v / 10.0),
    "fillers of -9999": lambda text, rng: _filled(text, rng, -9999.0),
    "fillers of 0": lambda text, rng: _filled(text, rng, 0.0),
    "latitude's sign": lambda text, rng: [x.replace("58.000 ", "-58.000") for x in text],
    "Y of the wrong sign": lambda text, rng: _with_columns(text, lambda v: v * [1, -1, 1, 1]),
    "X in microtesla": lambda text, rng: _with_columns(text, lambda v: v / [1000, 1, 1, 1]),
}
Mistakes = dict[str, Callable[[pd.DataFrame, np.random.Generator], pd.DataFrame]]
PLATFORM: Mistakes = {
    "backwards": lambda f, rng: f.assign(recorded_deg=np.mod(-f["recorded_deg"], 360.0)),
    "radians": lambda f, rng: f.assign(recorded_deg=np.deg2rad(f["recorded_deg"])),
    "gon": lambda f, rng: f.assign(recorded_deg=f["recorded_deg"] / 0.9),
    "exchanged": lambda f, rng: f.assign(reference_deg=f["recorded_deg"], recorded_deg=f["reference_deg"]),
    "a half turn": lambda f, rng: f.assign(recorded_deg=np.mod(f["recorded_deg"] + 180.0, 360.0)),
    "typos": lambda f, rng: _put(f, "recorded_deg", rng.uniform(0, 360, 6), rng.choice(len(f), 6, replace=False)),
    "reference true": lambda f, rng: f.assign(reference_deg=np.mod(f["reference_deg"] - 23.5, 360.0)),
    "shuffled": lambda f, rng: f.assign(recorded_deg=rng.permutation(f["recorded_deg"])),
}
SWING: Mistakes = {
    "course magnetic": lambda f, rng: f,
    "compass true": lambda f, rng: f.assign(compass_deg=np.mod(
        f["compass_deg"] + float(earthfield.igrf(65.3, -33.0, START_S)[0][0]), 360.0)),
    "backwards": lambda f, rng: f.assign(compass_deg=np.mod(-f["compass_deg"], 360.0)),
    "frozen receiver": lambda f, rng: _put(f, "cog_deg", f["cog_deg"].iloc[len(f) // 3], slice(len(f) // 3, None)),
    "speed in m/s": lambda f, rng: f.assign(speed_kn=f["speed_kn"] * 0.5144),
    "course of 999": lambda f, rng: _put(f, "cog_deg", 999.0, rng.random(len(f)) < 0.05),
    "compass late by a minute": lambda f, rng: f.assign(compass_deg=np.roll(f["compass_deg"], 60)),
    "compass of 0 in a tenth": lambda f, rng: _put(f, "compass_deg", 0.0, rng.random(len(f)) < 0.1),
    "columns exchanged": lambda f, rng: f.assign(compass_deg=f["cog_deg"], cog_deg=f["compass_deg"]),
    "half a circle": lambda f, rng: f[np.mod(f["compass_deg"], 360.0) < 180.0],
    "declination's sign": lambda f, rng: f,
}  # fmt: skip
MAGNETOMETER: Mistakes = {
    "int16 wrap": lambda f, rng: ((np.rint(f * 1.5) + 32768) % 65536) - 32768,
    "clipped": lambda f, rng: f.clip(-19000, 19000),
    "x of other sign": lambda f, rng: f.assign(x=-f["x"]),
    "axes exchanged": lambda f, rng: f.rename(columns={"x": "y", "y": "x"}),
    "dead axis": lambda f, rng: f.assign(y=120.0),
    "other unit": lambda f, rng: f.assign(x=f["x"] / 10.0),
    "jumps": lambda f, rng: f.assign(x=f["x"] + 6000.0 * (np.arange(len(f)) >= len(f) // 2)),
    "12 bit wrap": lambda f, rng: ((np.rint(f / 11.0) + 2048) % 4096) - 2048,
}
SETTINGS = {  # of mistakes in the YAML file
    "reference true": {"latitude": 65.3, "longitude": -33.0}, "course magnetic": {"latitude": 65.3, "longitude": -33.0},
    "declination's sign": {"declination": 23.5},
}  # fmt: skip
SPOILERS: dict[str, tuple[Callable[..., Recording], dict[str, Callable[..., Any]]]] = {
    "platform": (platform, PLATFORM), "swing": (swung, SWING), "magnetometer": (magnetometer, MAGNETOMETER),
    "declination": (series, SERIES),
}  # fmt: skip


def spoil(made: Recording, rng: np.random.Generator) -> str:
    """Draw a mistake of a recording's kind, make it, and name it."""
    mistakes = SPOILERS[made.kind][1]
    how = str(rng.choice(list(mistakes)))
    made.settings |= SETTINGS.get(how, {})
    if made.text:
        made.text = mistakes[how](made.text, rng)
    else:
        made.frame = mistakes[how](made.frame, rng)
    return how


def harmless(made: Recording, rng: np.random.Generator) -> str:
    """Apply a change without effect; for a series that is not a table, only blank lines at its end."""
    if made.text:
        made.text.append("\n" * int(rng.integers(1, 4)))
        return "blank lines at the end"
    how = str(
        rng.choice(["columns in another order", "a column more", "rounded", "longitude from 0 to 360", "other headers"])
    )
    if how == "columns in another order":
        made.frame = made.frame[list(rng.permutation(made.frame.columns))]
    elif how == "a column more":
        made.frame["remark"] = "ok"
    elif how == "rounded":
        made.frame = made.frame.round(0 if made.kind != "platform" else 1)
    elif how == "longitude from 0 to 360":
        made.settings["longitude"] = 360.0 + made.settings["longitude"]
    else:
        made.settings["columns"] = {str(c): f"my {c}" for c in made.frame.columns}
        made.frame = made.frame.rename(columns=made.settings["columns"])
    return how


def make(kind: str, seed: list[int], folder: Path) -> Recording:
    """Simulate the unmodified recording of a kind from its seed."""
    maker = SPOILERS[kind][0]
    rng = np.random.default_rng(seed)
    return maker(rng, folder) if kind == "declination" else maker(rng)


def is_wrong(outcome: Outcome, untouched: Outcome) -> bool:
    """Return whether a table, or a constant, is wrong by more than its stated uncertainty.

    The single error of a constant counts from half a degree, as 2 degrees of declination would be too large.
    """
    return cruises.is_wrong(outcome, untouched, MARGIN_DEG if outcome.covered not in (0.0, 1.0) else 0.5)
