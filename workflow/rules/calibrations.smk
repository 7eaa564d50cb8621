"""Calibrations that need no mooring: one rule for all kinds, figures a kind each as each has its own."""


rule calibrate:
    """Raw readings -> coefficients, table of deviations, budget of uncertainty."""
    input:
        raw=CALIBRATIONS.raw_files,
        earlier=CALIBRATIONS.earlier,
    output:
        calibration="results/calibrations/{calibration}/calibration.json",
        table="results/calibrations/{calibration}/table.csv",
        points="results/calibrations/{calibration}/points.csv",
    params:
        kind=CALIBRATIONS.kind,
        settings=CALIBRATIONS.settings,
        code=plan.hashed(CALIBRATIONS.modules),
    log:
        "results/calibrations/{calibration}/logs/calibrate.log",
    benchmark:
        "results/calibrations/{calibration}/benchmarks/calibrate.tsv"
    script:
        "../scripts/calibrate.py"


rule diagnose_calibration:
    """Raw readings -> what they show that the simulation does not hold."""
    input:
        # For the order: what cannot be read is told once. As ancient() it would hide a changed setting.
        "results/calibrations/{calibration}/calibration.json",
        raw=CALIBRATIONS.raw_files,
    output:
        diagnosis="results/calibrations/{calibration}/diagnosis.json",
    params:
        kind=CALIBRATIONS.kind,
        settings=CALIBRATIONS.settings,
        options=CALIBRATIONS.diagnose(),
        code=plan.hashed(CALIBRATIONS.diagnosis_modules),
    log:
        "results/calibrations/{calibration}/logs/diagnose.log",
    benchmark:
        "results/calibrations/{calibration}/benchmarks/diagnose.tsv"
    script:
        "../scripts/diagnose_calibration.py"


rule diagnosis_figure:
    """What was found -> where the mismatch lives, before and after, and the ranked hypotheses."""
    input:
        diagnosis="results/calibrations/{calibration}/diagnosis.json",
    output:
        figure=report(
            "results/calibrations/{calibration}/figures/diagnosis.png",
            caption="../report/calibration_diagnosis.rst",
            category="Calibrations",
            subcategory="{calibration}",
            labels={"figure": "diagnosis"},
        ),
    params:
        code=MOORINGS.code("diagnosis_figure.py"),
    log:
        "results/calibrations/{calibration}/logs/diagnosis_figure.log",
    benchmark:
        "results/calibrations/{calibration}/benchmarks/diagnosis_figure.tsv"
    script:
        "../scripts/diagnosis_figure.py"


for KIND in KINDS:

    rule:
        name:
            f"figures_of_{KIND}"
        input:
            calibration="results/calibrations/{calibration}/calibration.json",
            table="results/calibrations/{calibration}/table.csv",
            points="results/calibrations/{calibration}/points.csv",
        output:
            figures=[
                report(
                    f"results/calibrations/{{calibration}}/figures/{figure}.png",
                    caption="../report/calibration.rst",
                    category="Calibrations",
                    subcategory="{calibration}",
                    labels={"figure": figure},
                )
                for figure in CALIBRATIONS.figures(KIND)
            ],
        params:
            code=plan.hashed(CALIBRATIONS.figure_modules),
        wildcard_constraints:
            calibration=plan.only(CALIBRATIONS.of_kind(KIND)),
        log:
            "results/calibrations/{calibration}/logs/figures.log",
        benchmark:
            "results/calibrations/{calibration}/benchmarks/figures.tsv"
        script:
            "../scripts/calibration_figures.py"


rule carry:
    """Calibration elsewhere -> the deviation model in the mooring's field."""
    input:
        calibration=MOORINGS.calibration,
        record=MOORINGS.compromised,
        pairs="results/{mooring}/overlap.nc",
        field="results/{mooring}/work/field.json",
    output:
        fit="results/{mooring}/work/fit.json",
    params:
        code=MOORINGS.code("carry.py"),
    wildcard_constraints:
        mooring=plan.only(MOORINGS.by_calibration()),
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    script:
        "../scripts/carry.py"
