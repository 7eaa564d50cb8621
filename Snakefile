"""From raw exports to a corrected archive: one rule a stage, any cruise folder by --directory."""

import sys
from pathlib import Path

from snakemake.logging import logger

sys.path.insert(0, str(workflow.current_basedir))  # before a folder of the same name where this is started

from compasslib.archive import provenance
from compasslib.calibrations import KINDS
from compasslib.config.cruise import load
from compasslib.errors import InputError
from compasslib.pipeline import guard, plan, running
from compasslib.pipeline.plan import FIGURES

try:
    guard.refuse_config(config)
    guard.enter(Path.cwd(), Path(workflow.current_basedir))
    CRUISE = load(Path.cwd())
    PLAN = plan.plan(CRUISE, Path(workflow.current_basedir) / "workflow/scripts")
    MOORINGS, CALIBRATIONS, COMPASSES = PLAN.moorings, PLAN.calibrations, PLAN.compasses
    SIMULATED = running.prepare(workflow, PLAN)
except InputError as error:
    logger.error(f"error: {error}")
    sys.exit(1)


wildcard_constraints:
    mooring=plan.only(CRUISE.moorings),
    calibration=plan.only(CRUISE.calibrations),
    compass=plan.only(COMPASSES.members),
    role="[A-Za-z0-9_.-]+",


onstart:
    # The limit of 100 jobs a second sets a timer at every turn, so that Snakemake wakes ever oftener: 4 s of CPU a
    # cruise. On a cluster it stays, and may be lowered.
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None


rule all:
    input:
        PLAN.everything,


rule read:
    """Raw export -> the instrument's record inside the deployment."""
    input:
        MOORINGS.companion_files,  # the reader is given them by its settings
        raw=MOORINGS.raw_files,
    output:
        record="results/{mooring}/work/{role}.nc",
    params:
        form=MOORINGS.form,
        reader=MOORINGS.reader_settings,
        deployment=MOORINGS.deployment,
        series=MOORINGS.series,
        code=MOORINGS.reader_code,
    log:
        "results/{mooring}/logs/read_{role}.log",
    benchmark:
        "results/{mooring}/benchmarks/read_{role}.tsv"
    script:
        "workflow/scripts/read.py"


rule overlap:
    """Two records, position and dates -> the earth's field, and pairs that measured nearly the same water."""
    input:
        upper=MOORINGS.compromised,
        lower=MOORINGS.reference,
        observatory=MOORINGS.observatory,
    output:
        field="results/{mooring}/work/field.json",
        pairs="results/{mooring}/overlap.nc",
        wide="results/{mooring}/wide/overlap.nc",
    params:
        place=MOORINGS.place_and_declination,
        rules=MOORINGS.pairing_rules,
        code=MOORINGS.code("overlap.py"),
    log:
        "results/{mooring}/logs/overlap.log",
    benchmark:
        "results/{mooring}/benchmarks/overlap.tsv"
    script:
        "workflow/scripts/overlap.py"


rule fit:
    """Pairs -> the deviation model."""
    input:
        record=MOORINGS.compromised,
        pairs="results/{mooring}/overlap.nc",
        field="results/{mooring}/work/field.json",
    output:
        fit="results/{mooring}/work/fit.json",
    params:
        method=MOORINGS.method,
        tilt=MOORINGS.tilt,
        code=MOORINGS.code("fit.py"),
    wildcard_constraints:
        mooring=plan.only(MOORINGS.by_pairs()),
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    script:
        "workflow/scripts/fit.py"


rule diagnose:
    """Pairs and fit -> what physics the fit leaves out, the compass that corrects the record, and how well it does."""
    input:
        record=MOORINGS.compromised,
        references=MOORINGS.reference,
        pairs="results/{mooring}/overlap.nc",
        wide="results/{mooring}/wide/overlap.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=MOORINGS.observatory,
    output:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
        assessment="results/{mooring}/assessment.json",
    params:
        options=MOORINGS.diagnose,
        code=MOORINGS.code("diagnose.py"),
    wildcard_constraints:
        mooring=plan.only(COMPASSES.others),
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    script:
        "workflow/scripts/diagnose.py"


