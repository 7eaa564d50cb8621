"""``compass explain`` and ``compass verify``; location and completeness of results."""

import shlex
import sys
import tempfile
import textwrap
import zipfile
from argparse import Namespace
from collections.abc import Iterable, Iterator, Sequence
from contextlib import chdir, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from compasslib.archive import crate, deposit, summary
from compasslib.archive.files import read_json
from compasslib.cli import require_folder
from compasslib.config import cruise
from compasslib.config.schema import RESERVED
from compasslib.errors import InputError
from compasslib.report import sections, words
from compasslib.report.sections import QUESTION, ReportSection, read_calibration, read_mooring
from compasslib.stages.settings import Moorings

MOORING_FILES = ("corrected.nc", "deviation.json", "diagnosis.json", "assessment.json", "work/field.json")
CALIBRATION_FILES = ("calibration.json", "table.csv")
# Files of a deposit that are unpacked for comparison.
COMPARED = ("corrected.nc", "gridded.nc", "gridded_daily.nc", ".json", "table.csv")


def mooring_folder(cruise: str, mooring: str, parts: Sequence[str] = ("",), what: str = "mooring") -> Path:
    """Find the folder of a mooring's results, or of a calibration or compass in further ``parts`` of the results.

    Args:
        mooring: name in the cruise, or the folder itself.
        parts: subfolders of the results that are searched, "" for the results themselves.
    """
    root = Path(cruise) / "results"
    for folder in (*(root / part / mooring for part in parts), Path(cruise) / "corrected" / mooring, Path(mooring)):
        if folder.is_dir():
            return folder
    others = [path.name for part in parts if part for path in sorted((root / part).glob("*")) if path.is_dir()]
    there = ", ".join([*_moorings(root), *others]) if root.is_dir() else "no folder results"
    advice = f"write the name of a {what} that was run, and --cruise FOLDER where it is not in this one"
    raise InputError(mooring, expected=f"a {what} with results in {cruise}", found=there or "none", advice=advice)


@contextmanager
def unpack_deposit(place: str) -> Iterator[str]:
    """Yield a place to read from: a deposited ZIP unpacked for the duration of the block, anything else unchanged."""
    if not (Path(place).is_file() and zipfile.is_zipfile(place)):
        yield place
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = f"{temporary}/{Path(place).name}"  # so that messages name it
        with deposit.open_deposit(place, "fetch the deposit again") as packed:
            results = [name for name in packed.namelist() if name.startswith(f"{crate.FOLDER}/")]
            packed.extractall(folder, [name for name in results if name.endswith(COMPARED)])
        yield folder


def find_results(place: str) -> tuple[dict[str, Path], dict[str, Path]]:
    """Find the folders of moorings and of calibrations in a cruise or in results, or the one that is such a folder."""
    root = Path(place)
    alone = {root.resolve().name: root}
    if (root / CALIBRATION_FILES[0]).is_file():
        return {}, alone
    if any((root / file).is_file() for file in MOORING_FILES):
        return alone, {}
    for folder in (root / "results", root):
        calibrations = {path.name: path for path in sorted((folder / "calibrations").glob("*")) if path.is_dir()}
        if (moorings := _moorings(folder)) or calibrations:
            return moorings, calibrations
    missing_files = "no results in it" if root.is_dir() else "no such folder"
    advice = "name a cruise that was run, its folder results, or a copy of that"
    raise InputError(place, expected="a folder with results", found=missing_files, advice=advice)


def _moorings(root: Path) -> dict[str, Path]:
    """Find the folders of moorings, or of their instruments where several are corrected."""
    marks, reserved = ("work", "logs", *MOORING_FILES), {*RESERVED}
    folders = dict[str, Path]()
    for path in (*root.glob("*/"), *root.glob("*/*/")):
        parts = path.relative_to(root).parts
        if not reserved & {*parts} and any((path / mark).exists() for mark in marks):
            folders["/".join(parts)] = path
    wholes = {name.partition("/")[0] for name in folders if "/" in name}
    return {name: path for name, path in sorted(folders.items()) if name not in wholes}


def missing_files(folder: Path, needed: Sequence[str]) -> list[str]:
    """List the required files that are missing from results, as after an incomplete run."""
    return [file for file in needed if not (folder / file).is_file()]


@contextmanager
def check_version(where: object) -> Iterator[None]:
    """Convert errors of the block on missing content of result files to an error of one line."""
    try:
        yield
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        actual, advice = f"{type(error).__name__}: {error}", "run the cruise again"
        raise InputError(str(where), expected="results of this version", found=actual, advice=advice) from error


def align(lines: Sequence[Sequence[str]]) -> list[str]:
    """Pad the cells of lines to columns; cells after the first of a shorter line do not widen them."""
    n = max(map(len, lines))
    widths = [max(len(line[k]) for line in lines if k == 0 or len(line) == n) for k in range(n)]
    padded = ([cell.ljust(width) for cell, width in zip(line, widths, strict=False)] for line in lines)
    return ["  ".join(cells).rstrip() for cells in padded]


def print_warnings(warnings: Sequence[str], stream: TextIO | None = None) -> None:
    """Print each distinct warning of a command once, to stderr by default, at its end where the user notices them."""
    once = list(dict.fromkeys(warnings))
    if once:
        print(f"{len(once)} warning{'s' * (len(once) != 1)}:", *once, sep="\n  ", file=stream or sys.stderr, flush=True)


