"""Steps of a proof: sealing, drawing, running, scoring and writing."""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.proof import bounds, card, figures, measure, run, score, standing, tally
from benchmarks.proof.world import draw, records


def said(asked: argparse.Namespace) -> dict[str, Any]:
    """Compose the metadata published with the hash of the truth: seed and its origin, counts, hashes of code."""
    families, by_hand = standing.families(), asked.seed is not None
    if not by_hand:
        standing.check_out(asked.frozen)
    known = () if asked.second else records.described(asked.data, asked.records)
    there = {one.name: one.stands_in for one in known if one.there}
    real = (asked.count // 2 if asked.real is None else asked.real) if there else 0
    return {
        "seed": asked.seed if by_hand else standing.seed(asked.frozen),
        "seed_of": "chosen by hand" if by_hand else f"commit {standing.commit(asked.frozen)} and the sealed families",
        "count": asked.count, "real": real, "hours": asked.hours, "records": there,
        "second": asked.second, "families": families, "commit": standing.commit(),
        **({"kind": asked.kind} if asked.kind else {}),
    }  # fmt: skip


def make(asked: argparse.Namespace, publish: dict[str, Any], work: Path) -> list[str]:
    """Simulate all moorings, publish the hash of the truth, and return their names.

    Raises:
        standing.Broken: if the folder contains another proof, or its truth was changed.
    """
    work.mkdir(parents=True, exist_ok=True)
    begun, published = work / "begun.json", asked.out / "seal.json"
    if begun.exists() and json.loads(begun.read_text()) != publish:
        raise standing.Broken(f"{work} holds another proof: delete it, or name another --work")
    begun.write_text(json.dumps(publish, indent=1) + "\n")
    (work / "locked").mkdir(exist_ok=True)
    drawn = draw.draw(publish["seed"], (publish["count"], publish["real"]), publish["hours"], publish["records"],
                      second=publish["second"], kind=publish.get("kind"))  # fmt: skip
    if not published.exists() or not (work / "sealed").exists():
        wanted = [one.name for one in drawn if not (work / "locked" / f"{one.name}.json").exists()]
        run.each(partial(_make, {one.name: one for one in drawn}, work, asked.data, asked.records), wanted, asked.cores,
                 "draw")  # fmt: skip
        standing.publish(published, work / "locked", (work / "locked").iterdir(), **publish)
        (work / "sealed").touch()
    standing.check(published, work / "locked", standing.TRUTH_CHANGED)
    return [one.name for one in drawn]


def _make(drawn: dict[str, draw.Drawn], work: Path, data: Path, own: Path | None, name: str) -> str:
    draw.write(drawn[name], work / "cruises" / name, work / "locked", data, own)
    return ""


def correct(work: Path, name: str) -> str:
    """Run the pipeline on one mooring."""
    return run.process(work / "cruises" / name, name, work / "results" / name)


def left(folder: Path) -> list[Path]:
    """List the existing result files of a mooring that are scored."""
    return [folder / file for file in (*run.SCORED, "stopped.txt") if (folder / file).exists()]


def write(out: Path, work: Path) -> dict[str, Any]:
    """Check all hashes, unseal the truth, score, and write the scorecard.

    Raises:
        standing.Broken: if truth or results were changed.
    """
    locked, results = work / "locked", work / "results"
    standing.check(out / "seal.json", locked, standing.TRUTH_CHANGED)
    standing.check(out / "left.json", work, standing.RESULTS_CHANGED)
    truths = {path.stem: json.loads(path.read_text()) for path in sorted(locked.glob("*.json"))}
    diagnoses = {name: measure.diagnosis(results / name) for name in truths}
    rows = [
        score.row(name, truth, diagnoses[name], _heads(locked, results / name, name)) for name, truth in truths.items()
    ]
    sealed = json.loads((out / "seal.json").read_text())
    scored, stated = tally.points(truths, diagnoses), tally.probabilities(rows)
    goals = tally.goals(rows, scored, stated)
    made = {
        "seal": {key: value for key, value in sealed.items() if key != "files"},
        "goals": [{"what": g.what, "value": g.value, "target": g.target, "missed": not g.held} for g in goals],
        "points": scored,
        "measures": tally.measures(rows),
        "probabilities": stated,
        "headings": tally.headings(rows),
        "power": tally.power(rows),
        "moorings": rows,
    }
    figures.write(out / "figures", made)
    card.write(out, made)
    return made


def _heads(locked: Path, results: Path, name: str) -> dict[str, Any]:
    if not (results / "deviation.json").exists():
        return dict.fromkeys([*(f"{key}_deg" for key in ("recorded", "before", "after", "published", "sampled")),
                              "share_corrected", "covered_95"])  # fmt: skip
    deviation = json.loads((results / "deviation.json").read_text())["fitted"]
    heads: dict[str, Any] = dict(measure.headings(results, locked, name, deviation))
    return heads | bounds.errors_deg(results, locked, name, deviation)
