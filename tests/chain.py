"""The chain of a cruise without Snakemake: the jobs' own scripts, one after the other in this process."""

from __future__ import annotations

import contextlib
import io
import os
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from compasslib import archive, config, stages
from compasslib.errors import InputError

SCRIPTS = Path(__file__).resolve().parents[1] / "workflow/scripts"


class Named(SimpleNamespace):
    """Values by name, as Snakemake gives wildcards and params."""

    def items(self):
        return vars(self).items()


class Files(list):
    """Files as Snakemake gives them: by number and by name; a list of files by its name stays one."""

    def __init__(self, *plain: str, **named: Any):
        lists = [value if isinstance(value, list) else [value] for value in named.values()]
        super().__init__([*plain, *(file for some in lists for file in some)])
        vars(self).update(named)


def run(folder: Path, name: str = "M1", *, diagnose: bool = False) -> dict[str, Any]:
    """Return what the chain says of a mooring: its row of the summary, its files, or ``error``, the one line.

    Args:
        folder: the cruise.
        name: the mooring.
        diagnose: whether left-out physics is searched for; it costs most of the time.
    """
    there = os.getcwd()
    try:
        os.chdir(folder)
        plan = stages.plan(config.load(folder), SCRIPTS)
        _jobs(plan, name, diagnose)
        return _told(folder / "results" / name) | {"error": None}
    except InputError as error:
        return {"error": f"error: {error}"}
    except _Stopped as stopped:
        return {"error": str(stopped)}
    finally:
        os.chdir(there)


class _Stopped(Exception):
    """A job that ended with its one line."""


def _jobs(plan: stages.Plan, name: str, diagnose: bool) -> None:
    out = f"results/{name}"
    for folder in ("work", "wide"):
        Path(out, folder).mkdir(parents=True, exist_ok=True)
    mooring = plan.cruise.moorings[name]
    for role in dict.fromkeys(r for r in (mooring.compromised, mooring.reference) if r):
        at = Named(mooring=name, role=role)
        params = {
            "form": plan.form(at),
            "reader": plan.reader_settings(at),
            "deployment": plan.deployment(at),
        }
        _job("read", at, Files(raw=plan.raw_files(at)), Files(f"{out}/work/{role}.nc"), **params)
    at = Named(mooring=name)
    field, pairs, wide = f"{out}/work/field.json", f"{out}/overlap.nc", f"{out}/wide/overlap.nc"
    upper = plan.compromised(at)
    given, made = Files(upper=upper, lower=plan.reference(at)), Files(field=field, pairs=pairs, wide=wide)
    settings = {"place": plan.place_and_declination(at), "rules": plan.cruise.options.overlap.model_dump()}
    _job("overlap", at, given, made, **settings)
    fit = f"{out}/work/fit.json"
    given = Files(record=upper, pairs=pairs, field=field)
    _job("fit", at, given, Files(fit), method=plan.method(at), tilt=plan.tilt(at))
    given = Files(**vars(given) | {"wide": wide, "fit": fit, "observatory": plan.observatory(at)})
    found, deviation = f"{out}/diagnosis.json", f"{out}/deviation.json"
    options = plan.diagnose(at) | ({} if diagnose else {"enabled": False})
    _job("diagnose", at, given, Files(diagnosis=found, deviation=deviation), options=options)
    given = Files(**vars(given) | {"deviation": deviation})
    assessment = f"{out}/assessment.json"
    _job("assess", at, given, Files(assessment))
    given = Files(**vars(given) | {"assessment": assessment})
    settings = {"site": plan.site(at), "attributes": plan.attributes(at), "sources": plan.all_raw_files(at)}
    _job("correct", at, given, Files(f"{out}/corrected.nc"), **settings)


def _job(script: str, wildcards: Any, given: Files, output: Files, **params: Any) -> None:
    log = Path("results/job.log")
    asked = SimpleNamespace(
        rule=script, input=given, output=output, params=Named(**params), log=[str(log)], wildcards=wildcards
    )
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            runpy.run_path(str(SCRIPTS / f"{script}.py"), init_globals={"snakemake": asked})
    except SystemExit:
        raise _Stopped(log.read_text().strip().splitlines()[-1]) from None


def _told(results: Path) -> dict[str, Any]:
    from compasslib import summary

    records = {path.stem: archive.read_record(path) for path in sorted((results / "work").glob("*.nc"))}
    return {
        **summary.row(results.name, results),
        "records": records,
        "counts": {role: record.counts for role, record in records.items()},
        "product": archive.read_corrected(results / "corrected.nc"),
        "fit": archive.read_json(results / "deviation.json"),
        "diagnosis": archive.read_json(results / "diagnosis.json"),
    }
