"""One mooring, from raw files to figures."""


rule read:
    """Read a raw export into the instrument's record inside the deployment."""
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
    """Compute the earth's field, and find pairs of measurements of nearly the same water in the records."""
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
    """Fit the deviation model to the pairs."""
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
    """Convert the compass of a calibration to the mooring's field."""
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
    """Search for effects that the fit lacks, choose the compass that corrects the record, and assess it."""
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
    """Diagnose a record of a shared compass by itself, and summarize it for the other records."""
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
    """Diagnose a record of a shared compass, with prior information from the other records."""
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
    """Correct the headings and velocities of a record and write them as corrected.nc."""
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
    """Grid corrected and reference velocities to fixed depths and times, with uncertainties of sections and means."""
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
    """Compare forms of the curve by prediction of held-out pairs; no other stage needs it."""
    input:
        PLAN.inputs("compare"),
    output:
        update("results/{mooring}/logs/compare.json"),
    log:
        "results/{mooring}/logs/compare.log",
    priority: -1  # runs on cores that are idle otherwise
    params:
        **PLAN.params("compare"),
    script:
        "../scripts/compare.py"


rule figures:
    """Draw the equivalents of von Appen's Figs 6 to 9 and time series, with thumbnails for the report."""
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
    """Draw sections and mean profiles of a mooring with several affected instruments."""
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
