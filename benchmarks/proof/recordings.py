"""Real recordings with one concealed cause: their diagnoses by the pipeline, and scores."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from benchmarks.proof import measure, score
from benchmarks.proof.run import workflow

CRUISE = "cruise_eh2"
# Recorded headings of Moncunill et al. 2023, section 5.3, from N by eighths of the circle: correct minus deviation.
EIGHT_DEVIATIONS_DEG = (-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123)


@dataclass(frozen=True)
class Recording:
    """One recording, its input to the pipeline, and its known cause."""

    name: str
    concealed: str
    known: str
    effects: tuple[str, ...]  # all effects to be named, possibly none
    kind: str = "single"
    file: str = ""
    settings: dict[str, Any] = field(default_factory=dict)


CALIBRATIONS = (
    Recording(
        "acm_mmp", "tilt compensation", "without it the heading is 7.8° rms wrong, with it 0.04°",
        ("tilt_uncompensated",), "single", "acm/mmp_global_A0000001.TXT",
        {"kind": "magnetometer", "format": "mmp_acm", "latitude": 65.0, "longitude": -33.0, "date": "2007-09-04"},
    ),
    Recording(
        "signature500", "hard iron and levelling", "first harmonic of the modulus 22.6 %, 12.9° of deviation",
        ("hard_iron", "tilt_uncompensated"), file="magnetometer/signature500.csv", settings={"kind": "magnetometer"},
    ),
    Recording(
        "eskdalemuir", "the storm of 29 October 2003", "4.2° of declination in one day", ("field_disturbance",),
        file="observatory/esk20031029dmin.min", settings={"kind": "declination", "format": "iaga2002"},
    ),
    Recording(
        "taiohae", "set and drift of the water", "the residual of 7.5° at 3 kn is mostly not the compass",
        ("water_drift",), file="swing/2010-11-03.Taiohae.nmea",
        settings={"kind": "swing", "format": "nmea0183", "latitude": -8.92, "longitude": -140.1, "date": "2010-11-03"},
    ),
    Recording(
        "eight_headings", "third and fourth harmonics", "both are there; eight points cannot prove it", (),
        kind="insufficient", settings={"kind": "platform", "latitude": 41.4, "longitude": 2.2, "date": "2021-06-01"},
    ),
)  # fmt: skip
MOORINGS = (
    Recording("E0", "nothing", "the eh2 record untouched, its own bins two cells down trusted", (), kind="null"),
    Recording("E1", "nothing", "iron of 0.12 to 0.3 H, injected; the ordinary fit holds it", (), kind="null"),
)


def run(work: Path, data: Path, cores: int) -> None:
    """Process the available recordings by the workflow, each as a separate cruise, as a kind may be refused."""
    for one in (*MOORINGS, *CALIBRATIONS):
        cruise = work / one.name
        if _absent(one, data) or (cruise / "wrong.txt").exists():
            continue
        shutil.rmtree(cruise, ignore_errors=True)
        for folder in ("config/moorings", "config/calibrations", "raw"):
            (cruise / folder).mkdir(parents=True)
        moorings = "config/moorings" if one in MOORINGS else "[]"
        (cruise / "config/config.yaml").write_text(f"moorings: {moorings}\n")
        (_mooring if one in MOORINGS else _calibration)(one, data, cruise)
        print(f"recording {one.name}", file=sys.stderr, flush=True)
        wrong = workflow(cruise.resolve(), [str(_diagnosis(one).parent / "logs/diagnose.json")], cores)
        (cruise / "wrong.txt").write_text(wrong)


def scored(work: Path, data: Path) -> list[dict[str, Any]]:
    """Score the diagnosis of every recording, for the pipeline and for all tools of comparison."""
    found, tools = [], score.tools([truth_of(one) for one in (*MOORINGS, *CALIBRATIONS)])
    for one in (*MOORINGS, *CALIBRATIONS):
        line: dict[str, Any] = {"name": one.name, "concealed": one.concealed, "known": one.known, "points": {}}
        line["cause"] = one.kind != "null"  # otherwise there is nothing beyond the configured fit
        if missing := _absent(one, data):
            found.append(line | {"said": missing})
            continue
        left, wrong, truth = work / one.name / _diagnosis(one), work / one.name / "wrong.txt", truth_of(one)
        why = wrong.read_text() if wrong.exists() else "it was not run"
        stopped = {"verdict": "stopped", "findings": [], "unexplained": None, "why": why}
        diagnosis = measure.diagnosis(left.parent) if left.exists() else stopped
        line["points"] = {name: score.points(truth, tool(truth, diagnosis)) for name, tool in tools.items()}
        found.append(line | {"said": _said(diagnosis), "outcome": score.judge(truth, diagnosis)})
    return found


def truth_of(one: Recording) -> dict[str, Any]:
    """Construct the truth of a recording in the form of that of a mooring."""
    effects = [{"name": name, "right": [name], "side": "compass", "visible_deg": 0.0} for name in one.effects]
    return {"kind": one.kind, "effects": effects, "rivals": [], "real": True}


def _diagnosis(one: Recording) -> Path:
    return Path("results") / ("" if one in MOORINGS else "calibrations") / one.name / "diagnosis.json"


def _said(diagnosis: dict[str, Any]) -> str:
    named = "; ".join(
        " or ".join(names) + f" {one['rms_effect_deg']:.1f}°"
        for names, one in zip(score.sets(diagnosis), diagnosis["findings"], strict=True)
    )
    left = diagnosis["unexplained"]
    beside = "" if left is None else f" unexplained {left['rms_effect_deg']:.1f}° {left['where']['text']}"
    why = str(diagnosis.get("why") or "") if diagnosis["verdict"] in ("insufficient", "stopped") else ""
    return f"{diagnosis['verdict']}: {named}{beside}{why}".rstrip(": ")


def _absent(one: Recording, data: Path) -> str:
    wanted = CRUISE if one in MOORINGS else one.file
    return "" if not wanted or (data / wanted).exists() else f"{wanted} is absent from the folder of recordings"


def _mooring(one: Recording, data: Path, cruise: Path) -> None:
    source = data / CRUISE
    shutil.copyfile(source / f"config/moorings/{one.name}.yaml", cruise / f"config/moorings/{one.name}.yaml")
    (cruise / "raw" / one.name).symlink_to((source / "raw" / one.name).resolve())


def _calibration(one: Recording, data: Path, cruise: Path) -> None:
    file = f"raw/{one.name}{Path(one.file).suffix or '.csv'}"
    if one.file:
        (cruise / file).symlink_to((data / one.file).resolve())
    else:
        correct = [45.0 * k for k in range(8)]
        pairs = (f"{b:.3f},{b - d:.3f}\n" for b, d in zip(correct, EIGHT_DEVIATIONS_DEG, strict=True))
        (cruise / file).write_text("reference_deg,recorded_deg\n" + "".join(pairs))
    text = yaml.safe_dump(one.settings | {"file": file})
    (cruise / f"config/calibrations/{one.name}.yaml").write_text(text)
