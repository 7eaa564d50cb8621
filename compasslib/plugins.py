"""Readers and effects of other packages, found by their entry points; the library's own tables take precedence.

A package declares each under ``compasslib.readers`` or ``compasslib.effects`` in its pyproject.toml, see
docs/howto/plugins.md. Before a plug-in is used, only its name and version are read.
"""

import hashlib
import traceback
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from compasslib.errors import InputError

READERS, EFFECTS = "compasslib.readers", "compasslib.effects"
Points = dict[str, EntryPoint]


@cache
def declared_plugins(group: str) -> tuple[EntryPoint, ...]:
    """List all entry points of a group, sorted by name."""
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, package_version(point))))


def plugin_table(group: str, builtin: Collection[str]) -> Points:
    """Collect the entries that other packages add to the library's own table, sorted by name, each used once.

    Raises:
        InputError: a name is already used by the library or by another package.
    """
    table: Points = {}
    owners = dict.fromkeys(builtin, "compasslib")
    for point in declared_plugins(group):
        package = package_version(point)
        if point.name in owners:
            where, expected = f"{package}: {group}", f"a name that {owners[point.name]} does not use"
            raise InputError(where, expected=expected, found=f"{point.name!r}", advice="rename or remove it")
        table[point.name], owners[point.name] = point, package
    return table


def load_plugin(point: EntryPoint) -> Any:
    """Load the object that an entry point refers to; InputError where it cannot be imported."""
    with plugin_errors(point, "an importable plug-in"):
        return point.load()


@contextmanager
def plugin_errors(point: EntryPoint, expected: str) -> Iterator[None]:
    """Convert exceptions of a plug-in in the block to an InputError with package, error and line of code."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except (Exception, SystemExit) as error:  # SystemExit(0) would end a run as if it had succeeded
        last = traceback.extract_tb(error.__traceback__)[-1]
        shown = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
        where, advice = f"{package_version(point)}: {point.value}", "mend or remove the package"
        raise InputError(where, expected=expected, found=shown, advice=advice) from error


def plugin_packages() -> tuple[str, ...]:
    """List name and version of each package that provides a plug-in, sorted by name."""
    return tuple(sorted({package_version(point) for group in (READERS, EFFECTS) for point in declared_plugins(group)}))


def package_version(point: EntryPoint) -> str:
    """Return name and version of the package that declares an entry point."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def code_identity(point: EntryPoint) -> str:
    """Return package, version and hash of its code, which changes even if the version was not updated."""
    spec = find_spec(point.module.partition(".")[0])
    folders = spec.submodule_search_locations if spec else None
    files = [path for folder in folders or () for path in Path(folder).rglob("*.py")]
    files += [Path(spec.origin)] if spec and spec.origin and not folders else []
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files)))
    return f"{package_version(point)} ({point.name}, sha256 {digest.hexdigest()[:12]})"
