"""Functions of the rules: their parameters, and files that depend on the configuration or on the checkpoint."""


def parameters(arguments, subjects):
    """Compose the parameters of a rule: one "key=value" for each key that it uses, and the hash of the library."""
    return keys.parameters(arguments, subjects) | {"library": LIBRARY}


def usable(kind):
    """List the moorings, calibrations or compasses that can go on, by the checkpoint; in a dry run by the last one."""
    if workflow.dryrun:  # so that it lists all jobs, not only those before the checkpoint
        last = Path("results/usable.json")
        reasons = json.loads(last.read_text())[kind] if last.is_file() else {}
        configured = {"moorings": CRUISE.moorings, "calibrations": CRUISE.calibrations, "compasses": COMPASSES.members}
        left_out = WITHOUT.get(kind, [])
        return [name for name in configured[kind] if reasons.get(name) is None and name not in left_out]
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
    both = [usable(kind) for kind in ("moorings", "calibrations")]
    return [
        [name for name in names if name in can_go_on]
        for can_go_on, names in zip(both, COMPASSES.members[wildcards.compass])
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


def calibration_figures(name):
    """Name the rule that draws the figures of a calibration."""
    return next(f"calibration_figures_{'_'.join(each)}" for each, of in CALIBRATIONS.figures.items() if name in of)


def jobs():
    """List rule and wildcards of all jobs of the moorings, calibrations and compasses that can go on, but the pages."""
    moorings, calibrations = usable("moorings"), usable("calibrations")
    gridded = {name: files for name, files in MOORINGS.gridded.items() if set(MOORINGS.parts(name)) & set(moorings)}
    checked = dict.fromkeys([*moorings, *gridded]) if CRUISE.options.conventions.check else ()
    diagnosed = [name for name in calibrations if name in CALIBRATIONS.diagnosed]
    of_moorings = ("overlap", "fit", "diagnose", "correct", "compare", "figures")
    return [
        *((f"simulate_{name}", {}) for name in moorings if name in SIMULATED),
        *(("read", {"mooring": name, "role": role}) for name in moorings for role in MOORINGS.roles(name)),
        *((rule, {"mooring": name}) for name in moorings for rule in of_moorings),
        *(("diagnose_alone", {"mooring": name}) for name in moorings if name in COMPASSES.moorings),
        *(("grid_with_daily_means" if files[1:] else "grid", {"mooring": name}) for name, files in gridded.items()),
        *(("sections", {"mooring": name}) for name in gridded),
        *(("check_conventions", {"mooring": name}) for name in checked),
        *((rule, {"calibration": name}) for name in calibrations for rule in ("calibrate", "compare_calibrations")),
        *((calibration_figures(name), {"calibration": name}) for name in calibrations),
        *(("diagnose_calibration", {"calibration": name}) for name in diagnosed),
        *((rule, {"compass": name}) for name in usable("compasses") for rule in ("combine_records", "joined_figures")),
        *((rule, {}) for rule in ("summary", "cruise_figures") if CRUISE.moorings),
        *(("concealed", {}) for _ in CONCEALED[:1]),
    ]


def made_by(rule, **of):
    """List the outputs of a job by their names in the cruise, wherever a storage plug-in keeps them."""
    return [str(file).removeprefix(f"{STORED}/").format(**of) for file in getattr(rules, rule).output]


def results(wildcards=None):
    """List all files of these jobs below results/, which does not hold the truth of simulations."""
    return [file for rule, of in jobs() for file in made_by(rule, **of) if file.startswith("results/")]


def records():
    """List the records of these jobs."""
    return [file for file in results() if "/logs/" in file]


def before_checkpoint(wildcards):
    """List the files up to the checkpoint, which a failed job may have left without those after it."""
    read = [f"results/{name}/work/{role}.nc" for name, role in INSTRUMENTS if name not in WITHOUT["moorings"]]
    return [*read, *FIELDS, *CURVES]


def everything(wildcards):
    """List all files: Snakemake makes a deleted one again only if it is an input of the target."""
    return [*results(), *(file for rule in ("usable", "report", "provenance", "complete") for file in made_by(rule))]
