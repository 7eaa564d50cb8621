"""The whole cruise: what can go on, summary, report, and manifest with provenance.

On a cluster these rules run where Snakemake was started: they take seconds each, and wait for other jobs.
"""


checkpoint usable:
    """List what can go on; for all others write stopped.json in place of their products."""
    input:
        moorings=FIELD_FILES,
        calibrations=CALIBRATION_FILES,
    output:
        usable="results/usable.json",
        job="results/logs/usable.json",
    log:
        "results/logs/usable.log",
    localrule: True
    params:
        **parameters(
            "cruise.usable", lambda: settings.needs(CRUISE) | {"without": WITHOUT, "order": list(CRUISE.moorings)}
        ),
    script:
        "../scripts/stage.py"


rule summary:
    """Summarize the cruise, one row per mooring."""
    input:
        usable="results/usable.json",
        files=of_usable("moorings", "deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "overlap.nc"),
        fields=of_usable("moorings", "work/field.json"),
        records=lambda wildcards: [
            f"results/{name}/work/{role}.nc" for name in usable("moorings") for role in MOORINGS.roles(name)
        ],
    output:
        summary=report("results/summary.csv", caption="../report/summary.rst", category="Cruise"),
        job="results/logs/summary.json",
    log:
        "results/logs/summary.log",
    localrule: True
    params:
        **parameters("cruise.summary", lambda: {"roles": {name: MOORINGS.roles(name) for name in CRUISE.moorings}}),
    script:
        "../scripts/stage.py"


rule cruise_figures:
    """Draw figures of all moorings: map, array, deviations, differences from the reference, currents."""
    input:
        usable="results/usable.json",
        deviations=of_usable("moorings", "deviation.json"),
        assessments=of_usable("moorings", "assessment.json"),
    output:
        figures=reported("results/figures/{name}.{form}", names("cruise"), "Cruise"),
        job="results/logs/cruise_figures.json",
    log:
        "results/logs/cruise_figures.log",
    localrule: True
    params:
        **parameters("figures.cruise_figures", lambda: {"array": settings.array(CRUISE), "formats": FORMATS}),
    script:
        "../scripts/stage.py"


rule report:
    """Write all results to one page, and all series to another to look at; neither needs a network."""
    input:
        results,
        usable="results/usable.json",
    output:
        pages=report(["results/report.html", "results/explore.html"], caption="../report/page.rst", category="Cruise"),
        job="results/logs/report.json",
    log:
        "results/logs/report.log",
    localrule: True
    params:
        **parameters("cruise.report", lambda: settings.report(CRUISE)),
    script:
        "../scripts/stage.py"


rule provenance:
    """Write the manifest from all job records: a Process Run Crate with the hash of every file read or written."""
    input:
        jobs=lambda wildcards: [
            file for file in (*results(), *made_by("usable"), *made_by("report")) if "/logs/" in file
        ],
        settings=local(sorted({file for files in settings.configuration(CRUISE).values() for file in files})),
        usable="results/usable.json",
    output:
        manifest="results/ro-crate-metadata.json",
        job="results/logs/provenance.json",
    log:
        "results/logs/provenance.log",
    localrule: True
    params:
        **parameters(
            "cruise.provenance",
            lambda: {"attributes": CRUISE.options.attributes, "configuration": settings.configuration(CRUISE)},
        ),
    script:
        "../scripts/stage.py"


rule complete:
    """End the run after all other jobs, with status 1 if a mooring or calibration was stopped."""
    input:
        "results/logs/provenance.json",
        usable="results/usable.json",
    output:
        job="results/logs/complete.json",
    log:
        "results/logs/complete.log",
    localrule: True
    params:
        **parameters("cruise.complete"),
    script:
        "../scripts/stage.py"
