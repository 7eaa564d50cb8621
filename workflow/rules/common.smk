"""Functions of the rules: their parameters, and files that depend on the configuration or on the checkpoint."""


def keys(arguments, subjects):
    """Compose the parameters of a rule: one "key=value" for each key that it uses, and the hash of the library."""
    return settings.parameters(arguments, subjects) | {"library": LIBRARY}


def usable(kind):
    """List the moorings, calibrations or compasses that can go on, by the checkpoint."""
    with checkpoints.usable.get().output.usable.open() as stream:
        return [name for name, reason in json.load(stream)[kind].items() if reason is None]


def group_of_mooring(wildcards):
    """Name the group of jobs, for clusters: before the join of a shared compass, or the rest of a mooring."""
    stage = "alone" if wildcards.mooring in COMPASSES.moorings else "mooring"
    return guard.group(stage, wildcards.mooring)


def calibration_files(names):
    """List the files of calibrations that others use, by their names."""
    return [f"results/calibrations/{name}/calibration.json" for name in names]


def members(wildcards):
    """List the moorings and the calibrations of a compass that can go on."""
    return [
        [name for name in names if name in usable(kind)]
        for kind, names in zip(("moorings", "calibrations"), COMPASSES.members[wildcards.compass])
    ]


def of_moorings(*files):
    """Return a function that lists files of the moorings that can go on."""
    return lambda wildcards: [f"results/{name}/{file}" for name in usable("moorings") for file in files]


def parts(wildcards):
    """List the affected instruments of a mooring that can go on."""
    can_go_on = usable("moorings")
    return [part for part in MOORINGS.parts(wildcards.mooring) if part in can_go_on]


def of_parts(file):
    """Return a function that lists one file of each affected instrument of a mooring that can go on."""
    return lambda wildcards: [f"results/{part}/{file}" for part in parts(wildcards)]


def archived(name):
    """List the netCDF files of a mooring: products, gridded ones if configured, and records of its instruments."""
    products = [f"results/{name}/{file}" for file in ("corrected.nc", "overlap.nc") if name in CRUISE.moorings]
    gridded = [f"results/{name}/{file}" for file in MOORINGS.gridded.get(name, [])]
    roles = MOORINGS.roles(name) if name in CRUISE.moorings else []
    return [*products, *gridded, *(f"results/{name}/work/{role}.nc" for role in roles)]


def results(wildcards=None):
    """List all results of what can go on: Snakemake makes a deleted file again only if it is asked for."""
    moorings, calibrations = usable("moorings"), usable("calibrations")
    gridded = [name for name in MOORINGS.gridded if set(MOORINGS.parts(name)) & set(moorings)]
    daily = [name for name in gridded if MOORINGS.gridded[name][1:]]
    checked = list(dict.fromkeys([*moorings, *gridded])) if CRUISE.options.conventions.check else []
    each = [rules.overlap, rules.fit, rules.diagnose, rules.correct, rules.compare, rules.figures]
    made = [(rule, "mooring", moorings) for rule in each]
    made += [(rules.diagnose_alone, "mooring", [name for name in moorings if name in COMPASSES.moorings])]
    made += [(rules.grid, "mooring", gridded), (rules.grid_with_daily_means, "mooring", daily)]
    made += [(rules.sections, "mooring", gridded), (rules.check_conventions, "mooring", checked)]
    made += [(rule, "calibration", calibrations) for rule in (rules.calibrate, rules.compare_calibrations)]
    searched = [name for name in calibrations if name in CALIBRATIONS.diagnosed]
    made += [(rule, "calibration", searched) for rule in (rules.diagnose_calibration, rules.diagnosis_figure)]
    made += [(drawn_by(name), "calibration", [name]) for name in calibrations]
    made += [(rule, "compass", usable("compasses")) for rule in (rules.combine_records, rules.joined_figures)]
    files = [file for rule, kind, names in made for file in expand(rule.output, **{kind: names})]
    files += [file for name in moorings for file in expand(rules.read.output, mooring=name, role=MOORINGS.roles(name))]
    files += [file for rule in (rules.summary, rules.cruise_figures) if CRUISE.moorings for file in rule.output]
    files += [f"results/{name}/logs/simulate.json" for name in moorings if name in SIMULATED]
    return list(dict.fromkeys([*files, *(["results/logs/concealed.json"] if CONCEALED else [])]))


def drawn_by(name):
    """Return the rule that draws the figures of a calibration."""
    return next(getattr(rules, figures_rule(figures)) for figures, of in CALIBRATIONS.figures.items() if name in of)


def figures_rule(figures):
    """Name the rule that draws these figures of calibrations."""
    return f"calibration_figures_{'_'.join(figures)}"


def records(wildcards=None):
    """List the records of the jobs behind all results."""
    return [file for file in results() if "/logs/" in file]
