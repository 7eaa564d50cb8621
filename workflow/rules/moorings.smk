"""One mooring, from raw files to figures."""


rule read:
    """Read a raw export into the instrument's record inside the deployment, or state why it cannot be read."""
    input:
        raw=lambda wildcards: MOORINGS.raw_files(*wildcards),
        companions=lambda wildcards: MOORINGS.companion_files(*wildcards),
    output:
        record="results/{mooring}/work/{role}.nc",
        job="results/{mooring}/logs/read_{role}.json",
    log:
        "results/{mooring}/logs/read_{role}.log",
    benchmark:
        "results/{mooring}/benchmarks/read_{role}.tsv"
    group:
        lambda wildcards: guard.group("read", wildcards.mooring)
    params:
        **keys(MOORINGS.read, INSTRUMENTS),
    script:
        "../scripts/read.py"


rule overlap:
    """Compute the earth's field, and find pairs of measurements of nearly the same water in the records."""
    input:
        upper=lambda wildcards: MOORINGS.affected(*wildcards),
        lower=lambda wildcards: MOORINGS.references(*wildcards),
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
        ready=lambda wildcards: MOORINGS.ready_pairs(*wildcards),
    output:
        field="results/{mooring}/work/field.json",
        pairs="results/{mooring}/work/pairs/overlap.nc",
        wide="results/{mooring}/work/pairs/wide.nc",
        job="results/{mooring}/logs/overlap.json",
    log:
        "results/{mooring}/logs/overlap.log",
    benchmark:
        "results/{mooring}/benchmarks/overlap.tsv"
    group:
        lambda wildcards: guard.group("read", wildcards.mooring)
    params:
        **keys(MOORINGS.overlap, NAMES),
    script:
        "../scripts/overlap.py"


rule fit:
    """Fit the deviation model to the pairs."""
    input:
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        field="results/{mooring}/work/field.json",
    output:
        fit="results/{mooring}/work/fit.json",
        job="results/{mooring}/logs/fit.json",
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    group:
        group_of_mooring
    wildcard_constraints:
        mooring=guard.only(name for name in CRUISE.moorings if name not in CALIBRATED),
    params:
        **keys(MOORINGS.fit, NAMES),
    script:
        "../scripts/fit.py"


rule transfer_calibration:
    """Convert the compass of a calibration to the mooring's field."""
    input:
        calibrations=lambda wildcards: calibration_files(MOORINGS.calibrations(*wildcards)),
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        field="results/{mooring}/work/field.json",
    output:
        fit="results/{mooring}/work/fit.json",
        job="results/{mooring}/logs/fit.json",
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    group:
        group_of_mooring
    wildcard_constraints:
        mooring=guard.only(CALIBRATED),
    params:
        **keys(MOORINGS.transfer_calibration, NAMES),
    script:
        "../scripts/transfer_calibration.py"


