"""Diagnose the real recordings that come with the project, with a correction withheld and without."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import calibrations, earthfield
from compasslib.archive.calibrations import StoredCalibration
from compasslib.archive.files import embed_png, write_json
from compasslib.calibrations import result
from compasslib.calibrations.result import DeviationTable
from compasslib.inference import wording
from compasslib.inference.diagnosis import Diagnosis
from compasslib.plots.calibrations import draw_deviation
from compasslib.plots.diagnosis import count_outside, draw_calibration
from compasslib.report import words
from compasslib.stages.real import RECORDINGS, Recording


def recordings(*, made: str, say: Callable[[str], None]) -> None:
    """Write what was found in each recording, as recorded or by what was withheld, beside what is known."""
    content = [describe(recording) for recording in RECORDINGS]
    write_json(Path(made), {"recordings": content})
    say(f"{made}: {len(content)} real recordings")


def describe(recording: Recording) -> dict[str, Any]:
    """Diagnose a recording and describe each case; of the first one, deviation or residual is drawn."""
    diagnoses = recording.diagnose()
    first = next(iter(diagnoses.values())).to_json()
    drawings = dict[str, Callable[[Path], None]]()
    if recording.kind == "platform" and first["curves"]:
        drawings = {"deviation": partial(draw_deviation, shown=stored(recording))}
    elif first["curves"]:
        drawings = {"residual": partial(draw_calibration, diagnosis=first)}
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        for what, draw in drawings.items():
            draw(file := Path(folder) / f"{what}.png")
            picture, (width, height) = embed_png(file)
            figures.append({"what": what, "picture": picture, "width": width, "height": height})
    return {
        "name": recording.name,
        "title": recording.title,
        "concealed": recording.concealed,
        "truth": recording.known_by,
        "effects": recording.effects,
        "cases": [_case(recording, what, diagnosis) for what, diagnosis in diagnoses.items()],
        "figures": figures,
        "outside": count_outside(first) if figures else None,
    }


def stored(recording: Recording) -> StoredCalibration:
    """Calibrate a recording, in the form in which figures read it."""
    settings = earthfield.resolve_settings({"kind": recording.kind, **recording.settings})
    made = calibrations.calibrate(recording.kind, [recording.file], settings)
    table = made.table or DeviationTable(*np.zeros((3, 0)))
    return StoredCalibration(result.to_json(recording.name, made, settings), table, made.points)


def _case(recording: Recording, what: str, diagnosis: Diagnosis) -> dict[str, Any]:
    first = next(iter(diagnosis.findings), None)
    named = {name for finding in diagnosis.findings for name in (finding.effect, *finding.alternatives)}
    followed = {finding.driver for finding in diagnosis.findings}
    return {
        "what": what,
        "verdict": diagnosis.verdict,
        "conclusion": conclude(diagnosis),
        "expected": recording.as_expected(what, named, followed, diagnosis.verdict),
        "heldout_deg": None if first is None else [first.held_out.rms_before_deg, first.held_out.rms_after_deg],
    }


def conclude(diagnosis: Diagnosis) -> str:
    """Say in a line what was named, with the probabilities, or why nothing was."""
    if diagnosis.verdict == "insufficient":
        return diagnosis.why
    names = [
        " or ".join(
            f"{wording.display_name(name)} ({words.chance(probability)})"
            for name, probability in {finding.named: finding.probability, **finding.alternatives_probability}.items()
        )
        for finding in diagnosis.findings
    ]
    if (left := diagnosis.unexplained) is not None:
        along = " and ".join(name.replace("_", " ") for name in left.covariates)
        names.append(f"a mismatch of {left.rms_effect_deg:.1f}° rms along {along} that no listed effect explains")
    return "; ".join(names) or "no mismatch was noticed"
