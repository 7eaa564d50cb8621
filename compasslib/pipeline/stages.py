"""Table of the stages: the function of each, the files that it reads and writes, and its settings.

The argument ``plan`` is a ``plan.Plan``; it is typed ``Any`` because that module imports this one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from compasslib.archive import provenance
from compasslib.pipeline import records
from compasslib.pipeline.settings import hash_code, list_figures, used_instruments

OF_CRUISE = ("array", "curves", "differences", "currents")
JUDGED = ("diagnosis", "deviation", "assessment")
ALONE = (*JUDGED, "summary")  # for moorings that share their compass with other records
CRUISE, MOORING = "results", "results/{mooring}"
CALIBRATION, COMPASS = "results/calibrations/{calibration}", "results/compasses/{compass}"

Given = Callable[[Any], Any]
Files = Mapping[str, "str | tuple[str, ...] | Given"]


@dataclass(frozen=True)
class Stage:
    """A stage: files and settings by argument of its function; files that are no arguments are only waited for.

    Args:
        function: ``module.name`` below ``compasslib.stages``.
        folder: folder of its results, with wildcards.
        label: name of its log, record and benchmark in that folder.
        code: function that returns one hash of the modules behind the stage.
        reads: files below ``folder``, or functions that return their paths in the cruise.
        writes: likewise.
        settings: functions that return the remaining arguments.
    """

    function: str
    folder: str
    label: str
    code: Given
    reads: Files = field(default_factory=dict)
    writes: Files = field(default_factory=dict)
    settings: Mapping[str, Given] = field(default_factory=dict)


def of_moorings(plan: Any) -> dict[str, Stage]:
    """Return the stages of a mooring by name of rule."""
    of, pairs, field_, fit = plan.moorings, "overlap.nc", "work/field.json", "work/fit.json"
    judging = {
        "record": of.compromised,
        "references": of.reference,
        "pairs": pairs,
        "wide": "wide/overlap.nc",
        "fit": fit,
        "field": field_,
        "observatory": of.observatory,
    }
    judged = {name: f"{name}.json" for name in JUDGED} | {"assessment": "work/agreement.json"}
    tables = {"table": "table.csv", "histograms": "histograms.csv"}
    options = {"options": of.diagnose, "sphere_distance_m": of.sphere_distance_m}
    checked = provenance.installed("compliance-checker")
    archived = {"site": of.site, "attributes": of.attributes, "sources": of.all_raw_files, "superseded": of.superseded}

    def stage(rule: str, function: str, label: str = "", code: Given | None = None, **parts: Any) -> Stage:
        return Stage(function, MOORING, label or rule, code or plan.code(rule), **parts)

    return {
        "read": stage(
            *("read", "read.read", "read_{role}"),
            code=lambda wildcards: of.reader_code(wildcards, plan.scripts),
            reads={"companions": of.companion_files, "raw": of.raw_files},
            writes={"record": "work/{role}.nc"},
            settings={"form": of.form, "reader": of.reader_settings, "deployment": of.deployment, "series": of.series},
        ),
        "overlap": stage(
            *("overlap", "overlap.overlap"),
            reads={
                "upper": of.compromised,
                "lower": of.reference,
                "observatory": of.observatory,
                "ready": of.ready_pairs,
            },
            writes={"field": field_, "pairs": pairs, "wide": "wide/overlap.nc"},
            settings={
                "place": of.place_and_declination,
                "rules": of.pairing_rules,
                "columns": of.pair_columns,
                "compasses": of.reference_compasses,
            },
        ),
        "fit": stage(
            *("fit", "fit.fit"),
            reads={"record": of.compromised, "pairs": pairs, "field": field_},
            writes={"fit": fit},
            settings={"method": of.method, "tilt": of.tilt, "given": of.given_compass, "sphere": of.sphere},
        ),
        "carry": stage(
            *("carry", "fit.carry", "fit"),
            reads={"calibrations": of.calibrations, "record": of.compromised, "pairs": pairs, "field": field_},
            writes={"fit": fit},
            settings={"parts": of.parts, "sphere": of.sphere},
        ),
        "diagnose": stage(*("diagnose", "diagnose.diagnose"), reads=judging, writes=judged, settings=options),
        "diagnose_alone": stage(
            *("diagnose_alone", "diagnose.diagnose"),
            code=plan.code("diagnose"),
            reads=judging,
            writes={name: f"work/alone/{name}.json" for name in ALONE},
            settings=options,
        ),
        "share": stage(
            *("share", "diagnose.share", "diagnose"),
            reads={"joined": plan.compasses.joined, "alone": tuple(f"work/alone/{n}.json" for n in JUDGED)} | judging,
            writes=judged,
            settings=options | {"tilt": of.tilt},
        ),
        "correct": stage(
            *("correct", "correct.correct"),
            reads={name: judging[name] for name in ("record", "pairs", "field", "observatory")}
            | {"deviation": judged["deviation"], "diagnosis": judged["diagnosis"], "agreement": judged["assessment"]},
            writes={"corrected": "corrected.nc", "assessment": "assessment.json"} | tables,
            settings=archived,
        ),
        "grid": stage(
            *("grid", "grid.grid"),
            reads={
                "corrected": of.of_members("corrected.nc"),
                "records": of.affected,
                "references": of.reference,
                "pairs": of.of_members(pairs),
                "deviations": of.of_members("deviation.json"),
                "assessments": of.of_members("assessment.json"),
                "fields": of.of_members(field_),
                "observatory": of.observatory,
            },
            writes={"gridded": of.gridded},
            settings={"options": of.product, "compasses": of.reference_compasses, "rotors": of.rotors} | archived,
        ),
        "compare": stage(
            *("compare", "correct.compare"),
            reads={"pairs": pairs, "deviation": "deviation.json"},
            writes={"forms": "forms.json"},
        ),
        "figures": stage(
            *("figures", "figures.figures"),
            reads={name: f"{name}.json" for name in JUDGED}
            | {"pairs": pairs, "histograms": "histograms.csv", "product": "corrected.nc", "gridded": of.gridded},
            writes={"figures": of.figures, "pictures": "work/pictures.json"},
        ),
        "sections": stage(
            *("sections", "figures.sections"),
            reads={"gridded": of.gridded},
            writes={"figures": of.figures, "pictures": "work/pictures.json"},
        ),
        "check_conventions": stage(
            *("conventions", "cruise.conventions"),
            code=plan.code("conventions", checked),
            reads={"products": of.archived, "gridded": of.gridded, "records": of.records},
            writes={"conventions": "conventions.json"},
        ),
    }


def of_calibrations(plan: Any) -> dict[str, Stage]:
    """Return the stages of a calibration by name of rule."""
    of = plan.calibrations
    made = {"calibration": "calibration.json", "table": "table.csv", "points": "points.csv"}

    def code(rule: str, module: Callable[[Any], list[str]]) -> Given:
        return lambda wildcards: hash_code(provenance.sources(plan.scripts / f"{rule}.py", *module(wildcards)))

    return {
        "calibrate": Stage(
            *("calibrate.calibrate", CALIBRATION, "calibrate"),
            code("calibrate", of.module),
            reads={"raw": of.raw_files, "earlier": of.earlier},
            writes=made,
            settings={"kind": of.kind, "settings": of.settings},
        ),
        "diagnose_calibration": Stage(
            *("diagnose.diagnose_calibration", CALIBRATION, "diagnose"),
            code("diagnose_calibration", of.diagnosis_module),
            # Waits for the calibration, so that an unreadable file is reported once.
            reads={"calibration": "calibration.json", "raw": of.raw_files},
            writes={"diagnosis": "diagnosis.json"},
            settings={"kind": of.kind, "settings": of.settings, "options": of.diagnose},
        ),
        "diagnosis_figure": Stage(
            *("figures.diagnosis_figure", CALIBRATION, "diagnosis_figure"),
            plan.code("diagnosis_figure"),
            reads={"diagnosis": "diagnosis.json"},
            writes={"figures": of.diagnosis_figures},
        ),
        "calibration_figures": Stage(
            *("figures.calibration_figures", CALIBRATION, "figures"),
            plan.code("calibration_figures"),
            reads=made,
            writes={"figures": of.figures},
        ),
    }


def of_compasses(plan: Any) -> dict[str, Stage]:
    """Return the stages of a compass that several records share by name of rule."""
    of = plan.compasses
    return {
        "join": Stage(
            *("diagnose.join", COMPASS, "join"),
            plan.code("join"),
            reads={"summaries": of.summaries, "calibrations": of.calibrations},
            writes={"joined": "compass.json", "diagnosis": "diagnosis.json"},
            settings={"spheres": of.spheres, "min_effect_deg": of.min_effect_deg},
        ),
        "joined_figures": Stage(
            *("figures.joined_figures", COMPASS, "figures"),
            plan.code("joined_figures"),
            reads={"joined": "compass.json"},
            writes={"figures": of.figures},
        ),
    }


def of_cruise(plan: Any) -> dict[str, Stage]:
    """Return the stages of the whole cruise by name of rule."""
    cruise, of = plan.cruise, plan.moorings
    summarized = ("deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "work/field.json")
    configuration = of.configuration()
    files = {"summary": [*plan.per_mooring(*summarized, "overlap.nc"), *plan.records_of_instruments()]}
    files["report"] = [*plan.table(), *plan.pictures(), *plan.per_mooring("work/pictures.json")]
    files["report"] += [*plan.pictures_of_cruise(), *plan.calibrated(), *plan.joined()]
    templates = provenance.digest(of.templates())
    return {
        "summary": Stage(
            *("cruise.summary", CRUISE, "summary"),
            plan.code("summary"),
            reads={"files": lambda wildcards: files["summary"]},
            writes={"summary": "summary.csv"},
            settings={"roles": lambda wildcards: {name: used_instruments(m) for name, m in cruise.moorings.items()}},
        ),
        "cruise_figures": Stage(
            *("figures.cruise_figures", CRUISE, "cruise_figures"),
            plan.code("cruise_figures"),
            reads={
                "deviations": lambda wildcards: plan.per_mooring("deviation.json"),
                "assessments": lambda wildcards: plan.per_mooring("assessment.json"),
            },
            writes={"figures": lambda wildcards: list_figures(cruise, CRUISE, OF_CRUISE)},
            settings={"array": lambda wildcards: of.array()},
        ),
        "report": Stage(
            *("report.report", CRUISE, "report"),
            plan.code("report", templates),
            reads={"files": lambda wildcards: files["report"]},
            writes={"page": "report.html"},
            settings={
                "attributes": lambda wildcards: cruise.options.attributes,
                "moorings": lambda wildcards: of.described(),
                "calibrations": lambda wildcards: list(cruise.calibrations),
                "compasses": lambda wildcards: list(plan.compasses.members),
            },
        ),
        "provenance": Stage(
            *("cruise.provenance", CRUISE, "provenance"),
            plan.code("provenance"),
            reads={
                "settings": lambda wildcards: sorted({file for group in configuration.values() for file in group}),
                "products": lambda wildcards: plan.products(),
            },
            writes={"manifest": "ro-crate-metadata.json"},
            settings={
                "configuration": lambda wildcards: configuration,
                "attributes": lambda wildcards: cruise.options.attributes,
            },
        ),
        "concealed": Stage(
            *("concealed.concealed", CRUISE, "concealed"),
            plan.code("concealed", templates),
            reads={
                "truths": lambda wildcards: [records.truth_file(name) for name in plan.concealed],
                "corrected": lambda wildcards: [f"{CRUISE}/{name}/corrected.nc" for name in plan.concealed],
                "others": lambda wildcards: [
                    f"{CRUISE}/{name}/{file}"
                    for name in plan.concealed
                    for file in ("deviation.json", "diagnosis.json", "overlap.nc", "work/pictures.json")
                ],
            },
            writes={"page": "concealed.html"},
        ),
        "complete": Stage(
            *("cruise.complete", CRUISE, "complete"),
            plan.code("complete"),
            settings={"folders": lambda wildcards: plan.folders()},
        ),
    }
