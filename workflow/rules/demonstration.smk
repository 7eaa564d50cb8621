"""Simulation of raw files, only if config.yaml sets demonstration: true and no file has another origin."""

for NAME in SIMULATED:

    rule:
        name:
            f"simulate_{NAME}"
        output:
            raw=SIMULATED[NAME],
            truth=records.truth_file(NAME),
        log:
            f"results/{NAME}/logs/simulate.log",
        priority: 1  # before all other jobs: a mooring simulated last would end on one core
        params:
            files={"reads": {}, "writes": {"raw": SIMULATED[NAME], "truth": records.truth_file(NAME)}},
            name=NAME,
            seed=CRUISE.options.seed,
            code=PLAN.code("simulate"),
        script:
            "../scripts/simulate.py"


if PLAN.concealed:

    localrules:
        concealed,

    rule concealed:
        """Compare the diagnoses of the moorings C1, C2, ... with the truth, which no other rule reads."""
        input:
            PLAN.inputs("concealed"),
        output:
            report("results/concealed.html", caption="../report/page.rst", category="Cruise"),
            "results/logs/concealed.json",
        log:
            "results/logs/concealed.log",
        params:
            **PLAN.params("concealed"),
        script:
            "../scripts/concealed.py"
