"""Cases of a campaign: drawn by a seed, each processed in a folder of its own."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bases
import calibrations
import cruises
import numpy as np
import runs
from cruises import Cruise, NotApplicableError, Outcome
from harmless import HARMLESS
from headings import HEADINGS
from identities import DECLINATION, IDENTITIES
from local import LOCAL
from moorings import CLOCKS, CONTENTS, METADATA, TABLES
from references import REFERENCES

HARM = 0.01  # share of the headings flagged 1 that a harmless change may cost
MISTAKES: dict[str, tuple[cruises.Attack, ...]] = {
    "declination": 2 * DECLINATION, "local": LOCAL, "headings": HEADINGS, "references": REFERENCES,
    "identities": IDENTITIES, "metadata": METADATA, "clocks": CLOCKS, "tables": TABLES, "contents": CONTENTS,
}  # fmt: skip
CALIBRATIONS, HARMLESS_KIND = "calibrations", "harmless"
KINDS = (*MISTAKES, CALIBRATIONS, HARMLESS_KIND)
OF_CALIBRATIONS = 0.1  # share of the cases that are calibrations
FIRST_BENCH = 100_000  # number of the first of them, to use no seed of a mooring
# Mistakes that no record can show: a constant is the same as A; a level log shows neither the sense of its axes nor
# which of two columns is the compass.
UNDECIDABLE = ("magnetometer: x of other sign", "magnetometer: axes exchanged", "columns exchanged")


@dataclass(frozen=True)
class Case:
    """One case of a campaign; all random numbers depend on ``seed`` only."""

    name: str
    kind: str
    attack: str
    base: int  # the base that is tried first; -1 for a calibration
    seed: tuple[int, int]
    harmless: bool = False


def draw(mistakes: int, harmless: int, seed: int) -> list[Case]:
    """Draw the cases of a campaign in random order, for the first of them to be representative."""
    attacks = [(kind, attack.__name__) for kind, several in MISTAKES.items() for attack in several]
    right = [(HARMLESS_KIND, attack.__name__) for attack in HARMLESS]
    cases = _drawn(attacks, mistakes, seed, harmless=False) + _drawn(right, harmless, seed + 1, harmless=True)
    return [cases[k] for k in np.random.default_rng(seed).permutation(len(cases))]


def _drawn(attacks: list[tuple[str, str]], count: int, seed: int, *, harmless: bool) -> list[Case]:
    rng, benches = np.random.default_rng(seed), list(calibrations.SPOILERS)
    of_benches, cases = round(OF_CALIBRATIONS * count), []
    while len(cases) < count - of_benches:
        for kind, attack in (attacks[k] for k in rng.permutation(len(attacks))):
            k = len(cases)
            name = f"{kind}-{attack}-{k:03d}"
            cases.append(Case(name, kind, attack, int(rng.integers(100)), (seed, k), harmless))
    cases = cases[: count - of_benches]
    for k in range(of_benches):
        attack, kind = benches[k % len(benches)], HARMLESS_KIND if harmless else CALIBRATIONS
        cases.append(Case(f"{kind}-{attack}-{k:03d}", kind, attack, -1, (seed, FIRST_BENCH + k), harmless))
    return cases


def attempt(case: Case, kept: Path, into: Path) -> dict[str, Any]:
    """Process one case unless its row exists; cruise and results are kept if it is wrong or crashed, or harms."""
    folder, file = into / case.name, into / case.name / "row.json"
    if file.exists():
        return dict(json.loads(file.read_text()))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    begun = time.process_time()
    try:
        row = _calibration(case, folder) if case.base < 0 else _mooring(case, kept, folder)
    except Exception as error:  # the campaign must record any failure
        row = {"done": case.attack, "crashed": f"{type(error).__name__}: {error}"}
    row = asdict(case) | row | {"cpu_s": time.process_time() - begun, "folder": str(folder)}
    if not (row.get("crashed") or row.get("wrong") or (row.get("hurt") and case.harmless)):
        for path in folder.iterdir():
            shutil.rmtree(path)
    file.write_text(json.dumps(row, default=float))
    return dict(json.loads(file.read_text()))


def untouched(base: bases.Base, kept: Path, into: Path) -> None:
    """Process an unmodified base and store its outcome with the cases of the same library."""
    file = into / f"{base.name}.json"
    if file.exists():
        return
    made, cruise = into / base.name / "made", Cruise.copy(kept, base.name, into / base.name / "cruise")
    cruise.save()
    outcome = cruises.run(cruise, made)
    if not outcome.refused:
        cruises.keep_declination(cruise, made)
    file.write_text(json.dumps(asdict(outcome)))


def untouched_by_workflow(base: bases.Base, kept: Path, into: Path, project: Path) -> None:
    """Process an unmodified base by the workflow of another checkout, and store its heading errors."""
    file = into / f"{base.name}.json"
    if file.exists():
        return
    cruise = Cruise.copy(kept, base.name, into / base.name / "cruise")
    cruise.save()
    took = runs.cost(runs.snakemake(cruise.folder, "--quiet", "all", cores=1, project=project), project)
    cruises.keep_errors_of_file(cruise, cruise.folder / "results/M/corrected.nc", into / base.name / "made")
    file.write_text(json.dumps(took._asdict()))


def applied(case: Case, kept: Path, folder: Path) -> tuple[Cruise, str]:
    """Apply an attack to a copy of the first base to which it is applicable."""
    attack = next(a for a in MISTAKES.get(case.kind, HARMLESS) if a.__name__ == case.attack)
    names = [base.name for base in bases.available()]
    for turn in range(len(names)):
        name = names[(case.base + turn) % len(names)]
        cruise = Cruise.copy(kept, name, folder / "cruise")
        try:
            return cruise, attack(cruise, np.random.default_rng(case.seed))
        except NotApplicableError:
            shutil.rmtree(folder / "cruise")
    raise LookupError(f"{case.attack} goes with no base")


def _mooring(case: Case, kept: Path, folder: Path) -> dict[str, Any]:
    cruise, done = applied(case, kept, folder)
    cruise.save()
    untouched = folder.parent.parent / "untouched"
    fields = json.loads((untouched / f"{cruise.base}.json").read_text())
    before = Outcome(**{key: tuple(x) if isinstance(x, list) else x for key, x in fields.items()})
    outcome = cruises.run(cruise, folder / "made", untouched / cruise.base / "made")
    wrong, good = cruises.is_wrong(outcome, before), cruises.is_called_good(outcome, before)
    return {"on": cruise.base} | _row(done, outcome, before, wrong=wrong, good=good, undecidable=cruise.undecidable)


def _calibration(case: Case, folder: Path) -> dict[str, Any]:
    kind, (first, second) = case.attack, case.seed
    (folder / "cruise").mkdir()
    plain = calibrations.make(kind, [first, second, 0], folder / "cruise")
    before = calibrations.run(plain, folder / "plain")
    made = calibrations.make(kind, [first, second, 0], folder / "cruise")
    spoil = calibrations.harmless if case.harmless else calibrations.spoil
    done = spoil(made, np.random.default_rng([first, second, 1]))
    outcome = calibrations.run(made, folder / "spoilt")
    wrong = calibrations.is_wrong(outcome, before)
    apart = any(word in f"{kind}: {done}" for word in UNDECIDABLE)
    return {"on": kind} | _row(done, outcome, before, wrong=wrong, good=False, undecidable=apart)  # it has no flags


def _row(done: str, outcome: Outcome, before: Outcome, *, wrong: bool, good: bool, undecidable: bool) -> dict[str, Any]:
    said = cruises.new_warnings(outcome, before)
    lost = outcome.good < before.good - HARM
    return {
        "done": done, "wrong": wrong, "silent": wrong and not said, "called_good": good, "undecidable": undecidable,
        "hurt": bool(outcome.refused or lost or said), "lost": lost, "said": said,
        "currents_wrong": wrong and not outcome.turned_deg <= max(cruises.MARGIN_DEG, cruises.TIMES * before.rms_deg),
        "untouched": {key: getattr(before, key) for key in ("rms_deg", "covered", "good", "verdict")},
    } | asdict(outcome)  # fmt: skip
