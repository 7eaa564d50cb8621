"""Process a mooring or calibration from raw files to figures in one job, for clusters and for the fewest starts."""

for NAME, RECORDS in PLAN.mooring_jobs().items():

    rule:
        name:
            NAME
        input:
            PLAN.inputs_of(RECORDS),
        output:
            update(RECORDS),
        localrule: workflow.remote_exec  # run directly on the node: a job step would start Snakemake a third time
        threads: CORES
        params:
            jobs=PLAN.described_jobs(RECORDS),
        script:
            "../scripts/mooring.py"
