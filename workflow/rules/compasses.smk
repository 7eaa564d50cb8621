"""Records that share a compass: each is diagnosed alone, all are joined, and each is diagnosed given the others."""


rule combine_records:
    """Combine the records of a compass: its iron and effects, rejected records, and the prior for each record."""
    input:
        summaries=lambda wildcards: [f"results/{name}/work/alone/summary.json" for name in members(wildcards)[0]],
        calibrations=lambda wildcards: calibration_files(members(wildcards)[1]),
    output:
        joined="results/compasses/{compass}/compass.json",
        diagnosis="results/compasses/{compass}/diagnosis.json",
        job="results/compasses/{compass}/logs/combine_records.json",
    log:
        "results/compasses/{compass}/logs/combine_records.log",
    benchmark:
        "results/compasses/{compass}/benchmarks/combine_records.tsv"
    params:
        **parameters(COMPASSES.combine_records, [(name,) for name in COMPASSES.members]),
        stage="diagnose.combine_records",
    script:
        "../scripts/stage.py"


rule joined_figures:
    """Draw the iron by each record of a compass, and the deviation curve that they share."""
    input:
        joined="results/compasses/{compass}/compass.json",
    output:
        figures=report(
            expand(
                "results/compasses/{{compass}}/figures/{name}.{form}", name=["coefficients", "curve"], form=FORMATS
            ),
            category="Compasses",
            subcategory="{compass}",
        ),
        job="results/compasses/{compass}/logs/figures.json",
    log:
        "results/compasses/{compass}/logs/figures.log",
    params:
        **DRAWN,
        stage="figures.joined_figures",
    script:
        "../scripts/stage.py"
