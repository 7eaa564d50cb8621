"""Records that share a compass: each is diagnosed alone, all are joined, and each is diagnosed given the others."""


rule combine_records:
    """Combine the records of a compass: its iron and effects, rejected records, and the prior for each record."""
    input:
        summaries=of_usable("moorings", "work/alone/summary.json", among=lambda compass: CRUISE.compasses[compass][0]),
        calibrations=of_usable("calibrations", "calibration.json", among=lambda compass: CRUISE.compasses[compass][1]),
    output:
        joined="results/compasses/{compass}/compass.json",
        diagnosis="results/compasses/{compass}/diagnosis.json",
        job="results/compasses/{compass}/logs/combine_records.json",
    log:
        "results/compasses/{compass}/logs/combine_records.log",
    benchmark:
        "results/compasses/{compass}/benchmarks/combine_records.tsv"
    params:
        **parameters("diagnose.combine_records", COMPASSES.combine_records, zip(CRUISE.compasses)),
    script:
        "../scripts/stage.py"


rule joined_figures:
    """Draw the iron by each record of a compass, and the deviation curve that they share."""
    input:
        joined="results/compasses/{compass}/compass.json",
    output:
        figures=reported("results/compasses/{compass}/figures/{name}.{form}", names("compass"), "Compasses", "{compass}"),
        job="results/compasses/{compass}/logs/figures.json",
    log:
        "results/compasses/{compass}/logs/figures.log",
    params:
        **parameters("figures.joined_figures", lambda: {"formats": FORMATS}),
    script:
        "../scripts/stage.py"
