"""Stages of the whole cruise: what can go on, summary, pages, manifest, and checks of the archive."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from compasslib import report as html
from compasslib.archive import crate
from compasslib.archive import summary as table
from compasslib.archive.files import read_json, read_reason, write_json
from compasslib.errors import Stopped
from compasslib.report import explore
from compasslib.stages import Files, Say, Settings

CALIBRATIONS = "results/calibrations"
FOLLOWS = "it needs calibration"
Reason = dict[str, Any]  # stage, why, file, advice


def usable(
    files: Files, say: Say, *, needed: Mapping[str, Sequence[str]],
    shared: Mapping[str, tuple[Sequence[str], Sequence[str]]], without: Mapping[str, Sequence[str]],
) -> None:  # fmt: skip
    """Write which moorings, calibrations and compasses can go on, and ``stopped.json`` in place of others' products.

    The files are work/field.json of each mooring and work/calibration.json of each calibration that are not left out,
    possibly with a reason in place of the data. Those ``without`` were left out by request.

    Args:
        needed: calibrations that each mooring needs.
        shared: moorings and calibrations of each compass.
    """
    known = {Path(path).parents[1].name: read_reason(path) for path in files.calibrations}
    reasons = {Path(path).parents[1].relative_to("results").as_posix(): read_reason(path) for path in files.moorings}
    for whys, names in ((known, without["calibrations"]), (reasons, without["moorings"])):
        for name in names:
            text = f"{name} was left out of this run (--config without={name})"
            whys[name] = {"stage": "usable", "why": text, "file": None, "advice": "run again without that option"}
    for name, others in needed.items():
        stops = [(other, why) for other in others if (why := known[other])]
        follows = [why | {"why": f"{FOLLOWS} {other}, which was stopped: {why['why']}"} for other, why in stops]
        reasons[name] = reasons[name] or next(iter(follows), None)
    # A compass, and a mooring of several affected instruments, are stopped only if all of their records are.
    members = {name: [*map(reasons.get, of), *map(known.get, checks)] for name, (of, checks) in shared.items()}
    compasses = {name: whys[0] if all(whys) else None for name, whys in members.items()}
    parts: dict[str, list[Reason | None]] = {}
    for name, why in reasons.items():
        parts.setdefault(name.partition("/")[0], []).append(why)
    of_folder = {f"results/{name}": whys[0] if all(whys) else None for name, whys in parts.items()}
    of_folder |= {f"results/{name}": why for name, why in reasons.items()}
    of_folder |= {f"{CALIBRATIONS}/{name}": why for name, why in known.items()}
    of_folder |= {f"results/compasses/{name}": why for name, why in compasses.items() if why}
    for folder, why in of_folder.items():
        if why is None:
            Path(folder, "stopped.json").unlink(missing_ok=True)
            continue
        for path in (*Path(folder).glob("*"), *Path(folder).glob("figures/*")):
            if path.is_file() or path.is_symlink():
                path.unlink()
        write_json(Path(folder, "stopped.json"), why)
    write_json(files.usable, {"moorings": reasons, "calibrations": known, "compasses": compasses})
    every = [*reasons.values(), *known.values()]
    say(f"{len(every)} moorings and calibrations, {sum(map(bool, every))} stopped")


def read_stopped(usable: str) -> dict[str, dict[str, str]]:
    """Read the reasons of what cannot go on, by kind and name."""
    return {kind: {name: why["why"] for name, why in each.items() if why} for kind, each in read_json(usable).items()}


def summary(files: Files, say: Say, *, roles: Mapping[str, Sequence[str]]) -> None:
    """Write summary.csv, one row for each mooring, processed or stopped, in the order of ``roles``."""
    results, why = Path(files.summary).parent, read_stopped(files.usable)["moorings"]
    rows = [
        table.stopped_row(name, why[name]) if name in why else table.summary_row(name, results / name, used)
        for name, used in roles.items()
    ]
    table.write_summary(files.summary, rows)
    say(table.format_table(rows))
    say(f"{files.summary}: {len(rows)} mooring{'s' * (len(rows) != 1)}")


def report(
    files: Files, say: Say, *, attributes: Settings, moorings: Mapping[str, Settings], calibrations: Sequence[str],
    compasses: Sequence[str],
) -> None:  # fmt: skip
    """Write two ``pages`` into the folder of the results: all results, and the series of the moorings to look at."""
    (page, series), stopped = files.pages, read_stopped(files.usable)
    content = html.gather(
        Path(page).parent,
        attributes=attributes,
        moorings=moorings,
        calibrations=[name for name in calibrations if name not in stopped["calibrations"]],
        compasses=[name for name in compasses if name not in stopped["compasses"]],
        stopped=stopped,
    )
    html.write(page, content)
    title = html.title("Series of the moorings", attributes.get("project"))
    explore.write(series, title, [name for name in moorings if name not in stopped["moorings"]])
    say(html.log_line(page, content))


def provenance(files: Files, say: Say, *, configuration: Mapping[str, Sequence[str]], attributes: Settings) -> None:
    """Write the manifest, a crate of all ``jobs``, given by their records; for the rest see ``crate.crate``.

    Raises:
        InputError: a job read a result that is not as its job wrote it.
    """
    jobs, stopped = crate.read_jobs(files.jobs), _named(read_stopped(files.usable))
    page = crate.crate(jobs, configuration=configuration, attributes=attributes, stopped=stopped)
    write_json(files.manifest, page)
    say(f"{files.manifest}: {len(crate.listed(page))} files, {len(jobs)} jobs")


def complete(files: Files, say: Say) -> None:
    """End the run: report what was stopped.

    Intermediate files of what was stopped are dated 1970: the next run then compares raw files with those that were
    read by content, and finds a mended file whatever its date, which is an old one if it comes from a copy.

    Raises:
        Stopped: a mooring or calibration was stopped and has no results.
    """
    stopped = read_stopped(files.usable)
    folders = [f"results/{name}" for name in stopped["moorings"]]
    folders += [f"{CALIBRATIONS}/{name}" for name in stopped["calibrations"]]
    for path in (path for folder in folders for path in Path(folder).glob("work/**/*.*")):
        with suppress(OSError):  # another user's file
            os.utime(path, (1, 1))  # for Snakemake 0 is no date
    lines = [f"{of}: {why}" for of, why in _named(stopped).items()]
    if lines:
        raise Stopped(*(line for line in lines if FOLLOWS not in line))
    say("nothing was stopped")


def _named(stopped: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the reasons by kind and name, such as "mooring EG4", the keys of the configuration."""
    kinds = ("mooring", "calibration")
    return {f"{kind} {name}": why for kind in kinds for name, why in stopped[f"{kind}s"].items()}
