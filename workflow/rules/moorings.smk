"""One mooring, from raw files to figures."""


rule read:
    """Raw export -> the instrument's record inside the deployment."""
    input:
        PLAN.inputs("read"),
    output:
        update("results/{mooring}/logs/read_{role}.json"),
    log:
        "results/{mooring}/logs/read_{role}.log",
    params:
        **PLAN.params("read"),
    script:
        "../scripts/read.py"


rule overlap:
    """Two records, position and dates -> the earth's field, and pairs that measured nearly the same water."""
    input:
        PLAN.inputs("overlap"),
    output:
        update("results/{mooring}/logs/overlap.json"),
    log:
        "results/{mooring}/logs/overlap.log",
    params:
        **PLAN.params("overlap"),
    script:
        "../scripts/overlap.py"


rule fit:
    """Pairs -> the deviation model."""
    input:
        PLAN.inputs("fit"),
    output:
        update("results/{mooring}/logs/fit.json"),
    log:
        "results/{mooring}/logs/fit.log",
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
        update("results/{mooring}/logs/fit.json"),
    log:
        "results/{mooring}/logs/fit.log",
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
        update("results/{mooring}/logs/diagnose.json"),
    log:
        "results/{mooring}/logs/diagnose.log",
    wildcard_constraints:
        mooring=PLAN.names("diagnose"),
    params:
        **PLAN.params("diagnose"),
    script:
        "../scripts/diagnose.py"


rule diagnose_alone:
    """As diagnose, of a record whose compass has others: what it shows alone, and what they may learn from it."""
    input:
        PLAN.inputs("diagnose_alone"),
    output:
        update("results/{mooring}/logs/diagnose_alone.json"),
    log:
        "results/{mooring}/logs/diagnose_alone.log",
    wildcard_constraints:
        mooring=PLAN.names("diagnose_alone"),
    params:
        **PLAN.params("diagnose_alone"),
    script:
        "../scripts/diagnose.py"


rule share:
    """As diagnose, with what the other records of the compass tell beforehand."""
    input:
        PLAN.inputs("share"),
    output:
        update("results/{mooring}/logs/diagnose.json"),
    log:
        "results/{mooring}/logs/diagnose.log",
    wildcard_constraints:
        mooring=PLAN.names("share"),
    params:
        **PLAN.params("share"),
    script:
        "../scripts/share.py"


rule correct:
    """Record and deviation -> corrected headings and velocities in the archive's form."""
    input:
        PLAN.inputs("correct"),
    output:
        update("results/{mooring}/logs/correct.json"),
    log:
        "results/{mooring}/logs/correct.log",
    params:
        **PLAN.params("correct"),
    script:
        "../scripts/correct.py"


rule grid:
    """Corrected and reference velocities -> fixed depths and times, with the uncertainty of sections and means."""
    input:
        PLAN.inputs("grid"),
    output:
        update("results/{mooring}/logs/grid.json"),
    log:
        "results/{mooring}/logs/grid.log",
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
        update("results/{mooring}/logs/compare.json"),
    log:
        "results/{mooring}/logs/compare.log",
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
        update("results/{mooring}/logs/figures.json"),
    log:
        "results/{mooring}/logs/figures.log",
    params:
        **PLAN.params("figures"),
    script:
        "../scripts/figures.py"


rule sections:
    """Sections and mean profiles of a mooring of several affected instruments."""
    input:
        PLAN.inputs("sections"),
    output:
        update("results/{mooring}/logs/sections.json"),
    log:
        "results/{mooring}/logs/sections.log",
    wildcard_constraints:
        mooring=PLAN.names("sections"),
    params:
        **PLAN.params("sections"),
    script:
        "../scripts/sections.py"
