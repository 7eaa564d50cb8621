"""The uncertainty budget of a bench, by the Guide to the Expression of Uncertainty in Measurement.

The rows are those of Le Menn et al. 2023, section 2. A row that is not given is absent, and the result says so. Their
Tables 4 and 5 are printed as pictures: which distribution each row has is taken from the words of the text, and with
their numbers the reference direction comes out at 0.95 degrees expanded where they print 0.90.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

FIT_RESIDUAL, MAKER_ACCURACY = "fit_residual", "maker_accuracy_deg"
LE_MENN = "le_menn"
TOO_EXACT_DEG = 1e-4  # rms that no reading of an instrument leaves
COVERAGE_FACTOR = 2.0  # k of an expanded uncertainty (Le Menn et al. 2023, section 2)


@dataclass(frozen=True)
class Source:
    """One line of an uncertainty budget."""

    name: str
    standard_deg: float  # standard uncertainty, degrees
    how: str  # where it comes from: the distribution assumed or the statistics made


@dataclass(frozen=True)
class Row:
    """One line that a budget may have."""

    what: str
    divisor: float  # from the number as it is given to a standard uncertainty
    how: str  # what the number is
    le_menn_deg: float | None = None  # as section 2 gives it


STANDARD, EXPANDED = (1.0, "a standard uncertainty"), (2.0, "an expanded uncertainty, k = 2")
AT_MOST = (float(np.sqrt(3.0)), "a largest error, uniform within it")
TRIANGULAR = (float(np.sqrt(6.0)), "a maker's accuracy, triangular within it")

ROWS: dict[str, Row] = {
    "graduation_deg": Row("graduation of the reference directions", *STANDARD, 0.26),
    "slope_deg": Row("slope of the bench", *AT_MOST, 0.18),
    "ruggedness_deg": Row("ruggedness of the bench", *STANDARD, 0.15),
    "protractor_deg": Row("protractor", *EXPANDED, 0.12),
    # 60 nT of daily variation as the paper turns it to degrees. Across a field of 22000 nT it would be 0.16 degrees.
    "field_deg": Row("changes of the field during the calibration", *AT_MOST, 0.45),
    "declination_deg": Row("declination", *AT_MOST, 0.14),
    "homogeneity_deg": Row("homogeneity of the field on the bench", *AT_MOST, 0.38),
    MAKER_ACCURACY: Row("accuracy of the instrument as its maker states it", *TRIANGULAR),
}


def sources(given: Mapping[str, float | None], budget: str | None = None) -> tuple[Source, ...]:
    """List the rows of a budget as standard uncertainties.

    Args:
        given: row -> degrees, as ``ROWS`` describes them; None where absent.
        budget: ``le_menn`` fills the rows that are not given with the numbers of that paper, where it has one.
    """
    made = []
    for name, row in ROWS.items():
        value, origin = given.get(name), "given"
        if value is None and budget == LE_MENN:
            value, origin = row.le_menn_deg, "Le Menn et al. 2023, section 2"
        if value is not None:
            how = f"{row.what}: {value:g} degrees, {row.how} ({origin})"
            made.append(Source(name, value / row.divisor, how))
    return tuple(made)


def absent(rows: tuple[Source, ...]) -> list[str]:
    """List the rows that a budget does not have."""
    return [name for name in ROWS if name not in {source.name for source in rows}]


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
