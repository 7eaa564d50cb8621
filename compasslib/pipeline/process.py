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
from typing import Any

from compasslib.config.cruise import Cruise, load_cruise
from compasslib.errors import InputError
from compasslib.stages import calibrate, correct, diagnose, fit, grid, overlap, read
from compasslib.stages.settings import Calibrations, Compasses, Moorings, check_cruise
from compasslib.statistics import single_threaded

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
    if there.resolve().is_relative_to((loaded.root / "results").resolve()):
        expected, advice = "a folder outside the workflow's results", "name another folder"
        raise InputError(str(there), expected=expected, found="one inside", advice=advice)
    if there.exists():
        advice = "name another folder, or move that one away"
        raise InputError(str(there), expected="a folder that is not there yet", found="it there", advice=advice)
    there.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{there.name}.", dir=there.parent) as temporary, chdir(loaded.root):
        process(loaded, mooring, Path(temporary, "whole"), say)
        Path(temporary, "whole").rename(there)
    return there


@single_threaded()
def process(
    cruise: Cruise, mooring: str, folder: Path, say: Say = lambda line: None, *, compared_and_gridded: bool = True
) -> None:
    """Read, find pairs, fit, search for effects and correct, for each affected instrument of a mooring; then grid.

    The cruise is the working folder. Calibrations and other moorings of the compass are processed below ``work``.

    Args:
        folder: folder of the mooring's results, in which files are overwritten.
        compared_and_gridded: whether forms of the curve are compared, and velocities gridded if configured.
    """
    of, compasses = Moorings(cruise), Compasses(cruise).moorings
    parts = {part: _files(of, part, folder / part.removeprefix(mooring).strip("/")) for part in of.parts(mooring)}
    for part, files in parts.items():
        _fit(cruise, part, files, folder, say)
        if part in compasses:
            joined = {"joined": _combine_records(cruise, compasses[part], part, files, folder, say)}
            _call(diagnose.diagnose_jointly, part, say, files | joined, of.diagnose_jointly(part))
        else:
            _call(diagnose.diagnose, part, say, files, of.diagnose(part))
        _call(correct.correct, part, say, files, of.correct(part))
        if compared_and_gridded:
            _call(correct.compare, part, say, files)
    if compared_and_gridded and mooring in of.gridded:
        first, each = next(iter(parts.values())), list(parts.values())
        lists = {f"{name}s": [files[name] for files in each] for name in ("record", "deviation", "assessment", "field")}
        lists |= {"corrected": [files["corrected"] for files in each], "pairs": [files["overlap"] for files in each]}
        gridded = {"gridded": [str(folder / file) for file in of.gridded[mooring]]}
        _call(grid.grid, mooring, say, first | lists | gridded, of.grid(mooring))


def _files(of: Moorings, name: str, folder: Path) -> dict[str, Any]:
    """Name the files of the stages of one affected instrument, as the rules of the workflow do."""
    record, *references = (str(folder / f"work/{role}.nc") for role in of.roles(name))
    names = {
        **{stem: f"work/{stem}.json" for stem in ("field", "fit", "agreement")},
        **{stem: f"{stem}.json" for stem in ("diagnosis", "deviation", "assessment", "forms")},
        **{stem: f"{stem}.csv" for stem in ("table", "histograms")},
        **{stem: f"{stem}.nc" for stem in ("corrected", "overlap")},
        "pairs": "work/pairs/overlap.nc",
        "wide": "work/pairs/wide.nc",
    }
    alone = [str(folder / f"work/alone/{stem}.json") for stem in ("diagnosis", "deviation", "agreement", "summary")]
    inputs = {"observatory": of.observatory(name), "ready": of.ready_pairs(name), "alone": alone[:3]}
    shared = {"record": record, "upper": record, "references": references, "lower": references}
    return {key: str(folder / file) for key, file in names.items()} | inputs | shared | {"summary_alone": alone[3]}


def _fit(cruise: Cruise, name: str, files: dict[str, Any], folder: Path, say: Say) -> None:
    """Read the instruments, find pairs, and fit the compass or convert its calibration."""
    of = Moorings(cruise)
    for role, record in zip(of.roles(name), (files["record"], *files["references"]), strict=True):
        raw = {"raw": of.raw_files(name, role), "companions": of.companion_files(name, role), "record": record}
        read.read(name, role, **raw, **of.read(name, role), say=say)
    _call(overlap.overlap, name, say, files, of.overlap(name))
    if names := of.calibrations(name):
        made = {"calibrations": [_calibrate(cruise, each, folder) for each in names]}
        _call(fit.transfer_calibration, name, say, files | made, of.transfer_calibration(name))
    else:
        _call(fit.fit, name, say, files, of.fit(name))


def _calibrate(cruise: Cruise, name: str, folder: Path) -> str:
    """Calibrate a compass and return its calibration.json, without comparison, in the work folder of a mooring."""
    of, there = Calibrations(cruise), folder / "work/calibrations" / name
    files = {part: str(there / file) for part, file in calibrate.FILES.items()}
    _call(calibrate.calibrate, name, lambda line: None, files | {"raw": of.raw_files(name)}, of.calibrate(name))
    return files["calibration"]


def _combine_records(cruise: Cruise, compass: str, mooring: str, files: dict[str, Any], folder: Path, say: Say) -> str:
    """Diagnose each record of a compass alone, combine those that can be used, and return compass.json."""
    of, there = Compasses(cruise), folder / "work/compasses"
    moorings, calibrations = of.members[compass]
    summaries = []
    for name in moorings:
        quiet = say if name == mooring else lambda line: None
        own = files if name == mooring else _files(Moorings(cruise), name, there / name)
        try:
            if name != mooring:
                _fit(cruise, name, own, there / name, quiet)
        except InputError:
            continue
        alone = dict(zip(("diagnosis", "deviation", "agreement"), own["alone"], strict=True))
        alone["summary"] = own["summary_alone"]
        _call(diagnose.diagnose, name, quiet, own | alone, Moorings(cruise).diagnose(name))
        summaries.append(alone["summary"])
    calibrated = []
    for name in calibrations:
        with suppress(InputError):
            calibrated.append(_calibrate(cruise, name, folder))
    made = {"summaries": summaries, "calibrations": calibrated}
    joined = {"joined": str(there / "compass.json"), "diagnosis": str(there / "diagnosis.json")}
    _call(diagnose.combine_records, compass, lambda line: None, made | joined, of.combine_records(compass))
    return joined["joined"]


def _call(stage: Callable[..., None], name: str, say: Say, files: dict[str, Any], settings: Any = None) -> None:
    """Run a stage with those files and settings that are among its arguments, as a job of the workflow does."""
    named = files | (settings or {}) | {"say": say}
    stage(name, **{key: value for key, value in named.items() if key in signature(stage).parameters})
