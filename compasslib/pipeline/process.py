"""Process one mooring without Snakemake, from its YAML file to its product: the method as a straight function.

The stages are those of the workflow, and the product is identical in every value. Figures, summary and report are made
by the workflow only.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import chdir, suppress
from inspect import signature
from pathlib import Path

from compasslib.config.cruise import Cruise, load_cruise
from compasslib.errors import InputError
from compasslib.stages import calibrate, correct, diagnose, fit, grid, read
from compasslib.stages.settings import Arguments, Calibrations, Compasses, Moorings, check_cruise
from compasslib.statistics import single_threaded

FILES = (
    *("work/field.json", "work/pairs/wide.nc", "work/fit.json", "work/agreement.json", "diagnosis.json"),
    *("deviation.json", "corrected.nc", "overlap.nc", "assessment.json", "table.csv", "histograms.csv"),
)
ALONE = ("diagnosis", "deviation", "agreement")  # of a record of a shared compass by itself
Say = Callable[[str], None]


def process_mooring(cruise: str | Path, mooring: str, folder: str | Path, say: Say = lambda line: None) -> Path:
    """Correct one mooring of a cruise and return the folder of its results, which appears complete or not at all.

    Meanwhile the cruise folder is the working folder, as in the workflow; the function is not thread-safe.

    Args:
        folder: folder of the results, which must not exist yet; as ``results/NAME`` of the workflow, without figures.
        say: called with the report of each stage on its result.

    Raises:
        InputError: a mistake in the cruise, a raw file that cannot be read, or a folder that already exists.
    """
    loaded, there = load_cruise(Path(cruise)), Path(folder).absolute()
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
        _call(diagnose.diagnose, part, files, settings.diagnose(part))
        _call(correct.correct, part, files, settings.correct(part))
        parts.append(files)
    if gridded and mooring in settings.gridded:
        stems = {f"{stem}s": stem for stem in ("record", "deviation", "assessment", "field")}
        stems |= {"corrected": "corrected", "pairs": "overlap"}
        lists = {name: [files[stem] for files in parts] for name, stem in stems.items()}
        lists["gridded"] = [f"{folder}/{file}" for file in settings.gridded[mooring]]
        _call(grid.grid, mooring, parts[0] | lists, settings.grid(mooring))


def _fit(cruise: Cruise, name: str, folder: Path, say: Say) -> Arguments:
    """Read the instruments, find pairs, and fit the compass or convert its calibration; return the files by name."""
    settings = Moorings(cruise)
    record, *references = [f"{folder}/work/{role}.nc" for role in settings.roles(name)]
    files: Arguments = {Path(file).stem: f"{folder}/{file}" for file in FILES}
    files |= {"folder": folder, "say": say, "record": record, "references": references}
    files |= {"observatory": settings.observatory(name), "ready": settings.ready_pairs(name)}
    files["pairs"] = f"{folder}/work/pairs/overlap.nc"
    files["alone"] = [f"{folder}/work/alone/{stem}.json" for stem in ALONE]
    for role, path in zip(settings.roles(name), (record, *references), strict=True):
        raw, companions = settings.raw_files(name, role), settings.companion_files(name, role)
        read.read(name, role, raw=raw, companions=companions, record=path, **settings.read(name, role), say=say)
    _call(read.overlap, name, files, settings.overlap(name))
    if calibrations := [_calibrate(cruise, each, folder) for each in settings.calibrations(name)]:
        made = files | {"calibrations": calibrations}
        _call(fit.transfer_calibration, name, made, settings.transfer_calibration(name))
    else:
        _call(fit.fit, name, files, settings.fit(name))
    return files


def _calibrate(cruise: Cruise, name: str, folder: Path) -> str:
    """Calibrate a compass and return its calibration.json, without comparison, in the work folder of a mooring."""
    settings = Calibrations(cruise)
    files: Arguments = {key: f"{folder}/work/calibrations/{name}/{file}" for key, file in calibrate.FILES.items()}
    files |= {"raw": settings.raw_files(name), "say": lambda line: None}
    _call(calibrate.calibrate, name, files, settings.calibrate(name))
    return str(files["calibration"])


def _combine_records(cruise: Cruise, mooring: str, files: Arguments) -> str:
    """Diagnose each record of a mooring's compass alone, combine those that can be used, and return compass.json."""
    settings, folder = Compasses(cruise), files["folder"] / "work/compasses"
    compass = settings.moorings[mooring]
    summaries, calibrations = list[str](), list[str]()
    for name in settings.members[compass][0]:
        try:
            member = files if name == mooring else _fit(cruise, name, folder / name, lambda line: None)
        except InputError:
            continue
        summaries.append(f"{member['folder']}/work/alone/summary.json")
        alone = dict(zip(ALONE, member["alone"], strict=True)) | {"summary": summaries[-1]}
        _call(diagnose.diagnose, name, member | alone, Moorings(cruise).diagnose(name))
    for name in settings.members[compass][1]:
        with suppress(InputError):
            calibrations.append(_calibrate(cruise, name, files["folder"]))
    outputs = {"joined": f"{folder}/compass.json", "diagnosis": f"{folder}/diagnosis.json"}
    inputs = {"summaries": summaries, "calibrations": calibrations, "say": lambda line: None}
    _call(diagnose.combine_records, compass, inputs | outputs, settings.combine_records(compass))
    return outputs["joined"]


def _call(stage: Callable[..., None], name: str, files: Arguments, settings: Arguments) -> None:
    """Run a stage with those files and settings that are among its arguments, as a job of the workflow does."""
    named = files | settings
    stage(name, **{key: value for key, value in named.items() if key in signature(stage).parameters})
