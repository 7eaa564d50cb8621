"""Uncertainty budget of a bench, after the Guide to the Expression of Uncertainty in Measurement.

The rows are those of Le Menn et al. 2023, section 2. Rows not given are omitted and reported as missing. Tables
4 and 5 of the paper are images: the distribution of each row, and whether it applies to directions or tilts, are taken
from the text. The expanded uncertainty is 0.896 degrees for reference directions (0.90 is printed) and 0.384
degrees for reference tilts (0.40).
"""

from __future__ import annotations

from collections.abc import Mapping
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


def sources(given: Mapping[str, float | None], budget: str | None = None, kind: str = PLATFORM) -> tuple[Source, ...]:
    """List the rows of a budget, given in degrees as ``ROWS`` describes them, as standard uncertainties.

    The budget ``le_menn`` fills missing rows with the values of that paper, where it has one.
    """
    made = []
    for name, row in _rows_of(kind).items():
        value, origin = given.get(name), "given"
        if value is None and budget == LE_MENN:
            value, origin = row.le_menn_deg, "Le Menn et al. 2023, section 2"
        if value is not None:
            made.append(Source(name, value / row.divisor, f"{row.what}: {value:g} degrees, {row.how} ({origin})"))
    return tuple(made)


def notes(given: Mapping[str, float | None], rows: tuple[Source, ...], kind: str = PLATFORM) -> list[str]:
    """List the missing rows of a budget, and given rows that belong to another kind of calibration."""
    texts = []
    foreign = [name for name, row in ROWS.items() if kind not in row.kinds and given.get(name) is not None]
    if foreign:
        kinds = ", ".join(sorted({other for name in foreign for other in ROWS[name].kinds}))
        texts.append(f"rows of kind {kinds} are not part of this budget and are excluded: {', '.join(foreign)}")
    if absent := [name for name in _rows_of(kind) if name not in {source.name for source in rows}]:
        holds = "only the scatter about the curve" if not rows else "the other rows only"
        texts.append(f"the budget has no row {', '.join(absent)}: the expanded uncertainty includes {holds}")
    return texts


def _rows_of(kind: str) -> dict[str, Row]:
    return {name: row for name, row in ROWS.items() if kind in row.kinds}


def physical_field(rows: tuple[Source, ...], horizontal_nT: float = PAPER_FIELD_NT) -> dict[str, Any]:
    """Recompute a budget with the deflections of a compass by the paper's changes of the field."""
    sizes = [float(angles.direction(change, horizontal_nT)) for change in PAPER_NT]
    others = combined(tuple(row for row in rows if row.name != "field_deg"))
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


def combined(rows: tuple[Source, ...]) -> float:
    """Combine independent rows into one standard uncertainty, degrees; 0 without rows."""
    return float(np.sqrt(sum(source.standard_deg**2 for source in rows)))


def common(rows: tuple[Source, ...]) -> float:
    """Combine the rows that may be common to all headings, excluding those of a single reading, degrees."""
    return combined(tuple(source for source in rows if source.name not in (FIT_RESIDUAL, MAKER_ACCURACY)))


def expanded(rows: tuple[Source, ...]) -> float:
    """Compute the expanded uncertainty (k = 2) of independent rows, degrees."""
    return COVERAGE_FACTOR * combined(rows)
