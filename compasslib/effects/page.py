"""The catalogue as a documentation page: ``python -m compasslib.effects.page > docs/physics.md``."""

from __future__ import annotations

import inspect
from dataclasses import fields
from itertools import groupby

from compasslib.effects import CATALOGUE, Effect

HEAD = """# The catalogue of unmodelled effects

Made from `compasslib/effects/` by `python -m compasslib.effects.page`; a test fails where it is stale. Effects act in
this order. *Side* says what an effect may change: only those of the compass enter the corrected headings.
"""


def page() -> str:
    """Format the catalogue as Markdown, one section per effect."""
    sections = groupby(CATALOGUE, lambda term: term.name)
    return "\n".join([HEAD, *(text for name, forms in sections for text in (f"## {name}\n", *map(_form, forms)))])


def _form(form: type[Effect]) -> str:
    lines = [
        " ".join((inspect.getdoc(form) or "").split()),
        f"* side: {form.side}; acts on: {form.acts_on}; stage: {form.stage}",
        f"* source: {form.literature}",
        *([f"* needs: {', '.join(form.needs)}"] if form.needs else []),
        *(f"* `{f.name}`, {f.metadata['unit']}: {f.metadata['meaning']}" for f in fields(form)),
        *(f"* distinguished from {other} by: {how}" for other, how in form.separated_by.items()),
    ]
    return lines[0] + "\n\n" + "\n".join(lines[1:]) + "\n"


if __name__ == "__main__":
    print(page(), end="")
