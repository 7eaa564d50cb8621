"""Functions of the rules: their parameters, and files that depend on the configuration or on the checkpoint."""


def parameters(stage, arguments=dict, subjects=((),)):
    """Compose the parameters of a rule: its stage, one "key=value" for each key used, and the hash of the library."""
    return {"stage": stage, "library": LIBRARY} | job.parameters(arguments, subjects)


@cache
def not_stopped(kind, reasons):
    """Map the names that can go on to None, by the text of the checkpoint's file."""
    configured = {"moorings": CRUISE.moorings, "calibrations": CRUISE.calibrations, "compasses": CRUISE.compasses}
    stopped = {name for name, reason in json.loads(reasons)[kind].items() if reason is not None}
    stopped |= {*WITHOUT.get(kind, [])}
    return dict.fromkeys(name for name in configured[kind] if name not in stopped)


def usable(kind):
    """List the moorings, calibrations or compasses that can go on, by the checkpoint; in a dry run by the last one."""
    if workflow.dryrun:  # so that it lists all jobs, not only those before the checkpoint
        last = Path("results/usable.json")
        return not_stopped(kind, last.read_text() if last.is_file() else json.dumps({kind: {}}))
    with checkpoints.usable.get().output.usable.open() as stream:
        return not_stopped(kind, stream.read())


def group_of_mooring(wildcards, stage=None):
    """Name the group of jobs, for clusters: reading, before the join of a shared compass, or the rest of a mooring."""
    stage = stage or ("alone" if wildcards.mooring in COMPASSES.moorings else "mooring")
    return f"{stage}_{wildcards.mooring.partition('/')[0]}"  # of all affected instruments together


def of_usable(kind, *files, among=None):
    """Return an input function that lists files of the moorings or calibrations that can go on: of all, or of some."""
    folder = {"moorings": "results", "calibrations": "results/calibrations"}[kind]

    def listed(wildcards):
        can_go_on = usable(kind)
        names = [name for name in among(*wildcards) if name in can_go_on] if among else can_go_on
        return [f"{folder}/{name}/{file}" for name in names for file in files]

    return listed


def reported(files, names, category, subcategory=None):
    """List figures by their names in all formats, for a category of Snakemake's report."""
    listed = expand(files, name=names, form=FORMATS, allow_missing=True)
    return report(listed, category=category, subcategory=subcategory)


def made_by(rule, **of):
    """List the outputs of a job by their names in the cruise, wherever a storage plug-in keeps them."""
    return [str(file).removeprefix(f"{STORAGE_ROOT}/").format(**of) for file in getattr(rules, rule).output]


def results(wildcards=None):
    """List all files of moorings, calibrations and compasses that can go on, without the pages of the cruise."""
    moorings, calibrations = usable("moorings"), usable("calibrations")
    gridded = {name: files for name, files in MOORINGS.gridded.items() if set(MOORINGS.parts(name)) & set(moorings)}
    of_moorings = ("overlap", "fit", "diagnose", "correct", "figures")
    jobs = [
        *(("read", {"mooring": name, "role": role}) for name in moorings for role in MOORINGS.roles(name)),
        *((rule, {"mooring": name}) for name in moorings for rule in of_moorings),
        *(("diagnose_alone", {"mooring": name}) for name in moorings if name in COMPASSES.moorings),
        *(("grid_with_daily_means" if files[1:] else "grid", {"mooring": name}) for name, files in gridded.items()),
        *(("sections", {"mooring": name}) for name in gridded),
        *(("join_site", {"site": site}) for site, names in MOORINGS.sites.items() if set(names) & set(gridded)),
        *((rule, {"calibration": name}) for name in calibrations for rule in ("calibrate", "compare_calibrations")),
        *(("diagnose_calibration", {"calibration": name}) for name in CALIBRATIONS.diagnosed if name in calibrations),
        *((rule, {"compass": name}) for name in usable("compasses") for rule in ("combine_records", "joined_figures")),
        *((rule, {}) for rule in ("summary", "cruise_figures") if CRUISE.moorings),
        *((rule, {}) for rule in ("recordings", "concealed") if CONCEALED),
    ]
    # Of rules that are named in a loop, which Snakemake 9.1 does not find by their names.
    files = [f"results/{name}/logs/simulate.json" for name in moorings if name in SIMULATED]
    for figures, names in CALIBRATIONS.figures.items():
        made = ["logs/figures.json", *expand("figures/{name}.{form}", name=figures, form=FORMATS)]
        files += [f"results/calibrations/{name}/{file}" for name in names if name in calibrations for file in made]
    return files + [file for rule, of in jobs for file in made_by(rule, **of)]


def everything(wildcards):
    """List all files: Snakemake makes a deleted one again only if it is an input of the target."""
    return [*results(), *(file for rule in ("usable", "report", "provenance", "complete") for file in made_by(rule))]