rule diagnose:
    """Search for effects that the fit lacks, choose the compass that corrects the record, and assess it."""
    input:
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        references=lambda wildcards: MOORINGS.references(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        wide="results/{mooring}/work/pairs/wide.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
    output:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
        agreement="results/{mooring}/work/agreement.json",
        job="results/{mooring}/logs/diagnose.json",
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    group:
        group_of_mooring
    wildcard_constraints:
        mooring=guard.only(name for name in CRUISE.moorings if name not in COMPASSES.moorings),
    params:
        **keys(MOORINGS.diagnose, NAMES),
    script:
        "../scripts/diagnose.py"


use rule diagnose as diagnose_alone with:
    """Diagnose a record of a shared compass by itself, and summarize it for the other records."""
    output:
        diagnosis="results/{mooring}/work/alone/diagnosis.json",
        deviation="results/{mooring}/work/alone/deviation.json",
        agreement="results/{mooring}/work/alone/agreement.json",
        summary="results/{mooring}/work/alone/summary.json",
        job="results/{mooring}/logs/diagnose_alone.json",
    log:
        "results/{mooring}/logs/diagnose_alone.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose_alone.tsv"
    wildcard_constraints:
        mooring=guard.only(COMPASSES.moorings),


rule diagnose_jointly:
    """Diagnose a record of a shared compass, with prior information from the other records."""
    input:
        joined=lambda wildcards: f"results/compasses/{COMPASSES.moorings[wildcards.mooring]}/compass.json",
        alone=expand(
            "results/{{mooring}}/work/alone/{name}.json", name=["diagnosis", "deviation", "agreement"]
        ),
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        references=lambda wildcards: MOORINGS.references(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        wide="results/{mooring}/work/pairs/wide.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
    output:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
        agreement="results/{mooring}/work/agreement.json",
        job="results/{mooring}/logs/diagnose.json",
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    group:
        lambda wildcards: guard.group("mooring", wildcards.mooring)
    wildcard_constraints:
        mooring=guard.only(COMPASSES.moorings),
    params:
        **keys(MOORINGS.diagnose_jointly, NAMES),
    script:
        "../scripts/diagnose_jointly.py"


rule correct:
    """Correct the headings and velocities of a record, and write its products, the pairs among them."""
    input:
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        references=lambda wildcards: MOORINGS.references(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        deviation="results/{mooring}/deviation.json",
        diagnosis="results/{mooring}/diagnosis.json",
        agreement="results/{mooring}/work/agreement.json",
        field="results/{mooring}/work/field.json",
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
    output:
        corrected="results/{mooring}/corrected.nc",
        overlap="results/{mooring}/overlap.nc",
        assessment="results/{mooring}/assessment.json",
        table="results/{mooring}/table.csv",
        histograms="results/{mooring}/histograms.csv",
        job="results/{mooring}/logs/correct.json",
    log:
        "results/{mooring}/logs/correct.log",
    benchmark:
        "results/{mooring}/benchmarks/correct.tsv"
    group:
        lambda wildcards: guard.group("mooring", wildcards.mooring)
    params:
        **keys(MOORINGS.correct, NAMES),
    script:
        "../scripts/correct.py"


def of_parts(file):
    """Return a function that lists one file of each affected instrument of a mooring that can go on."""

    def listed(wildcards):
        can_go_on = usable("moorings")
        return [f"results/{part}/{file}" for part in MOORINGS.parts(wildcards.mooring) if part in can_go_on]

    return listed


def records_of_parts(wildcards):
    """List the record files of the affected instruments of a mooring that can go on."""
    can_go_on = usable("moorings")
    return [MOORINGS.affected(part) for part in MOORINGS.parts(wildcards.mooring) if part in can_go_on]


rule grid:
    """Grid corrected and reference velocities to fixed depths and times, with uncertainties of sections and means."""
    input:
        corrected=of_parts("corrected.nc"),
        records=records_of_parts,
        references=lambda wildcards: MOORINGS.references(*wildcards),
        pairs=of_parts("overlap.nc"),
        deviations=of_parts("deviation.json"),
        assessments=of_parts("assessment.json"),
        fields=of_parts("work/field.json"),
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
    output:
        gridded=["results/{mooring}/gridded.nc"],
        job="results/{mooring}/logs/grid.json",
    log:
        "results/{mooring}/logs/grid.log",
    benchmark:
        "results/{mooring}/benchmarks/grid.tsv"
    group:
        lambda wildcards: guard.group("mooring", wildcards.mooring)
    wildcard_constraints:
        mooring=guard.only(name for name, files in MOORINGS.gridded.items() if not files[1:]),
    params:
        **keys(MOORINGS.grid, [(name,) for name in CRUISE.whole]),
    script:
        "../scripts/grid.py"


use rule grid as grid_with_daily_means with:
    """Grid velocities as well as their daily means."""
    output:
        gridded=["results/{mooring}/gridded.nc", "results/{mooring}/gridded_daily.nc"],
        job="results/{mooring}/logs/grid.json",
    wildcard_constraints:
        mooring=guard.only(name for name, files in MOORINGS.gridded.items() if files[1:]),


rule compare:
    """Compare forms of the curve by prediction of held-out pairs; no other stage needs it."""
    input:
        pairs="results/{mooring}/work/pairs/overlap.nc",
        deviation="results/{mooring}/deviation.json",
    output:
        forms="results/{mooring}/forms.json",
        job="results/{mooring}/logs/compare.json",
    log:
        "results/{mooring}/logs/compare.log",
    benchmark:
        "results/{mooring}/benchmarks/compare.tsv"
    group:
        lambda wildcards: guard.group("mooring", wildcards.mooring)
    priority: -1  # runs on cores that are idle otherwise
    params:
        library=LIBRARY,
    script:
        "../scripts/compare.py"


rule figures:
    """Draw the equivalents of von Appen's Figs 6 to 9 and time series, with thumbnails for the report."""
    input:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
        assessment="results/{mooring}/assessment.json",
        pairs="results/{mooring}/overlap.nc",
        histograms="results/{mooring}/histograms.csv",
        product="results/{mooring}/corrected.nc",
    output:
        figures=report(
            expand("results/{{mooring}}/figures/{name}.{form}", name=FIGURES["mooring"], form=FORMATS),
            category="Moorings",
            subcategory="{mooring}",
        ),
        pictures="results/{mooring}/work/pictures.json",
        job="results/{mooring}/logs/figures.json",
    log:
        "results/{mooring}/logs/figures.log",
    benchmark:
        "results/{mooring}/benchmarks/figures.tsv"
    params:
        library=LIBRARY,
    script:
        "../scripts/figures.py"


rule sections:
    """Draw the section and the mean profile of the gridded velocities."""
    input:
        gridded="results/{mooring}/gridded.nc",
    output:
        figures=report(
            expand("results/{{mooring}}/figures/{name}.{form}", name=FIGURES["gridded"], form=FORMATS),
            category="Moorings",
            subcategory="{mooring}",
        ),
        pictures="results/{mooring}/work/sections.json",
        job="results/{mooring}/logs/sections.json",
    log:
        "results/{mooring}/logs/sections.log",
    benchmark:
        "results/{mooring}/benchmarks/sections.tsv"
    params:
        library=LIBRARY,
    script:
        "../scripts/sections.py"


rule check_conventions:
    """Check one mooring's netCDF files against CF, ACDD and OceanSITES, in each run if configured."""
    input:
        products=lambda wildcards: archived(wildcards.mooring),
    output:
        conventions="results/{mooring}/conventions.json",
        job="results/{mooring}/logs/conventions.json",
    log:
        "results/{mooring}/logs/conventions.log",
    params:
        library=LIBRARY,
        checker="checker=" + json.dumps(provenance.installed("compliance-checker")),
    script:
        "../scripts/check_conventions.py"


def archived(name):
    """List the netCDF files of a mooring: products, gridded ones if configured, and records of its instruments."""
    products = [f"results/{name}/{file}" for file in ("corrected.nc", "overlap.nc") if name in CRUISE.moorings]
    gridded = [f"results/{name}/{file}" for file in MOORINGS.gridded.get(name, [])]
    roles = MOORINGS.roles(name) if name in CRUISE.moorings else []
    return [*products, *gridded, *(f"results/{name}/work/{role}.nc" for role in roles)]


rule conventions:
    """Check the netCDF files of all moorings against CF, ACDD and OceanSITES."""
    input:
        lambda wildcards: [
            f"results/{name}/conventions.json" for name in dict.fromkeys([*CRUISE.moorings, *MOORINGS.gridded])
        ],
