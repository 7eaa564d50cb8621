"""Real recordings from which one cause is concealed: what the pipeline says of them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from benchmarks.proof.run import PROJECT, pipeline

DATA = PROJECT.parent / "shared" / "data"
CRUISE = "cruise_eh2"
MOORED = "moorings: config/moorings\n"
RULE = "rule diagnose_calibration:"
COLUMNS = ("recording", "concealed", "known", "right", "found")
# Recorded headings of Moncunill et al. 2023, section 5.3, from N by eighths of the circle: correct minus deviation.
EIGHT_DEVIATIONS_DEG = (-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123)


@dataclass(frozen=True)
class Recording:
    """One recording, how it is given to the pipeline, and what is known of it."""

    name: str
    concealed: str
    known: str
    right: tuple[str, ...]  # effects or a verdict, one of which is right
    file: str = ""
    settings: dict[str, Any] = field(default_factory=dict)


CALIBRATIONS = (
    Recording(
        "acm_mmp", "tilt compensation", "without it the heading is 7.8° rms wrong, with it 0.04°",
        ("tilt_uncompensated",), "acm/mmp_global_A0000001.TXT",
        {"kind": "magnetometer", "format": "mmp_acm", "latitude": 65.0, "longitude": -33.0, "date": "2007-09-04"},
    ),
    Recording(
        "signature500", "hard iron", "first harmonic of the horizontal modulus 22.6 %, 12.9° of deviation",
        ("hard_iron",), "magnetometer/signature500.csv", {"kind": "magnetometer"},
    ),
    Recording(
        "eskdalemuir", "the storm of 29 October 2003", "4.2° of declination in one day", ("field_disturbance",),
        "observatory/esk20031029dmin.min", {"kind": "declination", "format": "iaga2002"},
    ),
    Recording(
        "taiohae", "set and drift of the water", "the residual of 7.5° at 3 kn is mostly not the compass",
        ("water_drift",), "swing/2010-11-03.Taiohae.nmea",
        {"kind": "swing", "format": "nmea0183", "latitude": -8.92, "longitude": -140.1, "date": "2010-11-03"},
    ),
    Recording(
        "eight_headings", "third and fourth harmonics", "both are there; eight points cannot prove it",
        ("insufficient",), "", {"kind": "platform", "latitude": 41.4, "longitude": 2.2, "date": "2021-06-01"},
    ),
)  # fmt: skip
MOORINGS = (
    Recording("E0", "nothing", "the eh2 record untouched, its own bins two cells down trusted", ("consistent",)),
    Recording("E1", "the injected iron, 0.12 to 0.3 H", "an exact compass near that iron", ("consistent",)),
)


def run(work: Path, cores: int) -> None:
    """Put the recordings that are there through the pipeline, each as a cruise of its own: a kind may be refused.

    Args:
        work: folder that the cruises are made in.
    """
    shutil.rmtree(work, ignore_errors=True)
    for one in (*MOORINGS, *CALIBRATIONS):
        if _absent(one) or (one in CALIBRATIONS and _unavailable()):
            continue
        cruise = work / one.name
        for folder in ("config/moorings", "config/calibrations", "raw"):
            (cruise / folder).mkdir(parents=True)
        (cruise / "config/config.yaml").write_text(
            "moorings: config/moorings\n" if one in MOORINGS else "moorings: []\n"
        )
        (_mooring if one in MOORINGS else _calibration)(one, cruise)
        wrong = pipeline(cruise.resolve(), [str(_diagnosis(one))], cores, strict=False)
        (cruise / "wrong.txt").write_text(wrong)


def rows(work: Path) -> list[list[str]]:
    """Return the table's lines.

    Args:
        work: folder that the recordings were run in.
    """
    return [_row(one, work / one.name) for one in (*MOORINGS, *CALIBRATIONS)]


def _diagnosis(one: Recording) -> Path:
    return Path("results") / ("" if one in MOORINGS else "calibrations") / one.name / "diagnosis.json"


def _row(one: Recording, cruise: Path) -> list[str]:
    path, wrong = cruise / _diagnosis(one), cruise / "wrong.txt"
    if path.exists():
        diagnosis = json.loads(path.read_text())
        right, found = "yes" if _right(one.right, diagnosis) else "no", _said(diagnosis)
    else:
        missing = _absent(one) or (_unavailable() if one in CALIBRATIONS else "")
        right, found = "–", missing or (wrong.read_text() if wrong.exists() else "it was not run")
    return [one.name, one.concealed, one.known, right, found]


def _said(diagnosis: dict[str, Any]) -> str:
    named = "; ".join(
        " or ".join([f["effect"], *f["alternatives"]]) + f" {f['rms_effect_deg']:.1f}°" for f in diagnosis["findings"]
    )
    left = diagnosis["unexplained"]
    beside = "" if left is None else f" unexplained {left['rms_effect_deg']:.1f}° {left['where']['text']}"
    return f"{diagnosis['verdict']}: {named}{beside}".rstrip(": ")


def _right(wanted: Sequence[str], diagnosis: dict[str, Any]) -> bool:
    named = {name for one in diagnosis["findings"] for name in (one["effect"], *one["alternatives"])}
    return bool((named | {diagnosis["verdict"]}) & set(wanted))


def _absent(one: Recording) -> str:
    if one in MOORINGS:
        return "" if (DATA / CRUISE).is_dir() else f"../shared/data/{CRUISE} is absent"
    return "" if not one.file or (DATA / one.file).exists() else f"../shared/data/{one.file} is absent"


def _unavailable() -> str:
    rules = (PROJECT / "workflow/rules/calibrations.smk").read_text()
    return "" if RULE in rules else "the pipeline does not diagnose calibrations yet"


def _mooring(one: Recording, cruise: Path) -> None:
    source = DATA / CRUISE
    shutil.copyfile(source / f"config/moorings/{one.name}.yaml", cruise / f"config/moorings/{one.name}.yaml")
    (cruise / "raw" / one.name).symlink_to((source / "raw" / one.name).resolve())


def _calibration(one: Recording, cruise: Path) -> None:
    file = f"raw/{one.name}{Path(one.file).suffix or '.csv'}"
    if one.file:
        (cruise / file).symlink_to((DATA / one.file).resolve())
    else:
        correct = [45.0 * k for k in range(8)]
        pairs = (f"{b:.3f},{b - d:.3f}\n" for b, d in zip(correct, EIGHT_DEVIATIONS_DEG, strict=True))
        (cruise / file).write_text("reference_deg,recorded_deg\n" + "".join(pairs))
    text = yaml.safe_dump(one.settings | {"file": file})
    (cruise / f"config/calibrations/{one.name}.yaml").write_text(text)
