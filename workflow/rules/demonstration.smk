"""Raw files of the demonstration cruise: rules only where config.yaml says demonstration: true, and no file is another's."""

for NAME in SIMULATED:

    rule:
        name:
            f"simulate_{NAME}"
        output:
            raw=SIMULATED[NAME],
            truth=records.truth_file(NAME),
        log:
            f"results/{NAME}/logs/simulate.log",
        priority: 1  # all moorings first: one that came last would end on one core
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
        """The only rule that reads the truth: what was said of the moorings C1, C2, ... beside what was planted."""
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
