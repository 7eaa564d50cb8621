"""Effects that other packages add to the catalogue."""

from __future__ import annotations

from collections.abc import Collection

from compasslib.core import plugins
from compasslib.core.errors import InputError
from compasslib.effects.term import Term


def of_plugins(own: Collection[str]) -> tuple[type[Term], ...]:
    """Return the classes that the installed packages declare, by name.

    Args:
        own: names of the catalogue, which none of them may have.

    Raises:
        InputError: a name that is taken, or something else than an effect of the name that it is declared by.
    """
    return tuple(_term(name, point) for name, point in plugins.points(plugins.EFFECTS, own).items())


def _term(name: str, point: plugins.EntryPoint) -> type[Term]:
    term = plugins.loaded(point)
    if isinstance(term, type) and issubclass(term, Term) and getattr(term, "name", "") == name:
        return term
    where, advice = f"{plugins.package(point)}: {point.value}", "mend the plug-in; docs/howto/plugins.md shows one"
    raise InputError(where, expected=f"a Term whose name is {name!r}", found=repr(term), advice=advice)
