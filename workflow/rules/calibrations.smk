"""Calibrations independent of any mooring, by the same rules for all kinds."""


rule calibrate:
    """Calibrate a compass by raw readings, or state why they cannot be used."""
    input:
        raw=lambda wildcards: CALIBRATIONS.raw_files(*wildcards),
    output:
        calibration="results/calibrations/{calibration}/work/calibration.json",
        table="results/calibrations/{calibration}/work/table.csv",
        points="results/calibrations/{calibration}/work/points.csv",
        job="results/calibrations/{calibration}/logs/calibrate.json",
    log:
        "results/calibrations/{calibration}/logs/calibrate.log",
    benchmark:
        "results/calibrations/{calibration}/benchmarks/calibrate.tsv"
    params:
        **parameters("fit.calibrate", CALIBRATIONS.calibrate, zip(CRUISE.calibrations)),
    script:
        "../scripts/stage.py"


rule compare_calibrations:
    """Write coefficients, deviation table, points and uncertainty budget, compared with other calibrations."""
    input:
        calibration="results/calibrations/{calibration}/work/calibration.json",
        table="results/calibrations/{calibration}/work/table.csv",
        points="results/calibrations/{calibration}/work/points.csv",
        others=of_usable("calibrations", "calibration.json", among=CALIBRATIONS.compared_with),
    output:
        compared="results/calibrations/{calibration}/calibration.json",
        made=["results/calibrations/{calibration}/table.csv", "results/calibrations/{calibration}/points.csv"],
        job="results/calibrations/{calibration}/logs/compare.json",
    log:
        "results/calibrations/{calibration}/logs/compare.log",
    params:
        **parameters("fit.compare_calibrations", CALIBRATIONS.compare_calibrations, zip(CRUISE.calibrations)),
    script:
        "../scripts/stage.py"


rule diagnose_calibration:
    """Search raw readings for effects that the model of the calibration lacks."""
    input:
        raw=lambda wildcards: CALIBRATIONS.raw_files(*wildcards),
    output:
        diagnosis="results/calibrations/{calibration}/diagnosis.json",
        job="results/calibrations/{calibration}/logs/diagnose.json",
    log:
        "results/calibrations/{calibration}/logs/diagnose.log",
    benchmark:
        "results/calibrations/{calibration}/benchmarks/diagnose.tsv"
    wildcard_constraints:
        calibration=guard.only(CALIBRATIONS.diagnosed),
    params:
        **parameters("diagnose.diagnose_calibration", CALIBRATIONS.diagnose, zip(CRUISE.calibrations)),
    script:
        "../scripts/stage.py"


for FIGURES, OF_THESE in CALIBRATIONS.figures.items():

    rule:
        name:
            f"calibration_figures_{'_'.join(FIGURES)}"
        input:
            calibration="results/calibrations/{calibration}/calibration.json",
            table="results/calibrations/{calibration}/table.csv",
            points="results/calibrations/{calibration}/points.csv",
            diagnosis=["results/calibrations/{calibration}/diagnosis.json"] if "diagnosis" in FIGURES else [],
        output:
            figures=reported(
                "results/calibrations/{calibration}/figures/{name}.{form}", FIGURES, "Calibrations", "{calibration}"
            ),
            job="results/calibrations/{calibration}/logs/figures.json",
        log:
            "results/calibrations/{calibration}/logs/figures.log",
        wildcard_constraints:
            calibration=guard.only(OF_THESE),
        params:
            **parameters("figures.calibration_figures", lambda: {"formats": FORMATS}),
        script:
            "../scripts/stage.py"
