"""What was made from what; and two rules that only look, run by name: verify, conventions."""


rule provenance:
    """Records of all jobs -> manifest with the hash of every file read or written, a Process Run Crate."""
    input:
        products=PRODUCTS,
        settings=sorted({file for files in PLAN.configuration().values() for file in files}),
    output:
        "results/ro-crate-metadata.json",
    params:
        configuration=PLAN.configuration(),
        attributes=CRUISE.options.attributes,
        code=PLAN.code("provenance.py"),
    conda:
        "../envs/compasslib.yaml"
    log:
        "results/logs/provenance.log",
    benchmark:
        "results/benchmarks/provenance.tsv"
    script:
        "../scripts/provenance.py"


rule verify:
    """The manifest against the files; no input, so that nothing is made anew before it is looked at."""
    conda:
        "../envs/compasslib.yaml"
    log:
        "results/logs/verify.log",
    script:
        "../scripts/verify.py"


rule conventions:
    """CF, ACDD and OceanSITES against the netCDF files."""
    input:
        products=expand("results/{mooring}/{file}.nc", mooring=CRUISE.moorings, file=["corrected", "overlap"]),
        records=PLAN.all_records,
    conda:
        "../envs/compasslib.yaml"
    log:
        "results/logs/conventions.log",
    script:
        "../scripts/conventions.py"
