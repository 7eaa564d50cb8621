"""Draws moorings by seed, writes each as a cruise has it, and its truth elsewhere."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from compasslib.simulation import demonstration, planting, readings, sealed, sealed_files
from compasslib.simulation.sealed import Ground, Wish
from compasslib.simulation.sealed_files import DEEP_SAMPLE_S, Export, Written
from compasslib.simulation.series import stream

# Of the nulls, in some noise is doubled, in some the sphere turns with the lower water, so that it knows the noise.
SHARES = {
    "null": 0.17, "noisy": 0.04, "locked": 0.04, "strange": 0.16, "shifted": 0.04, "undecidable": 0.10,
    "single": 0.31, "pair": 0.14,
}  # fmt: skip
SINGLES = (
    "heeling", "hard_iron_step", "temperature", "current_veer", "sextantal", "supply_voltage", "heading_slip",
    "clock_offset", "compass_drift", "octantal", "hard_iron_drift", "field_disturbance", "battery_change",
    "clock_drift", "tilt_uncompensated", "compass_lag",
    "stuck_tilt",
)  # fmt: skip
UNNAMED = tuple(planting.UNCATALOGUED)
PAIRS = (
    ("heeling", "temperature"), ("sextantal", "hard_iron_step"), ("temperature", "current_veer"),
    ("octantal", "heading_slip"), ("heeling", "compass_drift"), ("clock_offset", "sextantal"),
    ("hard_iron_drift", "current_veer"), ("heading_slip", "temperature"), ("heeling", "sextantal"),
)  # fmt: skip
SMALLEST_DEG, LARGEST_DEG = 0.7, 4.0
LARGEST_STORM_DEG = 1.5  # more than that over a year no place on earth has
PUBLISHED, SERIES = "EG4", "EG4_SERIES"  # with what is found applied, and the published product alone


@dataclass(frozen=True)
class Sealed:
    """One mooring that is to be made, and what a perfect tool would say of it."""

    name: str
    kind: str  # a key of SHARES, or "published"
    wanted: dict[str, float] = field(default_factory=dict)  # visible rms degrees
    rivals: tuple[str, ...] = ()  # what nobody could tell from the planted effect
    wish: Wish = field(default_factory=Wish)
    export: Export = field(default_factory=Export)
    seed: int = 0


def draw(seed: int, count: int, hours: int = 8800) -> list[Sealed]:
    """Return the moorings of one proof in an order that tells nothing, the published case apart.

    Args:
        hours: of each record.
    """
    rng = stream(seed, "proof", "draw")
    kinds = [kind for kind, n in _counts(count).items() for _ in range(n)]
    order = rng.permutation(count)
    # Each kind goes round its own list from a place that the seed chooses.
    turns = {kind: int(rng.integers(0, 100)) for kind in SHARES}
    made = []
    for k, kind in enumerate(kinds):
        name = f"P{int(order[k]) + 1:03d}"
        made.append(_one(stream(seed, name, "wish"), name, kind, turns[kind] + k, seed, hours))
    return sorted(made, key=lambda one: one.name)


def write(one: Sealed, cruise: Path, locked: Path) -> None:
    """Write one mooring's raw files and configuration, and elsewhere its truth."""
    ground = sealed.make(one.seed, one.name, one.wish)
    planted = planting.plant(ground, one.wanted)
    effects = [each.effect for each in planted]
    raw = sealed_files.write(ground, effects, cruise / "raw" / one.name, one.export)
    _write_yaml(cruise / f"config/moorings/{one.name}.yaml", _described(one, ground))
    facts = {
        "kind": one.kind,
        "effects": [
            {"name": p.effect.name, "visible_deg": p.visible_deg, "parameters": p.effect.parameters} for p in planted
        ],
        "rivals": list(one.rivals),
        "wide": one.wish.wide,
        "background_deg": planting.background_deg(ground),
        **_bounds(ground, raw),
    }
    _lock(locked, one.name, facts, raw)


def write_alone(one: Sealed, folder: Path) -> tuple[Path, Path]:
    """Write a cruise of one mooring into a folder, and return the cruise and where its truth is locked."""
    cruise, locked = folder / "cruise", folder / "locked"
    (cruise / "config/moorings").mkdir(parents=True)
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    locked.mkdir()
    write(one, cruise, locked)
    return cruise, locked


def write_published(seed: int, cruise: Path, locked: Path) -> None:
    """Write the case of the paper: iron of 1.3 times the earth's horizontal field, to be fitted by its method."""
    demonstration.write_mooring(PUBLISHED, cruise / "raw", locked / "published.csv", seed)
    spec = demonstration.spec_of(PUBLISHED)
    first, last = demonstration.DEPLOYED_S, demonstration.RECOVERED_S
    text = _mooring(PUBLISHED, (spec.latitude_deg, spec.longitude_deg, spec.water_depth_m), (first, last))
    text["fit"] = {"method": "von_appen"}
    text["instruments"]["deep"] = _pd0(PUBLISHED, "deep", 104, "down")
    _write_yaml(cruise / f"config/moorings/{PUBLISHED}.yaml", text)
    text |= {"name": SERIES, "diagnose": {"enabled": False}}
    _write_yaml(cruise / f"config/moorings/{SERIES}.yaml", text)


