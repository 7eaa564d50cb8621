"""Write the raw files of a mooring's instruments and its YAML file, and the truth to a separate folder."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks.proof.world import compass
from benchmarks.proof.world.compass import Meter, Planted, Read
from benchmarks.proof.world.scene import Acts, Complexes, Floats, Scene, bridged, towards, turned, wrap
from compasslib.demo import adcp
from compasslib.demo.adcp import Ensembles, Setup, inclinometers
from compasslib.records import FieldSeries
from tests.world import iaga_files
from tests.world.pairs import reference_sizes

NOISE_M_S, LOWER_NOISE_M_S, SUPPLY_NOISE, TEMPERATURE_NOISE_K = 0.012, 0.012, 0.5, 0.02
GAPS, LONGEST_GAP = 3, 30  # number of gaps, and their largest length in ensembles
LOST_BEAM_NOISE = 1.8  # noise of three-beam solutions relative to four-beam ones
WIDEST_CELLS = 2.5  # largest vertical distance of pairs, in cells
DEEP_CELLS, DEEP_FIRST_M = 3, 2.5


@dataclass(frozen=True)
class Export:
    """Formats of the files, and errors of the instruments other than those of the compass."""

    table: bool = False  # whether the currents of the reference are a table, without headings
    true_north: bool = False  # whether the directions of the reference are relative to true north
    observatory: bool = False  # whether there is an observatory's series
    shift: float = 0.0  # circular shift of logged temperature and voltage, share of the record
    noise: float = 1.0
    by_ping: bool = True  # whether each ping is rotated by its own heading, or their mean by the mean heading
    lost_beam: float = 0.0  # share of the record, at its end, in which a beam is missing
    fouling: float = 0.0  # share of the range that is lost at the end
    reference: float = 1.0  # errors of the reference's compass relative to ordinary ones


@dataclass(frozen=True, eq=False)
class Mooring:
    """Truth and file formats of one mooring."""

    name: str
    scene: Scene
    meter: Meter
    planted: Sequence[Planted]
    export: Export
    random: Callable[[str], np.random.Generator]  # of one purpose

    @property
    def effects(self) -> list[Acts]:
        """Actions of the planted effects."""
        return [one.acts for one in self.planted]

    @property
    def errors_deg(self) -> Floats:
        """Constant error of the reference's compass, and its sine and cosine by the heading, degrees, (3,)."""
        earth = float(self.scene.horizontal_nt.mean()), float(self.scene.vertical_nt.mean())
        return self.export.reference * self.random("reference").normal(size=3) * reference_sizes(earth)


def write(made: Mooring, cruise: Path, locked: Path, facts: dict[str, Any]) -> None:
    """Write raw files and YAML as a separate cruise and, last, the truth to another folder."""
    raw = cruise / "raw" / made.name
    raw.mkdir(parents=True, exist_ok=True)
    scene, count = made.scene, made.scene.time_s.size
    ahead = compass.total(made.effects, "ahead_s", count)
    seen = scene.at(scene.time_s - ahead) if ahead.any() else scene
    read = compass.read(seen, made.meter, made.effects, made.random("readings"))
    kept = _kept(made)
    _write_top(made, raw / "top.000", seen, read, kept)
    wrong = _write_deep(made, raw)
    if made.export.observatory:
        swung = scene.declination_deg + compass.total(made.effects, "north_deg", count)
        field = (swung, scene.horizontal_nt, scene.vertical_nt)
        iaga_files.write(
            raw / "observatory.min",
            FieldSeries(scene.time_s, *field, "Made", *scene.place[:2], 100.0),
            kind="Definitive",
        )
    (cruise / "config/moorings").mkdir(parents=True, exist_ok=True)
    settings = {"moorings": "config/moorings", "overlap": {"max_metres": max(20.0, WIDEST_CELLS * _cell(scene))}}
    for path, text in (("config", settings), (f"moorings/{made.name}", _described(made))):
        (cruise / f"config/{path}.yaml").write_text(yaml.safe_dump(text, sort_keys=False))
    bare = compass.read(seen, made.meter, compass.clocks(made.planted), made.random("readings"))
    veer = compass.total(made.effects, "veer_deg", count)
    series = (scene.time_s, read.heading_deg, read.recorded_deg, bare.recorded_deg, veer, wrong)
    np.save(locked / f"{made.name}.npy", np.stack(series)[:, kept])
    effects = [
        {"name": x.family.name, "right": list(x.family.right), "side": x.family.side,
         "visible_deg": round(x.visible_deg, 4)} for x in made.planted
    ]  # fmt: skip
    errors = {
        "five_deg": float(np.std(compass.left_deg(read.recorded_deg, read.heading_deg))),
        "oracle_deg": float(np.std(compass.left_deg(bare.recorded_deg, bare.heading_deg))),
        "background_deg": float(np.std(compass.ideal(scene, made.meter, ()))),
    }
    facts |= {"effects": effects, "reference_deg": made.errors_deg.round(4).tolist()}
    (locked / f"{made.name}.json").write_text(json.dumps(facts | errors, indent=1) + "\n")


