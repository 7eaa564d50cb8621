"""What conventions say against a netCDF file: CF and ACDD by an independent checker, OceanSITES by ``oceansites``."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from compasslib import archive_layout, oceansites, provenance
from compasslib.archive_attributes import NOT_GIVEN
from compasslib.archive_files import opened
from compasslib.errors import InputError

CHECKER = "compliance_checker"
CF, ACDD = "cf:1.8", "acdd:1.3"
PRODUCT = "corrected.nc"  # the file that claims ACDD and OceanSITES beside CF
NOT_ASKED = 1  # the checker's weight of what is merely suggested
# The CF table has no name for these: its orientation is from true north, and it knows no deviation and no declination.
UNNAMED = tuple(name for name, variable in archive_layout.CORRECTED.items() if not variable.standard_name)
UNAVOIDABLE = {f'variable "{name}" missing the following attributes: standard_name' for name in UNNAMED}


def installed() -> bool:
    """Return whether the checker of CF and ACDD is there; it comes with the test environment alone."""
    return importlib.util.find_spec(CHECKER) is not None


def checkers() -> dict[str, str]:
    """Return what files are held against here, and by which program."""
    own = {"OceanSITES": f"manual {oceansites.MANUAL}"}
    if not installed():
        return own
    program = f"compliance-checker {provenance.installed('compliance-checker')}"
    return own | {"CF": f"{CF} by {program}", "ACDD": f"{ACDD} by {program}"}


def remarks(path: str | Path) -> list[str]:
    """Return what stands against a file of the archive, each with its convention; what cannot be avoided apart.

    Args:
        path: corrected.nc, or another netCDF file, which claims CF alone.

    Raises:
        InputError: the file is absent or damaged.
    """
    product = Path(path).name == PRODUCT
    found = [f"OceanSITES: {remark}" for remark in oceansites.remarks(path)] if product else []
    if not installed():
        return found
    found += [f"CF: {remark}" for remark in checked(path, CF)]
    asked = set(checked(path, ACDD)) - UNAVOIDABLE if product else set()
    return found + [f"ACDD: {remark}" for remark in sorted(asked)]


def not_given(path: str | Path) -> list[str]:
    """Return the global attributes of corrected.nc that the conventions ask for and the YAML files do not give.

    Args:
        path: the file.
    """
    with opened(path) as nc:
        return [name for name in nc.ncattrs() if nc.getncattr(name) == NOT_GIVEN]


def checked(path: str | Path, checker: str) -> list[str]:
    """Return the errors and warnings of the compliance checker, its suggestions apart.

    Args:
        path: the file.
        checker: name and version of one of its checks, as ``cf:1.8``.
    """
    from compliance_checker.suite import CheckSuite  # heavy, and only in the test environment

    CheckSuite.load_all_available_checkers()
    suite = CheckSuite()
    dataset = suite.load_dataset(str(path))
    groups, errors = suite.run_all(dataset, [checker])[checker]
    dataset.close()
    failed = [group for group in groups if group.value[0] < group.value[1] and group.weight > NOT_ASKED]
    broken = [f"the checker broke in {name}: {error[0]}" for name, error in errors.items()]
    return sorted(f"{group.name} {message}" for group in failed for message in group.msgs) + broken


def tell(paths: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """Say what stands against files, a line each; return what they were held against and what may still be given.

    Args:
        paths: netCDF files.
        say: takes a line.

    Raises:
        InputError: something does.
    """
    found = [f"{path}: {remark}" for path in paths for remark in remarks(path)]
    absent = {path: names for path in paths if (names := not_given(path))}
    for line in [*found, *(f"{path}: attributes may still give {', '.join(names)}" for path, names in absent.items())]:
        say(line)
    if not installed():
        say("CF and ACDD were not checked: compliance-checker is not installed; make check-archive installs it")
    if found:
        advice = "attributes are those of the YAML files; anything else is this program's fault"
        raise InputError(f"{len(paths)} netCDF files", expected="no remark", found=str(len(found)), advice=advice)
    say(f"{len(paths)} netCDF files: no remark by {'CF, ACDD and ' if installed() else ''}OceanSITES")
    return {"no_remark_by": checkers(), "files": list(paths), "attributes_may_still_give": absent}
