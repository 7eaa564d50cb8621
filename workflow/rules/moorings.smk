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
        lambda wildcards: group_of_mooring(wildcards, "read")
    params:
        **parameters("read.read", MOORINGS.read, INSTRUMENTS),
    script:
        "../scripts/stage.py"


rule overlap:
    """Compute the earth's field, and find pairs of measurements of nearly the same water in the records."""
    input:
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        references=lambda wildcards: MOORINGS.references(*wildcards),
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
        lambda wildcards: group_of_mooring(wildcards, "read")
    params:
        **parameters("read.overlap", MOORINGS.overlap, zip(CRUISE.moorings)),
    script:
        "../scripts/stage.py"


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
    wildcard_constraints:
        mooring=guard.only(FITTED),
    group:
        group_of_mooring
    params:
        **parameters("fit.fit", MOORINGS.fit, zip(FITTED)),
    script:
        "../scripts/stage.py"


# Convert the compass of a calibration to the mooring's field.
use rule fit as transfer_calibration with:
    input:
        calibrations=lambda wildcards: expand(
            "results/calibrations/{name}/calibration.json", name=MOORINGS.calibrations(*wildcards)
        ),
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        field="results/{mooring}/work/field.json",
    wildcard_constraints:
        mooring=guard.only(CALIBRATED),
    params:
        **parameters("fit.transfer_calibration", MOORINGS.transfer_calibration, zip(CALIBRATED)),


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
    wildcard_constraints:
        mooring=guard.only(name for name in CRUISE.moorings if name not in COMPASSES.moorings),
    group:
        group_of_mooring
    params:
        **parameters("diagnose.diagnose", MOORINGS.diagnose, zip(CRUISE.moorings)),
    script:
        "../scripts/stage.py"


# Diagnose a record of a shared compass by itself, and summarize it for the other records.
use rule diagnose as diagnose_alone with:
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


# Diagnose a record of a shared compass, with prior information from the other records.
use rule diagnose as diagnose_jointly with:
    input:
        joined=lambda wildcards: f"results/compasses/{COMPASSES.moorings[wildcards.mooring]}/compass.json",
        alone=expand("results/{{mooring}}/work/alone/{name}.json", name=["diagnosis", "deviation", "agreement"]),
        record=lambda wildcards: MOORINGS.affected(*wildcards),
        references=lambda wildcards: MOORINGS.references(*wildcards),
        pairs="results/{mooring}/work/pairs/overlap.nc",
        wide="results/{mooring}/work/pairs/wide.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
    wildcard_constraints:
        mooring=guard.only(COMPASSES.moorings),
    group:
        lambda wildcards: group_of_mooring(wildcards, "mooring")


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
        lambda wildcards: group_of_mooring(wildcards, "mooring")
    params:
        **parameters("correct.correct", MOORINGS.correct, zip(CRUISE.moorings)),
    script:
        "../scripts/stage.py"


rule grid:
    """Grid corrected and reference velocities to fixed depths and times, with uncertainties of sections and means."""
    input:
        corrected=of_usable("moorings", "corrected.nc", among=MOORINGS.parts),
        records=lambda wildcards: [
            MOORINGS.affected(part) for part in MOORINGS.parts(*wildcards) if part in usable("moorings")
        ],
        references=lambda wildcards: MOORINGS.references(*wildcards),
        pairs=of_usable("moorings", "overlap.nc", among=MOORINGS.parts),
        deviations=of_usable("moorings", "deviation.json", among=MOORINGS.parts),
        assessments=of_usable("moorings", "assessment.json", among=MOORINGS.parts),
        fields=of_usable("moorings", "work/field.json", among=MOORINGS.parts),
        observatory=lambda wildcards: MOORINGS.observatory(*wildcards),
    output:
        gridded=["results/{mooring}/gridded.nc"],
        job="results/{mooring}/logs/grid.json",
    log:
        "results/{mooring}/logs/grid.log",
    benchmark:
        "results/{mooring}/benchmarks/grid.tsv"
    wildcard_constraints:
        mooring=guard.only(name for name, files in MOORINGS.gridded.items() if not files[1:]),
    group:
        lambda wildcards: group_of_mooring(wildcards, "mooring")
    params:
        **parameters("correct.grid", MOORINGS.grid, zip(CRUISE.whole)),
    script:
        "../scripts/stage.py"


# Grid velocities as well as their daily means.
use rule grid as grid_with_daily_means with:
    output:
        gridded=["results/{mooring}/gridded.nc", "results/{mooring}/gridded_daily.nc"],
        job="results/{mooring}/logs/grid.json",
    wildcard_constraints:
        mooring=guard.only(name for name, files in MOORINGS.gridded.items() if files[1:]),


rule join_site:
    """Join the daily means of successive deployments of a site, with the errors that they share."""
    input:
        daily=lambda wildcards: MOORINGS.daily_means(wildcards.site, usable("moorings")),
    output:
        joined="results/sites/{site}/gridded_daily.nc",
        job="results/sites/{site}/logs/join.json",
    log:
        "results/sites/{site}/logs/join.log",
    localrule: True
    params:
        **parameters("correct.join_site", MOORINGS.join_site, zip(MOORINGS.sites)),
    script:
        "../scripts/stage.py"


rule figures:
    """Draw the equivalents of von Appen's Figs 6 to 9 and time series, and encode them for the report."""
    input:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
        pairs="results/{mooring}/overlap.nc",
        histograms="results/{mooring}/histograms.csv",
        product="results/{mooring}/corrected.nc",
    output:
        figures=reported("results/{mooring}/figures/{name}.{form}", names("mooring"), "Moorings", "{mooring}"),
        pictures="results/{mooring}/work/pictures.json",
        job="results/{mooring}/logs/figures.json",
    log:
        "results/{mooring}/logs/figures.log",
    benchmark:
        "results/{mooring}/benchmarks/figures.tsv"
    params:
        **parameters("figures.figures", lambda: {"formats": FORMATS}),
    script:
        "../scripts/stage.py"


# Draw the section and the mean profile of the gridded velocities.
use rule figures as sections with:
    input:
        gridded="results/{mooring}/gridded.nc",
    output:
        figures=reported("results/{mooring}/figures/{name}.{form}", names("sections"), "Moorings", "{mooring}"),
        pictures="results/{mooring}/work/sections.json",
        job="results/{mooring}/logs/sections.json",
    log:
        "results/{mooring}/logs/sections.log",
    benchmark:
        "results/{mooring}/benchmarks/sections.tsv"
    params:
        **parameters("figures.sections", lambda: {"formats": FORMATS}),
