"""Raw files of the demonstration cruise: rules only where config.yaml says demonstration: true, and no file is another's."""

for NAME in SIMULATED:

    rule:
        name:
            f"simulate_{NAME}"
        output:
            raw=SIMULATED[NAME],
            truth=f"truth/{NAME}.csv",
        log:
            f"results/{NAME}/logs/simulate.log",
        benchmark:
            f"results/{NAME}/benchmarks/simulate.tsv"
        priority: 1  # all moorings first: one that came last would end on one core
        params:
            files={"reads": {}, "writes": {"raw": SIMULATED[NAME], "truth": f"truth/{NAME}.csv"}},
            name=NAME,
            seed=CRUISE.options.seed,
            code=PLAN.code("simulate"),
        script:
            "../scripts/simulate.py"
