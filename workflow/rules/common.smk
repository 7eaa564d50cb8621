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


def records(wildcards=None):
    """List the records of all jobs of the moorings, calibrations and compasses that can go on, and of their figures."""
    moorings, calibrations = usable("moorings"), usable("calibrations")
    gridded = [name for name in MOORINGS.gridded if set(MOORINGS.parts(name)) & set(moorings)]
    checked = dict.fromkeys([*moorings, *gridded]) if CRUISE.options.conventions.check else ()
    diagnosed = [name for name in calibrations if name in CALIBRATIONS.diagnosed]
    stages = [
        *((name, "simulate") for name in moorings if name in SIMULATED),
        *((name, f"read_{role}") for name in moorings for role in MOORINGS.roles(name)),
        *(
            (name, stage)
            for name in moorings
            for stage in ("overlap", "fit", "diagnose", "correct", "compare", "figures")
        ),
        *((name, stage) for name in gridded for stage in ("grid", "sections")),
        *((name, "conventions") for name in checked),
        *((f"calibrations/{name}", stage) for name in calibrations for stage in ("calibrate", "compare", "figures")),
        *((f"calibrations/{name}", stage) for name in diagnosed for stage in ("diagnose", "diagnosis_figure")),
        *((f"compasses/{name}", stage) for name in usable("compasses") for stage in ("combine_records", "figures")),
        *((".", stage) for stage in ("summary", "cruise_figures") if CRUISE.moorings),
        *((".", "concealed") for _ in CONCEALED[:1]),
    ]
    return [str(Path("results", folder, "logs", f"{stage}.json")) for folder, stage in stages]
