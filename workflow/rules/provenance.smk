"""What was made from what, and whether it still is so; whether the products keep the conventions."""


rule provenance:
    """Records of all jobs -> manifest with the hash of every file read or written, a Process Run Crate."""
    input:
        sorted({file for files in MOORINGS.configuration().values() for file in files}),
        products=PLAN.products,
    output:
        manifest="results/ro-crate-metadata.json",
    params:
        configuration=MOORINGS.configuration(),
        attributes=CRUISE.options.attributes,
        stopped=PLAN.stopped_of,
        code=MOORINGS.code("provenance.py"),
    log:
        "results/logs/provenance.log",
    benchmark:
        "results/benchmarks/provenance.tsv"
    script:
        "../scripts/provenance.py"


rule verify:
    """The manifest against the files; no input, so that nothing is made anew before it is looked at."""
    params:
        configured=PLAN.configured,
    log:
        "results/logs/verify.log",
    script:
        "../scripts/verify.py"


rule conventions:
    """CF, ACDD and OceanSITES against the netCDF files of all moorings."""
    input:
        PLAN.conventions,


rule check_conventions:
    """CF, ACDD and OceanSITES against one mooring's netCDF files; among what each run makes where the options say so."""
    input:
        products=expand("results/{{mooring}}/{file}.nc", file=["corrected", "overlap"]),
        records=MOORINGS.records,
    output:
        conventions="results/{mooring}/conventions.json",
    params:
        code=MOORINGS.code("conventions.py", provenance.installed("compliance-checker")),
    log:
        "results/{mooring}/logs/conventions.log",
    benchmark:
        "results/{mooring}/benchmarks/conventions.tsv"
    script:
        "../scripts/conventions.py"
