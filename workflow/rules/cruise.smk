"""The whole cruise: summary, report, manifest with provenance, and verification."""


# On a cluster these run where Snakemake was started: they take seconds each, and wait for all other jobs.
localrules:
    summary,
    cruise_figures,
    report,
    provenance,
    complete,


rule summary:
    """Summarize the cruise, one row per mooring."""
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
    """Draw figures of all moorings: array, deviations, differences from the reference, currents."""
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
    """Write all results to one page that needs no network."""
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
    """Write the manifest from all job records: a Process Run Crate with the hash of every file read or written."""
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
    """End the run after all other jobs, with status 1 if a mooring or calibration was stopped."""
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
    """Check one mooring's netCDF files against CF, ACDD and OceanSITES, in each run if configured."""
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
    """Check the netCDF files of all moorings against CF, ACDD and OceanSITES."""
    input:
        PLAN.conventions,


rule verify:
    """Verify the files against the manifest; without inputs, so that nothing is remade before."""
    log:
        "results/logs/verify.log",
    params:
        configured=PLAN.configured,
    script:
        "../scripts/verify.py"
