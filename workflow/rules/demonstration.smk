"""Simulation of raw files, only if config.yaml sets demonstration: true and no file has another origin."""

for NAME in SIMULATED:

    rule:
        name:
            f"simulate_{NAME}"
        output:
            raw=SIMULATED[NAME],
            truth=guard.truth_file(NAME),
            job=f"results/{NAME}/logs/simulate.json",
        log:
            f"results/{NAME}/logs/simulate.log",
        priority: 1  # before all other jobs: a mooring simulated last would end on one core
        params:
            **parameters("read.simulate", lambda name=NAME: {"name": name, "seed": CRUISE.options.seed}),
        script:
            "../scripts/stage.py"


if CONCEALED:

    rule recordings:
        """Diagnose real recordings, one correction of which is withheld."""
        output:
            made="results/recordings.json",
            job="results/logs/recordings.json",
        log:
            "results/logs/recordings.log",
        priority: 1  # it takes as long as five moorings, on one core
        params:
            **parameters("demonstration.recordings"),
        script:
            "../scripts/stage.py"


    rule concealed:
        """Compare the diagnoses of the moorings C1, C2, ... with the truth, which no other rule reads."""
        input:
            recordings="results/recordings.json",
            truths=[guard.truth_file(name) for name in CONCEALED],
            corrected=of_usable("moorings", "corrected.nc", among=lambda: CONCEALED),
            diagnoses=of_usable("moorings", "deviation.json", "diagnosis.json", among=lambda: CONCEALED),
            shown=of_usable("moorings", "overlap.nc", "work/pictures.json", among=lambda: CONCEALED),
        output:
            page=report("results/concealed.html", caption="../report/page.rst", category="Cruise"),
            job="results/logs/concealed.json",
        log:
            "results/logs/concealed.log",
        localrule: True
        params:
            **parameters("demonstration.concealed"),
        script:
            "../scripts/stage.py"
