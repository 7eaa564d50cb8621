"""Readers and effects of other packages, by the entry points that those declare; the house's own tables come first.

A package names each under ``compasslib.readers`` or ``compasslib.effects`` in its pyproject.toml; docs/howto/plugins.md
shows one. Only names and versions are looked at before one is used.
"""

from __future__ import annotations

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
    """Return the entry points of a group, whatever their names, in the order of names."""
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, package_version(point))))


def plugin_table(group: str, builtin: Collection[str]) -> Points:
    """Collect the entries that other packages add to a table, by name in the order of names.

    Args:
        builtin: names in the library's own table.

    Raises:
        InputError: a name that is taken, by the house or by another package.
    """
    table: Points = {}
    for point in declared_plugins(group):
        taken = (
            "compasslib" if point.name in builtin else package_version(table[point.name]) if point.name in table else ""
        )
        if taken:
            expected, shown = f"a name that {taken} does not use", f"{point.name!r}"
            raise InputError(
                f"{package_version(point)}: {group}", expected=expected, found=shown, advice="rename or remove it"
            )
        table[point.name] = point
    return table


def load_plugin(point: EntryPoint) -> Any:
    """Return the object that an entry point names.

    Raises:
        InputError: it cannot be imported.
    """
    with plugin_errors(point, "an importable plug-in"):
        return point.load()


@contextmanager
def plugin_errors(point: EntryPoint, expected: str) -> Iterator[None]:
    """Turn whatever a plug-in raises in the block into one line, ``SystemExit`` too; Ctrl-C stays what it is.

    Raises:
        InputError: the plug-in's own, or one that names package, error and the line of code that raised it.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except (
        BaseException
    ) as error:  # somebody else's code: anything, and SystemExit(0) would end a run as if it were done
        if type(error) is KeyboardInterrupt:
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        shown = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
        where, advice = f"{package_version(point)}: {point.value}", "mend or remove the package"
        raise InputError(where, expected=expected, found=shown, advice=advice) from error


def plugin_packages() -> tuple[str, ...]:
    """Return name and version of each package that adds something, in the order of names."""
    return tuple(sorted({package_version(point) for group in (READERS, EFFECTS) for point in declared_plugins(group)}))


def package_version(point: EntryPoint) -> str:
    """Return name and version of the package that declares an entry point."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def code_identity(point: EntryPoint) -> str:
    """Return the package with a hash of its code, which changes where the version was forgotten too."""
    spec = find_spec(point.module.partition(".")[0])
    folders = spec.submodule_search_locations if spec else None
    files = [path for folder in folders or () for path in Path(folder).rglob("*.py")]
    files += [Path(spec.origin)] if spec and spec.origin and not folders else []
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files)))
    return f"{package_version(point)} ({point.name}, sha256 {digest.hexdigest()[:12]})"