def explain(asked: Namespace) -> int:
    """Print the diagnosis of a mooring, of a calibration, or of a compass that several records share."""
    what = "mooring, calibration or compass"
    folder = mooring_folder(asked.cruise, asked.mooring, ("", "calibrations", "compasses"), what).resolve()
    root, name = folder.parents[1], folder.name
    needed = {"calibration": CALIBRATION_FILES, "compass": ("compass.json", "diagnosis.json")}
    what = next((part for part in needed if (folder / f"{part}.json").is_file()), "mooring")
    if (stopped := folder / "stopped.json").is_file():
        advice = "correct or replace the file, and run again"
        raise InputError(str(folder), f"a {what} that can be used", f"it stopped: {read_json(stopped)['why']}", advice)
    if files := missing_files(folder, needed.get(what, MOORING_FILES)):
        raise InputError(str(folder), f"all results of a {what}", f"no {files[0]}", "run the cruise to its end")
    with check_version(folder):
        if what == "calibration":
            section = sections.calibration_section(read_calibration(name, root), root)
        elif what == "compass":
            section = sections.compass_section(name, root)
        else:
            row = {key: str(value) for key, value in summary.summary_row(folder.name, folder).items()}
            read = read_mooring(folder.name, folder.parent, row)
            facts, limits = words.facts("mooring", "measures", r=read), sections.describe_limits(read.diagnosis)
            section = replace(sections.mooring_section(read, folder.parent), facts=facts, limits=limits)
        lines = explanation_lines(section, folder)
    print("\n".join(lines))
    return 0


def explanation_lines(section: ReportSection, folder: Path) -> list[str]:
    """Compose the lines of ``compass explain`` from a section of the report."""
    lines = [f"{section.name}: {section.verdict or 'not searched'}", *[QUESTION] * bool(section.use)]
    lines += _wrap(section.summary)
    lines += ["", *_wrap(f"{name}: {value}" for name, value in section.facts)]
    for finding in section.findings:
        numbers = [f"{': '.join(row)} (1σ)" for row in finding.parameters.rows] if finding.parameters else []
        named = [f"{name}: {value}" for name, value in finding.facts]
        lines += ["", f"Finding: {finding.title}", *_wrap([finding.text, *named, *numbers])]
    diagnosis = read_json(folder / "diagnosis.json") if (folder / "diagnosis.json").exists() else {}
    if diagnosis.get("curves") and (figure := folder / "figures/diagnosis.png").exists():
        lines += ["", f"Figure: {figure}", *_wrap([sections.diagnosis_caption(diagnosis)])]
    detectable = sections.table("diagnosis", "detectable", d=diagnosis)
    tables = [(table.caption, [", ".join(map(" ".join, table.rows))]) for table in detectable]
    for title, sentences in (("Limits of this record", section.limits), *tables, ("Warnings", section.warnings)):
        lines += ["", title, *_wrap(sentences)] if sentences else []
    said = words.occurring(lines)
    if (folder.parents[1] / f"concealed/{section.name}.json").exists():
        said |= {section.name: words.definitions().get(words.CONCEALED, "")}
    return [*lines, "", "Terms", *_wrap(f"{term}: {what}" for term, what in said.items())] if said else lines


def _wrap(sentences: Iterable[str], *, width: int = 100) -> list[str]:
    wrapper = textwrap.TextWrapper(width, initial_indent=2 * " ", subsequent_indent=4 * " ")
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]


def verify(asked: Namespace) -> int:
    """Print differences from the manifest; with ``clear``, list or delete results that are no longer configured."""
    require_folder(asked.cruise)
    with chdir(asked.cruise):
        if asked.clear:
            return _clear(confirmed=asked.yes)
        try:
            configured = _configured_folders()
        except InputError as error:  # an archive may lack its raw files
            configured = None
            print(f"cannot list results that are no longer configured: {error}", file=sys.stderr)
        differ, page = crate.differences(Path(), configured), crate.read_manifest(Path())
    for what, path, details in differ:
        print(f"{what}: {_printable(path)}{details}")
    if outputs := crate.to_make_again(page, differ):
        print(f"mend: compass run {shlex.quote(asked.cruise)} -- --forcerun {_printable(shlex.join(outputs))}")
    files = f"{len(crate.listed(page))} files as listed"
    if differ:
        advice = "restore them, or repair them with the commands above"
        if any(what == crate.FORMER for what, *_ in differ):
            advice += "; compass verify --clear shows and removes what is no longer configured"
        raise InputError(crate.FILE, expected=files, found=f"{len(differ)} that differ", advice=advice)
    print(f"{crate.FILE}: {files}")
    return 0


def _clear(*, confirmed: bool) -> int:
    kinds = crate.unlisted_files(Path(), _configured_folders())
    former = [file for file, kind in kinds.items() if kind == crate.FORMER]
    for file in former:
        print(f"{'removed' if confirmed else 'would be removed'}: {_printable(file)}")
    for file in (file for file, kind in kinds.items() if kind == crate.NEW):
        print(f"kept: {_printable(file)}, which no job wrote as it is")
    if confirmed:
        crate.clear(Path(), former)
    more = "; add --yes to remove them" if former and not confirmed else ""
    print(f"{len(former)} files of what is no longer configured{more}")
    return 0


def _printable(path: str) -> str:
    return path if path.isprintable() else ascii(path)


def _configured_folders() -> list[str]:
    loaded = cruise.load_cruise(Path())
    others = (("calibrations", loaded.calibrations), ("compasses", loaded.compasses), ("sites", Moorings(loaded).sites))
    names = [*loaded.whole, *(f"{kind}/{name}" for kind, each in others for name in each)]
    return [f"{crate.FOLDER}/{name}" for name in names]