def _counts(count: int) -> dict[str, int]:
    """Return how many of each kind, by largest remainders."""
    exact = {kind: share * count for kind, share in SHARES.items()}
    whole = {kind: int(x) for kind, x in exact.items()}
    order = sorted(exact, key=lambda kind: whole[kind] - exact[kind])
    for kind in order[: count - sum(whole.values())]:
        whole[kind] += 1
    return whole


def _one(rng: np.random.Generator, name: str, kind: str, turn: int, seed: int, hours: int) -> Sealed:
    wide = bool(rng.random() < 0.35)
    size = float(np.exp(rng.uniform(np.log(SMALLEST_DEG), np.log(LARGEST_DEG))))
    export = Export(
        deep=str(rng.choice(["pd0", "table"])), coordinates=str(rng.choice(["earth", "earth", "earth", "beam"]))
    )
    if kind == "undecidable":
        return _undecidable(name, turn, size, seed, hours)
    if kind == "shifted":
        export = Export(temperature_late_d=float(rng.uniform(50.0, 110.0)))
    wanted = {
        "single": {SINGLES[turn % len(SINGLES)]: size},
        "pair": dict.fromkeys(PAIRS[turn % len(PAIRS)], max(size, 1.2)),
        "strange": {UNNAMED[turn % len(UNNAMED)]: size},
        "shifted": {"temperature": size},
    }.get(kind, {})
    if "field_disturbance" in wanted:
        wanted["field_disturbance"] = min(size, LARGEST_STORM_DEG)
        export = Export(deep="table", true_referenced=True, observatory=True)
    battery = "change" if "battery_change" in wanted or rng.random() < 0.15 else "knee"
    wish = Wish(
        wide=wide, battery=battery, noise=2.0 if kind == "noisy" else 1.0, hours=hours, turned_by_lower=kind == "locked"
    )
    return Sealed(name, kind, wanted, wish=wish, export=export, seed=seed)


def _undecidable(name: str, turn: int, size: float, seed: int, hours: int) -> Sealed:
    """Return a mooring whose cause cannot be told: a battery that falls in a line, a storm that no observatory saw."""
    if turn % 2:
        wish, rivals = Wish(battery="line", hours=hours), ("compass_drift", "hard_iron_drift")
        return Sealed(name, "undecidable", {"supply_voltage": max(size, 1.5)}, rivals, wish, seed=seed)
    unseen, storm = Export(deep="table", true_referenced=True), {"field_disturbance": LARGEST_STORM_DEG}
    return Sealed(name, "undecidable", storm, (), Wish(wide=True, hours=hours), unseen, seed)


def _described(one: Sealed, ground: Ground) -> dict[str, Any]:
    span = (float(ground.stamp_s[0]), float(ground.stamp_s[-1]) + 2 * DEEP_SAMPLE_S)
    place = (ground.latitude_deg, ground.longitude_deg, ground.water_depth_m)
    text = _mooring(one.name, place, span)
    if one.export.deep == "table":
        text["instruments"]["deep"] = {
            "format": "table",
            "files": f"raw/{one.name}/deep.csv",
            "depth": 112,
            "direction_reference": "true" if one.export.true_referenced else "magnetic",
            "columns": {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01},
        }
    if one.export.observatory:
        seen = {"format": "iaga2002", "files": f"raw/{one.name}/observatory.min"}
        text["covariates"] = {"declination_observatory": seen}
    return text


def _mooring(name: str, place: tuple[float, float, float], span_s: tuple[float, float]) -> dict[str, Any]:
    first, last = (datetime.fromtimestamp(x, UTC).strftime("%Y-%m-%dT%H:%M:%SZ") for x in span_s)
    return {
        "name": name, "latitude": place[0], "longitude": place[1], "water_depth": place[2],
        "start": first, "end": last, "declination": "auto", "compromised": "top", "reference": "deep",
        "instruments": {"top": _pd0(name, "top", 100, "up"), "deep": _pd0(name, "deep", 104, "down")},
    }  # fmt: skip


def _pd0(name: str, role: str, depth: int, orientation: str) -> dict[str, Any]:
    return {"format": "pd0", "files": f"raw/{name}/{role}.000", "depth": depth, "orientation": orientation}


def _write_yaml(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def _lock(locked: Path, name: str, facts: dict[str, Any], raw: Written) -> None:
    (locked / f"{name}.json").write_text(json.dumps(facts, indent=1) + "\n")
    series = (raw.time_s, raw.heading_deg, raw.recorded_deg, raw.plain_deg, raw.veer_deg)
    np.save(locked / f"{name}.npy", np.stack(series))


def _bounds(ground: Ground, raw: Written) -> dict[str, float]:
    """Return the errors of a heading that nobody can beat, rms degrees: without the effects known, and with them.

    Both have five coefficients fitted to the true headings; the oracle also knows what every effect did.
    """
    known = np.isfinite(raw.heading_deg)
    bare = readings.read(ground, (), ground.stamp_s, ground.random("readings"))
    return {
        "five_deg": float(np.std(planting.left_deg(raw.recorded_deg[known], raw.heading_deg[known]))),
        "oracle_deg": float(np.std(planting.left_deg(bare.recorded_deg, bare.heading_deg))),
    }
