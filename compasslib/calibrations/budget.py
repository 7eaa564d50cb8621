"""Uncertainty budget of a bench, after the Guide to the Expression of Uncertainty in Measurement.

The rows are those of Le Menn et al. 2023, section 2, whose tables are images: distributions are taken from the text.
Expanded: 0.896 degrees for reference directions (0.90 is printed), 0.384 degrees for reference tilts (0.40).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from compasslib import angles

FIT_RESIDUAL, MAKER_ACCURACY = "fit_residual", "maker_accuracy_deg"
LE_MENN = "le_menn"
PAPER_NT, PAPER_FIELD_NT = (60.0, 75.0), 22000.0  # field changes without and with noise, and horizontal field
COVERAGE_FACTOR = 2.0  # k of an expanded uncertainty (Le Menn et al. 2023, section 2)
PLATFORM, TILT = "platform", "tilt"


@dataclass(frozen=True)
class Source:
    """One row of an uncertainty budget."""

    name: str  #: name of the row, such as a key of ``ROWS``
    standard_deg: float  #: standard uncertainty, degrees
    how: str  #: its origin, the assumed distribution or the statistical estimate


@dataclass(frozen=True)
class Row:
    """Definition of a row that a budget may have."""

    what: str
    divisor: float  # converts the given number to a standard uncertainty
    how: str  # meaning of the given number
    le_menn_deg: float | None = None  # value in section 2
    kinds: tuple[str, ...] = (PLATFORM,)  # kinds of calibration to which it applies


STANDARD, EXPANDED = (1.0, "a standard uncertainty"), (2.0, "an expanded uncertainty, k = 2")
AT_MOST = (float(np.sqrt(3.0)), "a largest error, uniform within it")
TRIANGULAR = (float(np.sqrt(6.0)), "a maker's accuracy, triangular within it")

ROWS: dict[str, Row] = {
    "graduation_deg": Row("graduation of the reference directions", *STANDARD, 0.26),
    "slope_deg": Row("slope of the bench", *AT_MOST, 0.18, (PLATFORM, TILT)),
    "ruggedness_deg": Row("ruggedness of the bench", *STANDARD, 0.15, (TILT,)),
    "protractor_deg": Row("protractor of the tilts", *EXPANDED, 0.12, (TILT,)),
    # 0.125 % of a turn, as the paper converts nanoteslas to degrees; ``physical_field`` has the deflection instead.
    "field_deg": Row("changes of the field during the calibration", *AT_MOST, 0.45),
    "declination_deg": Row("declination", *AT_MOST, 0.14),
    "homogeneity_deg": Row("homogeneity of the field on the bench", *AT_MOST, 0.38),
    MAKER_ACCURACY: Row("accuracy of the instrument as its maker states it", *TRIANGULAR, None, (PLATFORM, TILT)),
}


def sources(
    given: Mapping[str, float | None], budget: str | None = None, kind: str = PLATFORM
) -> tuple[tuple[Source, ...], list[str]]:
    """List the rows of a budget as standard uncertainties, with notes on missing rows and on those of another kind.

    ``given`` is in degrees, in the sense of ``ROWS``; the budget ``le_menn`` fills other rows with that paper's values.
    """
    made, absent, foreign = [], [], []
    for name, row in ROWS.items():
        value, origin = given.get(name), "given"
        if kind not in row.kinds:
            foreign += [name] if value is not None else []
            continue
        if value is None and budget == LE_MENN:
            value, origin = row.le_menn_deg, "Le Menn et al. 2023, section 2"
        if value is None:
            absent.append(name)
        else:
            made.append(Source(name, value / row.divisor, f"{row.what}: {value:g} degrees, {row.how} ({origin})"))
    notes = []
    if foreign:
        notes.append(f"rows that are not of kind {kind} are excluded from the budget: {', '.join(foreign)}")
    if absent:
        holds = "the other rows only" if made else "only the scatter about the curve"
        notes.append(f"the budget has no row {', '.join(absent)}: the expanded uncertainty includes {holds}")
    return tuple(made), notes


def physical_field(rows: Sequence[Source], horizontal_nT: float = PAPER_FIELD_NT) -> dict[str, Any]:
    """Recompute a budget with the deflections of a compass by the paper's changes of the field."""
    sizes = [float(angles.direction(change, horizontal_nT)) for change in PAPER_NT]
    others = combined([row for row in rows if row.name != "field_deg"])
    totals = [COVERAGE_FACTOR * float(np.hypot(others, size / AT_MOST[0])) for size in sizes]
    text = (
        f"The 0.45 degrees of the field (Le Menn et al. 2023) are 0.125 % of a turn. {PAPER_NT[0]:g} to "
        f"{PAPER_NT[1]:g} nT across {horizontal_nT:.0f} nT turn a compass by {sizes[0]:.2f} to {sizes[1]:.2f} degrees: "
        f"with these the expanded uncertainty is {totals[0]:.2f} to {totals[1]:.2f} instead of {expanded(rows):.2f} "
        "degrees."
    )
    return {"field_deg": sizes, "expanded_deg": totals, "text": text}


def residual(scatter_deg: float, dof: int) -> Source:
    """Make the row of the fit from the scatter of a reading about the curve, already inflated for few readings."""
    return Source(FIT_RESIDUAL, scatter_deg, f"scatter about the curve, {dof} degrees of freedom, by Student's t")


def combined(rows: Sequence[Source]) -> float:
    """Combine independent rows into one standard uncertainty, degrees; 0 without rows."""
    return float(np.sqrt(sum(source.standard_deg**2 for source in rows)))


def common(rows: Sequence[Source]) -> float:
    """Combine the rows that may be common to all headings, excluding those of a single reading, degrees."""
    return combined([source for source in rows if source.name not in (FIT_RESIDUAL, MAKER_ACCURACY)])


def expanded(rows: Sequence[Source]) -> float:
    """Compute the expanded uncertainty (k = 2) of independent rows, degrees."""
    return COVERAGE_FACTOR * combined(rows)