rule correct:
    """Record and deviation -> corrected headings and velocities in the archive's form."""
    input:
        record=MOORINGS.compromised,
        pairs="results/{mooring}/overlap.nc",
        deviation="results/{mooring}/deviation.json",
        field="results/{mooring}/work/field.json",
        observatory=MOORINGS.observatory,
    output:
        corrected="results/{mooring}/corrected.nc",
    params:
        site=MOORINGS.site,
        attributes=MOORINGS.attributes,
        sources=MOORINGS.all_raw_files,
        code=MOORINGS.code("correct.py"),
    log:
        "results/{mooring}/logs/correct.log",
    benchmark:
        "results/{mooring}/benchmarks/correct.tsv"
    script:
        "workflow/scripts/correct.py"


rule compare:
    """Pairs -> which form of the curve predicts held-out ones best; no other stage waits for it."""
    input:
        pairs="results/{mooring}/overlap.nc",
        deviation="results/{mooring}/deviation.json",
    output:
        forms="results/{mooring}/forms.json",
    priority: -1  # it fills the cores that others leave
    params:
        code=MOORINGS.code("compare.py"),
    log:
        "results/{mooring}/logs/compare.log",
    benchmark:
        "results/{mooring}/benchmarks/compare.tsv"
    script:
        "workflow/scripts/compare.py"


rule figures:
    """The equivalents of von Appen's Figs 6 to 9, and the record along time; small ones for the page."""
    input:
        pairs="results/{mooring}/overlap.nc",
        deviation="results/{mooring}/deviation.json",
        diagnosis="results/{mooring}/diagnosis.json",
        product="results/{mooring}/corrected.nc",
    output:
        figures=[
            report(
                f"results/{{mooring}}/figures/{figure}.png",
                caption=f"workflow/report/{figure}.rst",
                category="Moorings",
                subcategory="{mooring}",
                labels={"figure": figure},
            )
            for figure in FIGURES
        ],
        pictures="results/{mooring}/work/pictures.json",
    params:
        code=MOORINGS.code("figures.py"),
    log:
        "results/{mooring}/logs/figures.log",
    benchmark:
        "results/{mooring}/benchmarks/figures.tsv"
    script:
        "workflow/scripts/figures.py"


rule summary:
    """One row a mooring."""
    input:
        PLAN.of("deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "work/field.json", "overlap.nc"),
        PLAN.records,
    output:
        summary=report("results/summary.csv", caption="workflow/report/summary.rst", category="Cruise"),
    params:
        roles=PLAN.roles,
        order=list(CRUISE.moorings),
        stopped=PLAN.reasons,
        code=MOORINGS.code("summary.py"),
    log:
        "results/logs/summary.log",
    benchmark:
        "results/benchmarks/summary.tsv"
    script:
        "workflow/scripts/summary.py"


rule report:
    """All results on one page that needs no network."""
    input:
        PLAN.table,
        PLAN.of(*(f"figures/{figure}.png" for figure in FIGURES), "work/pictures.json"),
        PLAN.calibrated,
        COMPASSES.shown,
        MOORINGS.templates(),
    output:
        page="results/report.html",
    params:
        attributes=CRUISE.options.attributes,
        moorings=PLAN.described,
        calibrations=PLAN.calibration_names,
        compasses=COMPASSES.listed,
        stopped=PLAN.reasons,
        code=MOORINGS.code("report.py"),
    log:
        "results/logs/report.log",
    benchmark:
        "results/benchmarks/report.tsv"
    script:
        "workflow/scripts/report.py"


include: "workflow/rules/calibrations.smk"
include: "workflow/rules/compasses.smk"
include: "workflow/rules/provenance.smk"


if CRUISE.options.demonstration:

    include: "workflow/rules/demonstration.smk"
