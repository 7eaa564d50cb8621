"""The whole cruise: what can go on, summary, report, and manifest with provenance."""


# On a cluster these run where Snakemake was started: they take seconds each, and wait for other jobs.
localrules:
    usable,
    summary,
    cruise_figures,
    report,
    provenance,
    complete,


checkpoint usable:
    """List what can go on; for all others write stopped.json in place of their products."""
    input:
        moorings=[f"results/{name}/work/field.json" for name in CRUISE.moorings],
        calibrations=[f"results/calibrations/{name}/work/calibration.json" for name in CRUISE.calibrations],
    output:
        usable="results/usable.json",
        job="results/logs/usable.json",
    log:
        "results/logs/usable.log",
    params:
        **keys(guard.needs(CRUISE, config), [()]),
    script:
        "../scripts/usable.py"


def of_moorings(*files):
    """Return a function that lists files of the moorings that can go on."""
    return lambda wildcards: [f"results/{name}/{file}" for name in usable("moorings") for file in files]


def of_instruments(wildcards):
    """List the records of the instruments of the moorings that can go on."""
    return [f"results/{name}/work/{role}.nc" for name in usable("moorings") for role in MOORINGS.roles(name)]


rule summary:
    """Summarize the cruise, one row per mooring."""
    input:
        usable="results/usable.json",
        files=of_moorings("deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "overlap.nc"),
        fields=of_moorings("work/field.json"),
        records=of_instruments,
    output:
        summary=report("results/summary.csv", caption="../report/summary.rst", category="Cruise"),
        job="results/logs/summary.json",
    log:
        "results/logs/summary.log",
    params:
        **keys(lambda: {"roles": {name: MOORINGS.roles(name) for name in CRUISE.moorings}}, [()]),
    script:
        "../scripts/summary.py"


rule cruise_figures:
    """Draw figures of all moorings: array, deviations, differences from the reference, currents."""
    input:
        deviations=of_moorings("deviation.json"),
        assessments=of_moorings("assessment.json"),
    output:
        figures=report(
            expand("results/figures/{name}.{form}", name=FIGURES["cruise"], form=FORMATS),
            category="Cruise",
        ),
        job="results/logs/cruise_figures.json",
    log:
        "results/logs/cruise_figures.log",
    params:
        **keys(lambda: {"array": settings.array(CRUISE)}, [()]),
    script:
        "../scripts/cruise_figures.py"


def shown(wildcards):
    """List the files of what can go on that the report reads or links to."""
    calibrations = usable("calibrations")
    diagnosed = [name for name in calibrations if name in CALIBRATIONS.diagnosed]
    mooring = ["deviation.json", "diagnosis.json", "assessment.json", "corrected.nc", "overlap.nc"]
    mooring += ["table.csv", "histograms.csv", "work/pictures.json"]
    calibration = ["calibration.json", "table.csv", "points.csv"]
    return [
        *of_instruments(wildcards),
        *files("results/", usable("moorings"), *mooring, figures=FIGURES["mooring"]),
        *files("results/", gridded(), "gridded.nc", "work/sections.json", figures=FIGURES["gridded"]),
        *files("results/calibrations/", calibrations, *calibration),
        *files("results/calibrations/", diagnosed, "diagnosis.json", figures=["diagnosis"]),
        *files("results/compasses/", usable("compasses"), "compass.json", "diagnosis.json", figures=FIGURES["compass"]),
        *files("", ["results"] if CRUISE.moorings else [], "summary.csv", figures=FIGURES["cruise"]),
        *(
            file
            for figures, names in CALIBRATIONS.figures.items()
            for file in files("results/calibrations/", [each for each in names if each in calibrations], figures=figures)
        ),
    ]


rule report:
    """Write all results to one page that needs no network."""
    input:
        records,
        shown=shown,
        usable="results/usable.json",
    output:
        page=report("results/report.html", caption="../report/page.rst", category="Cruise"),
        job="results/logs/report.json",
    log:
        "results/logs/report.log",
    params:
        **keys(lambda: settings.report(CRUISE), [()]),
    script:
        "../scripts/report.py"


rule provenance:
    """Write the manifest from all job records: a Process Run Crate with the hash of every file read or written."""
    input:
        jobs=lambda wildcards: [*records(), "results/logs/usable.json", "results/logs/report.json"],
        settings=[
            local(file) for file in sorted({file for each in settings.configuration(CRUISE).values() for file in each})
        ],
        usable="results/usable.json",
    output:
        manifest="results/ro-crate-metadata.json",
        job="results/logs/provenance.json",
    log:
        "results/logs/provenance.log",
    params:
        **keys(lambda: {"attributes": CRUISE.options.attributes, "configuration": settings.configuration(CRUISE)}, [()]),
    script:
        "../scripts/provenance.py"


rule complete:
    """End the run after all other jobs, with status 1 if a mooring or calibration was stopped."""
    input:
        "results/logs/provenance.json",
        usable="results/usable.json",
    output:
        job="results/logs/complete.json",
    log:
        "results/logs/complete.log",
    params:
        library=LIBRARY,
    script:
        "../scripts/complete.py"
