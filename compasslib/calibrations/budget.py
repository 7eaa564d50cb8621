"""The uncertainty budget of a bench, by the Guide to the Expression of Uncertainty in Measurement.

The rows are those of Le Menn et al. 2023, section 2. A row that is not given is absent, and the result says so. Their
Tables 4 and 5 are printed as pictures: which distribution each row has, and whether it belongs to directions or to
tilts, is taken from the words of the text. Expanded, reference directions have 0.896 degrees (0.90 is printed) and
reference tilts 0.384 (0.40).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from compasslib import angles

FIT_RESIDUAL, MAKER_ACCURACY = "fit_residual", "maker_accuracy_deg"
LE_MENN = "le_menn"
TOO_EXACT_DEG = 1e-4  # rms that no reading of an instrument leaves
PAPER_NT, PAPER_FIELD_NT = (60.0, 75.0), 22000.0  # the field's changes without and with its noise, and its level part
COVERAGE_FACTOR = 2.0  # k of an expanded uncertainty (Le Menn et al. 2023, section 2)
PLATFORM, TILT = "platform", "tilt"


@dataclass(frozen=True)
class Source:
    """One line of an uncertainty budget."""

    name: str  #: key of the row in ``ROWS``
    standard_deg: float  #: standard uncertainty, degrees
    how: str  #: where it comes from, the distribution assumed or the statistics made


@dataclass(frozen=True)
class Row:
    """One line that a budget may have."""

    what: str
    divisor: float  # from the number as it is given to a standard uncertainty
    how: str  # what the number is
    le_menn_deg: float | None = None  # as section 2 gives it
    kinds: tuple[str, ...] = (PLATFORM,)  # of calibrations to whose budget it belongs


STANDARD, EXPANDED = (1.0, "a standard uncertainty"), (2.0, "an expanded uncertainty, k = 2")
AT_MOST = (float(np.sqrt(3.0)), "a largest error, uniform within it")
TRIANGULAR = (float(np.sqrt(6.0)), "a maker's accuracy, triangular within it")

ROWS: dict[str, Row] = {
    "graduation_deg": Row("graduation of the reference directions", *STANDARD, 0.26),
    "slope_deg": Row("slope of the bench", *AT_MOST, 0.18, (PLATFORM, TILT)),
    "ruggedness_deg": Row("ruggedness of the bench", *STANDARD, 0.15, (TILT,)),
    "protractor_deg": Row("protractor of the tilts", *EXPANDED, 0.12, (TILT,)),
    # 0.125 % of a turn, as the paper turns nanoteslas to degrees; ``physical_field`` has the size across its field.
    "field_deg": Row("changes of the field during the calibration", *AT_MOST, 0.45),
    "declination_deg": Row("declination", *AT_MOST, 0.14),
    "homogeneity_deg": Row("homogeneity of the field on the bench", *AT_MOST, 0.38),
    MAKER_ACCURACY: Row("accuracy of the instrument as its maker states it", *TRIANGULAR, None, (PLATFORM, TILT)),
}


def sources(given: Mapping[str, float | None], budget: str | None = None, kind: str = PLATFORM) -> tuple[Source, ...]:
    """List the rows of a budget as standard uncertainties.

    Args:
        given: row -> degrees, as ``ROWS`` describes them; None where absent.
        budget: ``le_menn`` fills the rows that are not given with the numbers of that paper, where it has one.
    """
    made = []
    for name, row in _rows_of(kind).items():
        value, origin = given.get(name), "given"
        if value is None and budget == LE_MENN:
            value, origin = row.le_menn_deg, "Le Menn et al. 2023, section 2"
        if value is not None:
            how = f"{row.what}: {value:g} degrees, {row.how} ({origin})"
            made.append(Source(name, value / row.divisor, how))
    return tuple(made)


def notes(given: Mapping[str, float | None], rows: tuple[Source, ...], kind: str = PLATFORM) -> list[str]:
    """List what a budget lacks, and rows that were given but belong to another kind of calibration."""
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
    """Restate a budget with the angles by which the paper's changes of the field turn a compass."""
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
    """Make the row of the fit itself from the scatter of a reading about the curve, widened for few readings."""
    return Source(FIT_RESIDUAL, scatter_deg, f"scatter about the curve, {dof} degrees of freedom, by Student's t")


def combined(rows: tuple[Source, ...]) -> float:
    """Combine independent rows into one standard uncertainty, degrees; 0 of no rows."""
    return float(np.sqrt(sum(source.standard_deg**2 for source in rows)))


def common(rows: tuple[Source, ...]) -> float:
    """Combine the rows that may turn all headings alike, degrees: not those of a single reading."""
    return combined(tuple(source for source in rows if source.name not in (FIT_RESIDUAL, MAKER_ACCURACY)))


def expanded(rows: tuple[Source, ...]) -> float:
    """Compute the expanded uncertainty (k = 2) of independent rows, degrees."""
    return COVERAGE_FACTOR * combined(rows)


def too_exact(residual_rms_deg: float | None) -> tuple[str, ...]:
    """Warn where a curve leaves no residual; its rms is None or NaN where there is no curve."""
    if residual_rms_deg is None or not residual_rms_deg < TOO_EXACT_DEG:
        return ()
    return (
        "the curve leaves no residual, which no instrument does: one column may have been computed from the other; "
        "the stated uncertainty includes no reading error",
    )
