"""From raw exports to a corrected archive: one rule a stage, any cruise folder by --directory.

What a stage reads, writes and is given stands in one table, compasslib/pipeline/plan.py. Snakemake waits for the record
of each job, NAME.json beside NAME.log: a mooring whose files cannot be used has none of its products, its record says why.
"""

import sys
from pathlib import Path

from snakemake.logging import logger
from snakemake.utils import min_version

min_version("9.1")
sys.path.insert(0, str(workflow.current_basedir))  # before a folder of the same name where this is started

from compasslib.config.cruise import load_cruise
from compasslib.errors import InputError
from compasslib.pipeline import guard, plan

try:
    guard.refuse_config(config)
    guard.refuse_prefix(workflow.modifier.path_modifier)
    guard.enter(Path.cwd(), Path(workflow.current_basedir))
    CRUISE = load_cruise(Path.cwd())
    PLAN = plan.plan(CRUISE, Path(workflow.current_basedir) / "workflow/scripts")
    SIMULATED = guard.simulated_names(CRUISE)
    if workflow.exec_mode.name == "DEFAULT":  # a job on a cluster was looked at where it came from
        guard.refuse_links(PLAN.folders())
        SIMULATED = guard.to_simulate(CRUISE, logger.warning)
except InputError as error:
    logger.error(f"error: {error}")
    sys.exit(1)


wildcard_constraints:
    mooring=plan.only(CRUISE.moorings),
    calibration=plan.only(CRUISE.calibrations),
    compass=plan.only(PLAN.compasses.members),
    role="[A-Za-z0-9_.-]+",


BEGUN = []


onstart:
    try:
        BEGUN.append(guard.begin())
    except InputError as error:
        logger.error(f"error: {error}")
        sys.exit(1)


onsuccess:
    logger.info("\n".join(guard.listing(PLAN.jobs, *BEGUN)))


onerror:
    logger.info("\n".join(guard.listing(PLAN.jobs, *BEGUN)))


rule all:
    input:
        PLAN.everything,


include: "workflow/rules/moorings.smk"
include: "workflow/rules/calibrations.smk"
include: "workflow/rules/compasses.smk"
include: "workflow/rules/cruise.smk"


if CRUISE.options.demonstration:

    include: "workflow/rules/demonstration.smk"
