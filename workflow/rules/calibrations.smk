"""Calibrations independent of any mooring, by the same rules for all kinds."""


def calibration_files(names):
    """List the files of calibrations that others use, by their names."""
    return [f"results/calibrations/{name}/calibration.json" for name in names]


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
        **keys(CALIBRATIONS.calibrate, [(name,) for name in CRUISE.calibrations]),
    script:
        "../scripts/calibrate.py"


rule compare_calibrations:
    """Write coefficients, deviation table, points and uncertainty budget, compared with other calibrations."""
    input:
        calibration="results/calibrations/{calibration}/work/calibration.json",
        table="results/calibrations/{calibration}/work/table.csv",
        points="results/calibrations/{calibration}/work/points.csv",
        others=lambda wildcards: calibration_files(
            name for name in CALIBRATIONS.compared_with(*wildcards) if name in usable("calibrations")
        ),
    output:
        compared="results/calibrations/{calibration}/calibration.json",
        made=["results/calibrations/{calibration}/table.csv", "results/calibrations/{calibration}/points.csv"],
        job="results/calibrations/{calibration}/logs/compare.json",
    log:
        "results/calibrations/{calibration}/logs/compare.log",
    params:
        library=LIBRARY,
    script:
        "../scripts/compare_calibrations.py"


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
        **keys(CALIBRATIONS.diagnose, [(name,) for name in CRUISE.calibrations]),
    script:
        "../scripts/diagnose_calibration.py"


rule diagnosis_figure:
    """Draw the residuals of a calibration before and after, and the ranked hypotheses."""
    input:
        diagnosis="results/calibrations/{calibration}/diagnosis.json",
    output:
        figures=report(
            expand("results/calibrations/{{calibration}}/figures/diagnosis.{form}", form=FORMATS),
            category="Calibrations",
            subcategory="{calibration}",
        ),
        job="results/calibrations/{calibration}/logs/diagnosis_figure.json",
    log:
        "results/calibrations/{calibration}/logs/diagnosis_figure.log",
    params:
        library=LIBRARY,
    script:
        "../scripts/diagnosis_figure.py"


for DRAWN, OF_THESE in CALIBRATIONS.figures.items():

    rule:
        name:
            f"calibration_figures_{'_'.join(DRAWN)}"
        input:
            calibration="results/calibrations/{calibration}/calibration.json",
            table="results/calibrations/{calibration}/table.csv",
            points="results/calibrations/{calibration}/points.csv",
        output:
            figures=report(
                expand("results/calibrations/{{calibration}}/figures/{name}.{form}", name=DRAWN, form=FORMATS),
                category="Calibrations",
                subcategory="{calibration}",
            ),
            job="results/calibrations/{calibration}/logs/figures.json",
        log:
            "results/calibrations/{calibration}/logs/figures.log",
        wildcard_constraints:
            calibration=guard.only(OF_THESE),
        params:
            library=LIBRARY,
        script:
            "../scripts/calibration_figures.py"
