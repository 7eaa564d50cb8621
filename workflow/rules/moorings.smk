"""One mooring, from raw files to figures."""


rule read:
    """Raw export -> the instrument's record inside the deployment."""
    input:
        PLAN.inputs("read"),
    output:
        "results/{mooring}/logs/read_{role}.json",
    log:
        "results/{mooring}/logs/read_{role}.log",
    benchmark:
        "results/{mooring}/benchmarks/read_{role}.tsv"
    params:
        **PLAN.params("read"),
    script:
        "../scripts/read.py"


rule overlap:
    """Two records, position and dates -> the earth's field, and pairs that measured nearly the same water."""
    input:
        PLAN.inputs("overlap"),
    output:
        "results/{mooring}/logs/overlap.json",
    log:
        "results/{mooring}/logs/overlap.log",
    benchmark:
        "results/{mooring}/benchmarks/overlap.tsv"
    params:
        **PLAN.params("overlap"),
    script:
        "../scripts/overlap.py"


rule fit:
    """Pairs -> the deviation model."""
    input:
        PLAN.inputs("fit"),
    output:
        "results/{mooring}/logs/fit.json",
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    wildcard_constraints:
        mooring=PLAN.names("fit"),
    params:
        **PLAN.params("fit"),
    script:
        "../scripts/fit.py"


rule carry:
    """Calibration elsewhere -> the deviation model in the mooring's field."""
    input:
        PLAN.inputs("carry"),
    output:
        "results/{mooring}/logs/fit.json",
    log:
        "results/{mooring}/logs/fit.log",
    benchmark:
        "results/{mooring}/benchmarks/fit.tsv"
    wildcard_constraints:
        mooring=PLAN.names("carry"),
    params:
        **PLAN.params("carry"),
    script:
        "../scripts/carry.py"


rule diagnose:
    """Pairs and fit -> what physics the fit leaves out, the compass that corrects the record, and how well it does."""
    input:
        PLAN.inputs("diagnose"),
    output:
        "results/{mooring}/logs/diagnose.json",
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    wildcard_constraints:
        mooring=PLAN.names("diagnose"),
    params:
        **PLAN.params("diagnose"),
    script:
        "../scripts/diagnose.py"


rule correct:
    """Record and deviation -> corrected headings and velocities in the archive's form."""
    input:
        PLAN.inputs("correct"),
    output:
        "results/{mooring}/logs/correct.json",
    log:
        "results/{mooring}/logs/correct.log",
    benchmark:
        "results/{mooring}/benchmarks/correct.tsv"
    params:
        **PLAN.params("correct"),
    script:
        "../scripts/correct.py"


rule grid:
    """Corrected and reference velocities -> fixed depths and times, with the uncertainty of sections and means."""
    input:
        PLAN.inputs("grid"),
    output:
        "results/{mooring}/logs/grid.json",
    log:
        "results/{mooring}/logs/grid.log",
    benchmark:
        "results/{mooring}/benchmarks/grid.tsv"
    wildcard_constraints:
        mooring=PLAN.names("grid"),
    params:
        **PLAN.params("grid"),
    script:
        "../scripts/grid.py"


rule compare:
    """Pairs -> which form of the curve predicts held-out ones best; no other stage waits for it."""
    input:
        PLAN.inputs("compare"),
    output:
        "results/{mooring}/logs/compare.json",
    log:
        "results/{mooring}/logs/compare.log",
    benchmark:
        "results/{mooring}/benchmarks/compare.tsv"
    priority: -1  # it fills the cores that others leave
    params:
        **PLAN.params("compare"),
    script:
        "../scripts/compare.py"


rule figures:
    """The equivalents of von Appen's Figs 6 to 9, and the record along time; small ones for the page."""
    input:
        PLAN.inputs("figures"),
    output:
        "results/{mooring}/logs/figures.json",
    log:
        "results/{mooring}/logs/figures.log",
    benchmark:
        "results/{mooring}/benchmarks/figures.tsv"
    params:
        **PLAN.params("figures"),
    script:
        "../scripts/figures.py"


rule sections:
    """Sections and mean profiles of a mooring of several affected instruments."""
    input:
        PLAN.inputs("sections"),
    output:
        "results/{mooring}/logs/sections.json",
    log:
        "results/{mooring}/logs/sections.log",
    benchmark:
        "results/{mooring}/benchmarks/sections.tsv"
    wildcard_constraints:
        mooring=PLAN.names("sections"),
    params:
        **PLAN.params("sections"),
    script:
        "../scripts/sections.py"


rule check_conventions:
    """CF, ACDD and OceanSITES against one mooring's netCDF files; in each run where the options say so."""
    input:
        PLAN.inputs("check_conventions"),
    output:
        "results/{mooring}/logs/conventions.json",
    log:
        "results/{mooring}/logs/conventions.log",
    benchmark:
        "results/{mooring}/benchmarks/conventions.tsv"
    params:
        **PLAN.params("check_conventions"),
    script:
        "../scripts/conventions.py"


rule conventions:
    """CF, ACDD and OceanSITES against the netCDF files of all moorings."""
    input:
        PLAN.conventions,
