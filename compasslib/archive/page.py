"""The variables of corrected.nc as the table of docs/reference/product.md: ``python -m compasslib.archive.page``."""

from __future__ import annotations

from compasslib.archive import layout
from compasslib.archive.layout import Variable

HEAD = ("| variable | dimensions | unit | what it is |", "|---|---|---|---|")
PLACED = (layout.TIME, layout.BIN, layout.BEAM, layout.LATITUDE, layout.LONGITUDE, layout.STATION)


def table() -> str:
    """Return the variables as Markdown, a row each."""
    rows = [*map(_row, PLACED), *(_row(one, one.name in layout.FLAGGED) for one in layout.CORRECTED.values())]
    return "\n".join([*HEAD, *rows, ""])


def _row(variable: Variable, flagged: bool = False) -> str:
    said = [f"{variable.long_name}.", variable.comment]
    said += [f"From {variable.reference}." if variable.reference in (layout.TRUE, layout.MAGNETIC) else ""]
    said += [f"`{variable.standard_name}`." if variable.standard_name else ""]
    said += ["*Flagged.*" if flagged else "", "*If measured.*" if variable.name in layout.PERHAPS else ""]
    what, dimensions = " ".join(filter(None, said)), ", ".join(variable.dimensions) or "-"
    return f"| `{variable.name}` | {dimensions} | {variable.units or '-'} | {what} |"


if __name__ == "__main__":
    print(table(), end="")