def _kept(made: Mooring) -> NDArray[np.bool_]:
    rng, count = made.random("gaps"), made.scene.time_s.size
    kept = np.ones(count, dtype=bool)
    for begin, length in zip(rng.integers(0, count, GAPS), rng.integers(1, LONGEST_GAP, GAPS), strict=True):
        kept[begin : begin + length] = False
    return kept


def _write_top(made: Mooring, path: Path, seen: Scene, read: Read, kept: NDArray[np.bool_]) -> None:
    rng, export, scene = made.random("top"), made.export, made.scene
    n, m = seen.flow.shape
    flow = compass.ensemble(seen.flow, read, seen.declination_deg, by_ping=export.by_ping)
    three = np.arange(n) >= n * (1.0 - export.lost_beam)
    noise = (0.25 if scene.real else 1.0) * export.noise * NOISE_M_S * np.where(three, LOST_BEAM_NOISE, 1.0)
    flow = flow + noise[:, None] * (rng.normal(size=(n, m)) + 1j * rng.normal(size=(n, m)))
    reach = 1.0 - export.fouling * np.linspace(0.0, 1.0, n) ** 2
    heard = (np.arange(m) < np.maximum(reach * m, 2.0)[:, None]) | (rng.random((n, m)) < 0.3)
    flow = np.where(heard, flow, np.nan)
    error = np.where(three[:, None], np.nan, rng.normal(0.0, NOISE_M_S, (n, m)))
    velocity = np.stack([flow.real, flow.imag, rng.normal(0.0, 0.004, (n, m)), error], axis=-1)
    good = np.isfinite(flow)[..., None] * np.where(three[:, None, None], [98, 0, 2, 0], [2, 0, 2, 96])
    warm, supply = (np.roll(x, round(export.shift * n)) for x in (scene.temperature_c, scene.supply))
    pitch, roll = inclinometers(read.pitch_deg, read.roll_deg)
    cells = np.ones((n, m, 4))
    ensembles = Ensembles(
        time_s=scene.time_s,
        number=np.arange(n) + 1,
        upside=np.full(n, scene.looks_up),
        heading_deg=read.recorded_deg,
        pitch_deg=pitch,
        roll_deg=roll,
        depth_m=scene.depth_m,
        pressure_dbar=1.01 * scene.depth_m * (np.ptp(scene.depth_m) > 0.0),
        temperature_c=warm + rng.normal(0.0, TEMPERATURE_NOISE_K, n),
        supply_counts=np.clip(np.rint(supply + rng.normal(0.0, SUPPLY_NOISE, n)), 1, 255).astype(np.uint8),
        velocity_m_s=velocity,
        correlation=(110 * cells).astype(np.uint8),
        echo=np.clip(120 + rng.normal(0.0, 2.0, (n, m, 4)), 0, 255).astype(np.uint8),
        percent_good=good.astype(np.uint8),
    )
    whole = Ensembles(**{name: column[kept] for name, column in vars(ensembles).items()})
    setup = _setup(m, _cell(scene), float(scene.range_m[0]), looks_up=scene.looks_up, serial=6100)
    adcp.write(path, setup, whole)


