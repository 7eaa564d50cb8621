"""Raw files of the demonstration cruise: this rule exists only where config.yaml says demonstration: true."""

for NAME in CRUISE.moorings:

    rule:
        name:
            f"simulate_{NAME}"
        output:
            raw=PLAN.simulated_files(NAME),
            truth=f"truth/{NAME}.csv",
        priority: 1  # all moorings first: one that came last would end on one core
        params:
            name=NAME,
            seed=CRUISE.options.seed,
            code=PLAN.code("simulate.py"),
        conda:
            "../envs/compasslib.yaml"
        log:
            f"results/{NAME}/logs/simulate.log",
        benchmark:
            f"results/{NAME}/benchmarks/simulate.tsv"
        script:
            "../scripts/simulate.py"
