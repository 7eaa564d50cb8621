"""Calibrations that need no mooring: one rule for all kinds, figures a kind each as each has its own."""


rule calibrate:
    """Raw readings -> coefficients, table of deviations, budget of uncertainty."""
    input:
        raw=CALIBRATIONS.raw_files,
        earlier=CALIBRATIONS.earlier,
        modules=CALIBRATIONS.modules,
    output:
        calibration="results/calibrations/{calibration}/calibration.json",
        table="results/calibrations/{calibration}/table.csv",
        points="results/calibrations/{calibration}/points.csv",
    params:
        kind=CALIBRATIONS.kind,
        settings=CALIBRATIONS.settings,
    conda:
        "../envs/compasslib.yaml"
    log:
        "results/calibrations/{calibration}/logs/calibrate.log",
    benchmark:
        "results/calibrations/{calibration}/benchmarks/calibrate.tsv"
    script:
        "../scripts/calibrate.py"


# results/calibrations/NAME/diagnosis.json belongs here: a rule that holds the recording against the simulation.


for KIND in KINDS:

    rule:
        name:
            f"figures_of_{KIND}"
        input:
            calibration="results/calibrations/{calibration}/calibration.json",
            table="results/calibrations/{calibration}/table.csv",
            points="results/calibrations/{calibration}/points.csv",
            modules=CALIBRATIONS.figure_modules(KIND),
        output:
            **{
                figure: report(
                    f"results/calibrations/{{calibration}}/figures/{figure}.png",
                    caption="../report/calibration.rst",
                    category="Calibrations",
                    subcategory="{calibration}",
                    labels={"figure": figure},
                )
                for figure in CALIBRATIONS.figures(KIND)
            },
        wildcard_constraints:
            calibration="|".join(CALIBRATIONS.of_kind(KIND)) or "none",
        conda:
            "../envs/compasslib.yaml"
        log:
            "results/calibrations/{calibration}/logs/figures.log",
        benchmark:
            "results/calibrations/{calibration}/benchmarks/figures.tsv"
        script:
            "../scripts/calibration_figures.py"


rule carry:
    """Calibration elsewhere -> the deviation model in the mooring's field."""
    input:
        calibration=PLAN.calibration,
        record=PLAN.compromised,
        pairs="results/{mooring}/overlap.nc",
        field="results/{mooring}/work/field.json",
        modules=PLAN.modules("carry.py"),
    output:
        "results/{mooring}/work/fit.json",
    wildcard_constraints:
        mooring="|".join(PLAN.by_calibration()) or "none",
    conda:
        "../envs/compasslib.yaml"
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    script:
        "../scripts/carry.py"
