"""Calibrations independent of any mooring, by the same rules for all kinds."""


rule calibrate:
    """Calibrate a compass by raw readings: coefficients, deviation table, uncertainty budget."""
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
    """Search raw readings for effects that the model of the calibration lacks."""
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
    """Draw the residuals of a calibration before and after, and the ranked hypotheses."""
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
    """Draw the figures of a calibration according to its kind."""
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
