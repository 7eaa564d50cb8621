"""The whole cruise: summary, report, what was made from what, and whether it still is so."""


# On a cluster these run where Snakemake was started: seconds each, and they wait for all others.
localrules:
    summary,
    cruise_figures,
    report,
    provenance,
    complete,


rule summary:
    """One row a mooring."""
    input:
        PLAN.inputs("summary"),
    output:
        report("results/summary.csv", caption="../report/summary.rst", category="Cruise"),
        "results/logs/summary.json",
    log:
        "results/logs/summary.log",
    params:
        **PLAN.params("summary"),
    script:
        "../scripts/summary.py"


rule cruise_figures:
    """All moorings on one figure each: deviations, differences from the reference, currents."""
    input:
        PLAN.inputs("cruise_figures"),
    output:
        "results/logs/cruise_figures.json",
    log:
        "results/logs/cruise_figures.log",
    params:
        **PLAN.params("cruise_figures"),
    script:
        "../scripts/cruise_figures.py"


rule report:
    """All results on one page that needs no network."""
    input:
        PLAN.inputs("report"),
    output:
        report("results/report.html", caption="../report/page.rst", category="Cruise"),
        "results/logs/report.json",
    log:
        "results/logs/report.log",
    params:
        **PLAN.params("report"),
    script:
        "../scripts/report.py"


rule provenance:
    """Records of all jobs -> manifest with the hash of every file read or written, a Process Run Crate."""
    input:
        PLAN.inputs("provenance"),
    output:
        "results/ro-crate-metadata.json",
        "results/logs/provenance.json",
    log:
        "results/logs/provenance.log",
    params:
        **PLAN.params("provenance"),
    script:
        "../scripts/provenance.py"


rule complete:
    """All else -> status 1 where a mooring or calibration was stopped."""
    input:
        PLAN.inputs("complete"),
    output:
        "results/logs/complete.json",
    log:
        "results/logs/complete.log",
    params:
        **PLAN.params("complete"),
    script:
        "../scripts/complete.py"


rule check_conventions:
    """CF, ACDD and OceanSITES against one mooring's netCDF files; in each run where the options say so."""
    input:
        PLAN.inputs("check_conventions"),
    output:
        "results/{mooring}/logs/conventions.json",
    log:
        "results/{mooring}/logs/conventions.log",
    params:
        **PLAN.params("check_conventions"),
    script:
        "../scripts/conventions.py"


rule conventions:
    """CF, ACDD and OceanSITES against the netCDF files of all moorings."""
    input:
        PLAN.conventions,


rule verify:
    """The manifest against the files; no input, so that nothing is made anew before it is looked at."""
    log:
        "results/logs/verify.log",
    params:
        configured=PLAN.configured,
    script:
        "../scripts/verify.py"
