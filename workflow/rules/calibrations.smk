"""Calibrations that need no mooring: one rule for all kinds."""


rule calibrate:
    """Raw readings -> coefficients, table of deviations, budget of uncertainty."""
    input:
        PLAN.inputs("calibrate"),
    output:
        update("results/calibrations/{calibration}/logs/calibrate.json"),
    log:
        "results/calibrations/{calibration}/logs/calibrate.log",
    params:
        **PLAN.params("calibrate"),
    script:
        "../scripts/calibrate.py"


rule diagnose_calibration:
    """Raw readings -> what they show that the simulation does not hold."""
    input:
        PLAN.inputs("diagnose_calibration"),
    output:
        update("results/calibrations/{calibration}/logs/diagnose.json"),
    log:
        "results/calibrations/{calibration}/logs/diagnose.log",
    params:
        **PLAN.params("diagnose_calibration"),
    script:
        "../scripts/diagnose_calibration.py"


rule diagnosis_figure:
    """What was found -> where the mismatch lives, before and after, and the ranked hypotheses."""
    input:
        PLAN.inputs("diagnosis_figure"),
    output:
        update("results/calibrations/{calibration}/logs/diagnosis_figure.json"),
    log:
        "results/calibrations/{calibration}/logs/diagnosis_figure.log",
    params:
        **PLAN.params("diagnosis_figure"),
    script:
        "../scripts/diagnosis_figure.py"


rule calibration_figures:
    """Calibration -> the figures of its kind."""
    input:
        PLAN.inputs("calibration_figures"),
    output:
        update("results/calibrations/{calibration}/logs/figures.json"),
    log:
        "results/calibrations/{calibration}/logs/figures.log",
    params:
        **PLAN.params("calibration_figures"),
    script:
        "../scripts/calibration_figures.py"