def _write_deep(made: Mooring, raw: Path) -> Floats:
    """Write the record of the reference, and return the error of its directions, (n,) degrees.

    Its compass has an independent heading; that of a table is a vane along the flow.
    """
    scene, export, rng = made.scene, made.export, made.random("deep")
    n, vane = scene.time_s.size, made.export.table or made.scene.real
    flow = turned(scene.lower, compass.total(made.effects, "veer_deg", n))
    noise = (0.0 if scene.real else 1.0) * export.noise * LOWER_NOISE_M_S
    flow = flow + noise * (rng.normal(size=n) + 1j * rng.normal(size=n))
    heading = 360.0 * np.cumsum(rng.normal(0.0, 0.012, n)) + rng.uniform(0.0, 360.0)
    heading = towards(scene.lower) - scene.declination_deg if vane else heading
    turn = np.deg2rad(heading)
    wrong = made.errors_deg @ np.array([np.ones(n), np.sin(turn), np.cos(turn)]) + rng.normal(0.0, 0.5, n)
    recorded = heading - compass.total(made.effects, "north_deg", n) + wrong
    flow = turned(flow, wrong if export.true_north else wrap(recorded - heading) - scene.declination_deg)
    known = np.isfinite(flow)
    if vane:
        _write_table(raw / "deep.csv", scene, flow, known)
        return wrong
    velocity = np.zeros((n, DEEP_CELLS, 4))
    velocity[:, 0, 0], velocity[:, 0, 1] = flow.real, flow.imag
    velocity[:, 0, :2] += rng.normal(0.0, 0.3 * LOWER_NOISE_M_S, (n, 2))
    velocity[:, 1:] = np.nan  # the current is known at one depth only
    ones, level = np.ones((n, DEEP_CELLS, 4), dtype=np.uint8), rng.normal(0.0, 0.3, (2, n))
    depth = _lower_depth(scene) - DEEP_FIRST_M
    ensembles = Ensembles(
        scene.time_s, np.arange(n) + 1, np.zeros(n, dtype=bool), recorded % 360.0, 1.0 + level[0], level[1] - 0.7,
        depth, 1.01 * depth, scene.temperature_c, np.full(n, 150, dtype=np.uint8), velocity, 110 * ones, 120 * ones,
        np.array([2, 0, 2, 96], dtype=np.uint8) * ones,
    )  # fmt: skip
    adcp.write(raw / "deep.000", _setup(DEEP_CELLS, 2.0, DEEP_FIRST_M, looks_up=False, serial=6200), ensembles)
    return wrong


def _write_table(path: Path, scene: Scene, flow: Complexes, known: NDArray[np.bool_]) -> None:
    texts = np.datetime_as_string(scene.time_s[known].astype("datetime64[s]")).tolist()
    columns = (_lower_depth(scene)[known], 100.0 * flow.real[known], 100.0 * flow.imag[known])
    rows = zip(texts, *(column.tolist() for column in columns), strict=True)
    lines = ["time_utc,depth_m,u_cm_s,v_cm_s\n", *("{}Z,{:.2f},{:.2f},{:.2f}\n".format(*row) for row in rows)]
    path.write_text("".join(lines))


def _lower_depth(scene: Scene) -> Floats:
    return bridged(scene.depth_m + scene.below_m)


def _cell(scene: Scene) -> float:
    return float(scene.range_m[1] - scene.range_m[0]) if scene.range_m.size > 1 else 2.0


def _setup(cells: int, cell_m: float, first_m: float, *, looks_up: bool, serial: int) -> Setup:
    kilohertz = 75 if cell_m > 8.0 else 300
    return Setup(kilohertz, looks_up, cells, cell_m, 0.8, first_m, compass.PINGS, "earth", serial)


def _described(made: Mooring) -> dict[str, Any]:
    scene, name, export = made.scene, made.name, made.export
    ends = (scene.time_s[0], scene.time_s[-1] + scene.step_s)
    first, last = (datetime.fromtimestamp(float(x), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") for x in ends)
    depths = [round(float(np.median(x)), 1) for x in (scene.depth_m, _lower_depth(scene))]
    top = {"format": "pd0", "files": f"raw/{name}/top.000", "depth": depths[0]}
    top["orientation"] = "up" if scene.looks_up else "down"
    if export.table or scene.real:
        deep: dict[str, Any] = {
            "format": "table", "files": f"raw/{name}/deep.csv", "depth": depths[1],
            "direction_reference": "true" if export.true_north else "magnetic",
            "columns": {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01},
        }  # fmt: skip
    else:
        deep = {"format": "pd0", "files": f"raw/{name}/deep.000", "depth": depths[1] - DEEP_FIRST_M}
        deep["orientation"] = "down"
    text: dict[str, Any] = {
        "name": name, "latitude": scene.place[0], "longitude": scene.place[1], "water_depth": scene.place[2],
        "start": first, "end": last, "declination": "auto", "compromised": "top", "reference": "deep",
        "instruments": {"top": top, "deep": deep},
    }  # fmt: skip
    if export.observatory:
        text["covariates"] = {"declination_observatory": {"format": "iaga2002", "files": f"raw/{name}/observatory.min"}}
    return text
