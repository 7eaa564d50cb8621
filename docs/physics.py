"""The catalogue as a documentation page: ``python docs/physics.py > docs/physics.md``."""

from __future__ import annotations

from dataclasses import fields
from itertools import groupby

from compasslib.effects import CATALOGUE, Effect

HEAD = """# The catalogue of unmodelled effects

Made from `compasslib/effects/` by `python docs/physics.py`. Effects act in this order; only those of side
*compass* enter the headings. *Against* gives what distinguishes an effect from another.
"""
DERIVED = ("flow_", "body_", "reference_s", "reference_c", "reference_f", "excursion_")  # series from those logged


def page() -> str:
    """Format the catalogue as Markdown, one section per effect."""
    sections = groupby(CATALOGUE, lambda term: term.name)
    return "\n".join([HEAD, *(text for name, forms in sections for text in (f"## {name}\n", *map(_form, forms)))])


def _form(form: type[Effect]) -> str:
    others = groupby(form.separated_by, form.separated_by.__getitem__)
    logged = [name for name in form.needs if not name.startswith(DERIVED)]
    lines = [
        f"* {form.side}, on {form.acts_on}{_recordings(form)}{_source(form)}",
        *([f"* needs: {', '.join(logged)}"] if logged else []),
        *(f"* `{f.name}`, {f.metadata['unit']}: {f.metadata['meaning']}" for f in fields(form)),
        *(f"* against {', '.join(names)}: {how}" for how, names in others),
    ]
    return f"{form.__doc__}\n\n" + "\n".join(lines) + "\n"


def _source(form: type[Effect]) -> str:
    return "" if form.literature.startswith("none") else f"; source: {form.literature}"


def _recordings(form: type[Effect]) -> str:
    return "" if form.recordings == ("mooring",) else f", in {', '.join(form.recordings)}"


if __name__ == "__main__":
    print(page(), end="")
