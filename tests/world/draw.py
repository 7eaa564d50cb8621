"""Writer of simulated moorings as a cruise folder, with the truth in a separate folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from compasslib.demo import sealed
from compasslib.demo.sealed import DEEP_SAMPLE_S, Ground, Wish
from tests.world import planting


@dataclass(frozen=True)
class Sealed:
    """Specification of a simulated mooring."""

    name: str
    wanted: dict[str, float] = field(default_factory=dict)  # visible rms degrees
    wish: Wish = field(default_factory=Wish)
    seed: int = 0


def write(one: Sealed, cruise: Path, locked: Path) -> None:
    """Write raw files and configuration of a mooring, and separately its times, correct and recorded headings."""
    ground = sealed.make(one.seed, one.name, one.wish)
    effects = [each.effect for each in planting.plant(ground, one.wanted)]
    raw = sealed.write(ground, effects, cruise / "raw" / one.name)
    _write_yaml(cruise / f"config/moorings/{one.name}.yaml", _described(one, ground))
    np.save(locked / f"{one.name}.npy", np.stack([raw.time_s, raw.heading_deg, raw.recorded_deg]))


def write_alone(one: Sealed, folder: Path) -> tuple[Path, Path]:
    """Write a cruise of one mooring and return the folders of the cruise and of the truth."""
    cruise, locked = folder / "cruise", folder / "locked"
    (cruise / "config/moorings").mkdir(parents=True)
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    locked.mkdir()
    write(one, cruise, locked)
    return cruise, locked


def _described(one: Sealed, ground: Ground) -> dict[str, Any]:
    span = (float(ground.stamp_s[0]), float(ground.stamp_s[-1]) + 2 * DEEP_SAMPLE_S)
    place = (ground.latitude_deg, ground.longitude_deg, ground.water_depth_m)
    return _mooring(one.name, place, span)


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
