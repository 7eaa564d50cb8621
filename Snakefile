"""From raw exports to a corrected archive: one rule a stage, any cruise folder by --directory."""

import sys
from pathlib import Path

from snakemake.logging import logger

sys.path.insert(0, str(workflow.basedir))  # before a folder of the same name where this is started

from compasslib.archive import provenance
from compasslib.calibration import KINDS
from compasslib.config.cruise import load
from compasslib.core.errors import InputError
from compasslib.run import calibrations, guard, plan, running
from compasslib.run.plan import FIGURES
from compasslib.run.whole import Whole

try:
    guard.enter(Path.cwd(), Path(workflow.basedir))
    CRUISE = load(Path.cwd())
    PLAN = plan.plan(CRUISE, Path(workflow.basedir) / "workflow/scripts")
    CALIBRATIONS = calibrations.plan(CRUISE, PLAN.scripts)
    WHOLE = Whole(PLAN, CALIBRATIONS)
    SIMULATED = running.prepare(workflow, WHOLE)
except InputError as error:
    logger.error(f"error: {error}")
    sys.exit(1)

ENVIRONMENT = "workflow/envs/compasslib.yaml"


wildcard_constraints:
    mooring=plan.only(CRUISE.moorings),
    calibration=plan.only(CRUISE.calibrations),
    role="[A-Za-z0-9_.-]+",


onstart:
    # The limit of 100 jobs a second sets a timer at every turn, so that Snakemake wakes ever oftener: 4 s of CPU a
    # cruise. On a cluster it stays, and may be lowered.
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None


rule all:
    input:
        WHOLE.everything,


rule read:
    """Raw export -> the instrument's record inside the deployment."""
    input:
        PLAN.companion_files,  # the reader is given them by its settings
        raw=PLAN.raw_files,
    output:
        record="results/{mooring}/work/{role}.nc",
    params:
        form=PLAN.form,
        reader=PLAN.reader_settings,
        deployment=PLAN.deployment,
        code=plan.hashed(PLAN.reader_modules),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/read_{role}.log",
    benchmark:
        "results/{mooring}/benchmarks/read_{role}.tsv"
    script:
        "workflow/scripts/read.py"


rule overlap:
    """Two records, position and dates -> the earth's field, and pairs that measured nearly the same water."""
    input:
        upper=PLAN.compromised,
        lower=PLAN.reference,
        observatory=PLAN.observatory,
    output:
        field="results/{mooring}/work/field.json",
        pairs="results/{mooring}/overlap.nc",
        wide="results/{mooring}/wide/overlap.nc",
    params:
        place=PLAN.place_and_declination,
        rules=CRUISE.options.overlap.model_dump(),
        code=PLAN.code("overlap.py"),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/overlap.log",
    benchmark:
        "results/{mooring}/benchmarks/overlap.tsv"
    script:
        "workflow/scripts/overlap.py"


rule fit:
    """Pairs -> the deviation model."""
    input:
        record=PLAN.compromised,
        pairs="results/{mooring}/overlap.nc",
        field="results/{mooring}/work/field.json",
    output:
        fit="results/{mooring}/work/fit.json",
    params:
        method=PLAN.method,
        tilt=PLAN.tilt,
        code=PLAN.code("fit.py"),
    wildcard_constraints:
        mooring=plan.only(PLAN.by_pairs()),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    script:
        "workflow/scripts/fit.py"


rule diagnose:
    """Pairs and fit -> what physics the fit leaves out, and the compass that is to correct the record."""
    input:
        record=PLAN.compromised,
        pairs="results/{mooring}/overlap.nc",
        wide="results/{mooring}/wide/overlap.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=PLAN.observatory,
    output:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
    params:
        options=PLAN.diagnose,
        code=PLAN.code("diagnose.py"),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    script:
        "workflow/scripts/diagnose.py"


rule correct:
    """Record and deviation -> corrected headings and velocities in the archive's form."""
    input:
        record=PLAN.compromised,
        pairs="results/{mooring}/overlap.nc",
        deviation="results/{mooring}/deviation.json",
        assessment="results/{mooring}/assessment.json",
        field="results/{mooring}/work/field.json",
        observatory=PLAN.observatory,
    output:
        corrected="results/{mooring}/corrected.nc",
    params:
        site=PLAN.site,
        attributes=PLAN.attributes,
        sources=PLAN.all_raw_files,
        code=PLAN.code("correct.py"),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/correct.log",
    benchmark:
        "results/{mooring}/benchmarks/correct.tsv"
    script:
        "workflow/scripts/correct.py"


rule assess:
    """Pairs -> agreement of the two instruments before and after, on pairs held out from the fit."""
    input:
        record=PLAN.compromised,
        pairs="results/{mooring}/overlap.nc",
        deviation="results/{mooring}/deviation.json",
        field="results/{mooring}/work/field.json",
        observatory=PLAN.observatory,
    output:
        assessment="results/{mooring}/assessment.json",
    params:
        code=PLAN.code("assess.py"),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/assess.log",
    benchmark:
        "results/{mooring}/benchmarks/assess.tsv"
    script:
        "workflow/scripts/assess.py"


rule compare:
    """Pairs -> which form of the curve predicts held-out ones best; no other stage waits for it."""
    input:
        pairs="results/{mooring}/overlap.nc",
        deviation="results/{mooring}/deviation.json",
    output:
        forms="results/{mooring}/forms.json",
    priority: -1  # it fills the cores that others leave
    params:
        code=PLAN.code("compare.py"),
    conda:
        ENVIRONMENT
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
        code=PLAN.code("figures.py"),
    conda:
        ENVIRONMENT
    log:
        "results/{mooring}/logs/figures.log",
    benchmark:
        "results/{mooring}/benchmarks/figures.tsv"
    script:
        "workflow/scripts/figures.py"


rule summary:
    """One row a mooring."""
    input:
        WHOLE.of("deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "work/field.json", "overlap.nc"),
        WHOLE.records,
    output:
        summary=report("results/summary.csv", caption="workflow/report/summary.rst", category="Cruise"),
    params:
        roles=WHOLE.roles,
        order=list(CRUISE.moorings),
        stopped=WHOLE.reasons,
        code=PLAN.code("summary.py"),
    conda:
        ENVIRONMENT
    log:
        "results/logs/summary.log",
    benchmark:
        "results/benchmarks/summary.tsv"
    script:
        "workflow/scripts/summary.py"


rule report:
    """All results on one page that needs no network."""
    input:
        WHOLE.table,
        WHOLE.of(*(f"figures/{figure}.png" for figure in FIGURES), "work/pictures.json"),
        WHOLE.calibrated,
        PLAN.templates(),
    output:
        page="results/report.html",
    params:
        attributes=CRUISE.options.attributes,
        moorings=WHOLE.described,
        calibrations=WHOLE.calibration_names,
        stopped=WHOLE.reasons,
        code=PLAN.code("report.py"),
    conda:
        ENVIRONMENT
    log:
        "results/logs/report.log",
    benchmark:
        "results/benchmarks/report.tsv"
    script:
        "workflow/scripts/report.py"


include: "workflow/rules/calibrations.smk"
include: "workflow/rules/provenance.smk"


if CRUISE.options.demonstration:

    include: "workflow/rules/demonstration.smk"
