"""Process one mooring without Snakemake, from its YAML file to its product: the method as a straight function.

The stages are those of the workflow, and the product is identical in every value. Figures, summary and report are made
by the workflow only.
"""

from __future__ import annotations

import tempfile
from contextlib import chdir, suppress
from pathlib import Path

from compasslib.config.cruise import Cruise, load_cruise
from compasslib.errors import InputError
from compasslib.pipeline.job import call_stage
from compasslib.stages import Files, Say, correct, diagnose, fit, read
from compasslib.stages.settings import Arguments, Calibrations, Compasses, Moorings, check_cruise
from compasslib.statistics import single_threaded

FILES = (
    *("work/field.json", "work/pairs/wide.nc", "work/fit.json", "work/agreement.json", "diagnosis.json"),
    *("deviation.json", "corrected.nc", "overlap.nc", "assessment.json", "table.csv", "histograms.csv"),
)
ALONE = ("diagnosis", "deviation", "agreement")  # of a record of a shared compass by itself
CALIBRATION_FILES = {"calibration": "calibration.json", "table": "table.csv", "points": "points.csv"}


def process_mooring(cruise: str | Path, mooring: str, folder: str | Path, say: Say = lambda line: None) -> Path:
    """Correct one mooring of a cruise and return the folder of its results, which appears complete or not at all.

    Meanwhile the cruise folder is the working folder, as in the workflow; the function is not thread-safe.

    Args:
        folder: folder of the results, which must not exist yet; as ``results/NAME`` of the workflow, without figures.
        say: called with the report of each stage on its result.

    Raises:
        InputError: a mistake in the cruise, a raw file that cannot be read, or a folder that already exists.
    """
    loaded, there = load_cruise(Path(cruise).absolute()), Path(folder).absolute()
    check_cruise(loaded)
    if mooring not in (*loaded.moorings, *loaded.whole):
        expected = f"a mooring of {cruise} ({', '.join(loaded.moorings) or 'it has none'})"
        raise InputError(mooring, expected=expected, found="another name", advice="write one of these names")
    if there.exists() or there.resolve().is_relative_to((loaded.root / "results").resolve()):
        expected = "a folder that is not there yet, outside the workflow's results"
        raise InputError(str(there), expected=expected, found="another", advice="name another folder")
    there.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{there.name}.", dir=there.parent) as temporary, chdir(loaded.root):
        process(loaded, mooring, Path(temporary, "whole"), say)
        Path(temporary, "whole").rename(there)
    return there


@single_threaded()
def process(cruise: Cruise, mooring: str, folder: Path, say: Say = lambda line: None, *, gridded: bool = True) -> None:
    """Read, find pairs, fit, search for effects and correct, for each affected instrument of a mooring; then grid.

    The cruise is the working folder; files in ``folder`` are overwritten. Calibrations and other moorings of the
    compass are processed below ``work``. Velocities are gridded if configured, unless ``gridded`` is false.
    """
    settings, parts = Moorings(cruise), []
    for part in settings.parts(mooring):
        files = _fit(cruise, part, folder / part.removeprefix(mooring).strip("/"), say)
        if part in Compasses(cruise).moorings:
            files["joined"] = _combine_records(cruise, part, files)
        call_stage(diagnose.diagnose, [part], Files(**files), say, settings.diagnose(part))
        call_stage(correct.correct, [part], Files(**files), say, settings.correct(part))
        parts.append(files)
    if gridded and mooring in settings.gridded:
        stems = {f"{stem}s": stem for stem in ("record", "deviation", "assessment", "field")}
        stems |= {"corrected": "corrected", "pairs": "overlap"}
        lists = {name: [files[stem] for files in parts] for name, stem in stems.items()}
        lists["gridded"] = [f"{folder}/{file}" for file in settings.gridded[mooring]]
        call_stage(correct.grid, [mooring], Files(**parts[0] | lists), say, settings.grid(mooring))


def _fit(cruise: Cruise, name: str, folder: Path, say: Say) -> Arguments:
    """Read the instruments, find pairs, and fit the compass or convert its calibration; return the files by name."""
    settings = Moorings(cruise)
    record, *references = [f"{folder}/work/{role}.nc" for role in settings.roles(name)]
    files: Arguments = {Path(file).stem: f"{folder}/{file}" for file in FILES}
    files |= {"folder": folder, "record": record, "references": references}
    files |= {"observatory": settings.observatory(name), "ready": settings.ready_pairs(name)}
    files["pairs"] = f"{folder}/work/pairs/overlap.nc"
    files["alone"] = [f"{folder}/work/alone/{stem}.json" for stem in ALONE]
    for role, path in zip(settings.roles(name), (record, *references), strict=True):
        raw, companions = settings.raw_files(name, role), settings.companion_files(name, role)
        given = Files(raw=raw, companions=companions, record=path)
        call_stage(read.read, [name, role], given, say, settings.read(name, role))
    call_stage(read.overlap, [name], Files(**files), say, settings.overlap(name))
    if calibrations := [_calibrate(cruise, each, folder) for each in settings.calibrations(name)]:
        transferred = Files(**files, calibrations=calibrations)
        call_stage(fit.transfer_calibration, [name], transferred, say, settings.transfer_calibration(name))
    else:
        call_stage(fit.fit, [name], Files(**files), say, settings.fit(name))
    return files


def _calibrate(cruise: Cruise, name: str, folder: Path) -> str:
    """Calibrate a compass and return its calibration.json, without comparison, in the work folder of a mooring."""
    settings = Calibrations(cruise)
    files = {key: f"{folder}/work/calibrations/{name}/{file}" for key, file in CALIBRATION_FILES.items()}
    given = Files(**files, raw=settings.raw_files(name))
    call_stage(fit.calibrate, [name], given, _say_nothing, settings.calibrate(name))
    return files["calibration"]


def _combine_records(cruise: Cruise, mooring: str, files: Arguments) -> str:
    """Diagnose each record of a mooring's compass alone, combine those that can be used, and return compass.json."""
    settings, folder = Compasses(cruise), files["folder"] / "work/compasses"
    compass = settings.moorings[mooring]
    summaries, calibrations = list[str](), list[str]()
    for name in cruise.compasses[compass][0]:
        try:
            member = files if name == mooring else _fit(cruise, name, folder / name, _say_nothing)
        except InputError:
            continue
        summaries.append(f"{member['folder']}/work/alone/summary.json")
        alone = dict(zip(ALONE, member["alone"], strict=True)) | {"summary": summaries[-1]}
        call_stage(diagnose.diagnose, [name], Files(**member | alone), _say_nothing, Moorings(cruise).diagnose(name))
    for name in cruise.compasses[compass][1]:
        with suppress(InputError):
            calibrations.append(_calibrate(cruise, name, files["folder"]))
    joined = f"{folder}/compass.json"
    made = Files(summaries=summaries, calibrations=calibrations, joined=joined, diagnosis=f"{folder}/diagnosis.json")
    call_stage(diagnose.combine_records, [compass], made, _say_nothing, settings.combine_records(compass))
    return joined


def _say_nothing(line: str) -> None:
    pass
