"""A mooring or a calibration, from raw files to figures, as one job: what clusters want, and the fewest starts."""

for NAME, RECORDS in PLAN.mooring_jobs().items():

    rule:
        name:
            NAME
        input:
            PLAN.inputs_of(RECORDS),
        output:
            update(RECORDS),
        localrule: workflow.remote_exec  # on its node it runs at once: a step would start Snakemake a third time
        threads: CORES
        params:
            jobs=PLAN.described_jobs(RECORDS),
        script:
            "../scripts/mooring.py"
