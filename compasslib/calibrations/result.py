"""Result of a calibration of any kind: uncertainty budget, calibration.json, and comparison with other calibrations.

The rows of the budget are those of Le Menn et al. 2023, section 2, whose tables are images: distributions are taken
from the text. The paper lets the influence of an object fall as the square of the distance, that of a dipole falls
as the cube.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.deviation.model import weak_field_warnings
from compasslib.earthfield import resolve_settings
from compasslib.types import Floats

LETTERS = "ABCDE"
NO_BENCH = "compare_with names no bench without the object, so that its influence is not known"
FIT_RESIDUAL, MAKER_ACCURACY = "fit_residual", "maker_accuracy_deg"
LE_MENN = "le_menn"
PAPER_NT, PAPER_FIELD_NT = (60.0, 75.0), 22000.0  # field changes without and with noise, and horizontal field
COVERAGE_FACTOR = 2.0  # k of an expanded uncertainty (Le Menn et al. 2023, section 2)
PLATFORM, TILT = "platform", "tilt"
DIPOLE = 3.0  # exponent of the decrease with distance
FAR_SIZES = 2.0  # distance, in sizes of the object, beyond which it may be a dipole
SAFE_DEG = 0.5  # harmless change of the deviation
ALIGNMENT_DEG = 5.0  # errors of the alignment of benches, mounts and the compasses of ships are smaller


@dataclass(frozen=True)
class Source:
    """One row of an uncertainty budget."""

    name: str  #: name of the row, such as a key of ``ROWS``
    standard_deg: float  #: standard uncertainty, degrees
    how: str  #: its origin, the assumed distribution or the statistical estimate


@dataclass(frozen=True)
class Row:
    """Definition of a row that the budget of a bench may have."""

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
    """List the rows of a bench's budget as standard uncertainties, with notes on missing and foreign rows."""
    made, absent = [], []
    for name, row in ROWS.items():
        if kind not in row.kinds:
            continue
        value, origin = given.get(name), "given"
        if value is None and budget == LE_MENN:
            value, origin = row.le_menn_deg, "Le Menn et al. 2023, section 2"
        if value is None:
            absent.append(name)
        else:
            made.append(Source(name, value / row.divisor, f"{row.what}: {value:g} degrees, {row.how} ({origin})"))
    notes = []
    if foreign := [name for name, row in ROWS.items() if kind not in row.kinds and given.get(name) is not None]:
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


def combined(rows: Sequence[Source]) -> float:
    """Combine independent rows into one standard uncertainty, degrees; 0 without rows."""
    return float(np.sqrt(sum(row.standard_deg**2 for row in rows)))


def common(rows: Sequence[Source]) -> float:
    """Combine the rows that may be common to all headings, excluding those of a single reading, degrees."""
    return combined([row for row in rows if row.name not in (FIT_RESIDUAL, MAKER_ACCURACY)])


def expanded(rows: Sequence[Source]) -> float:
    """Compute the expanded uncertainty (k = 2) of independent rows, degrees."""
    return COVERAGE_FACTOR * combined(rows)


@dataclass(frozen=True)
class DeviationTable:
    """Deviation by recorded heading."""

    heading_deg: Floats  #: (m,) recorded, magnetic
    deviation_deg: Floats  #: (m,) to be added to the recorded heading
    sigma_deg: Floats  #: (m,) one standard deviation


@dataclass(frozen=True)
class Calibration:
    """Result of one calibration; without coefficients if the data do not suffice, for the reason given in ``why``."""

    kind: str  #: platform | tilt | swing | magnetometer | declination | two_heads
    model: str  #: name of the selected curve or model
    n: int  #: observations used
    coverage: int  #: occupied sectors of 10 degrees of the recorded heading, of 36
    coefficients: Floats = field(default_factory=lambda: np.zeros(0))  #: (5,) A..E of the series, degrees
    covariance: Floats = field(default_factory=lambda: np.zeros(0))  #: (5, 5)
    exact: Floats = field(default_factory=lambda: np.zeros(0))  #: (5,) A..E of the exact compass, dimensionless
    exact_covariance: Floats = field(default_factory=lambda: np.zeros(0))  #: (5, 5)
    residual_rms_deg: float = float("nan")  #: degrees, of the chosen curve; NaN without one
    sources: tuple[Source, ...] = ()  #: rows of the uncertainty budget
    table: DeviationTable | None = None  #: deviation by recorded heading; None if it is unknown
    points: Mapping[str, Floats] = field(default_factory=dict)  #: columns of the observations, (n,) each
    details: Mapping[str, Any] = field(default_factory=dict)  #: entries specific to the kind, ready for JSON
    why: str = ""  #: reason for missing coefficients; empty if there are any
    warnings: tuple[str, ...] = ()  #: sentences for the report


def to_json(name: str, made: Calibration, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a calibration to the content of calibration.json: keys common to all kinds, then those of its kind."""
    # Place and date as given, else as stated in the log, and the earth's field there.
    details, date_s = made.details, settings.get("date_s")
    date = details.get("date") if date_s is None else datetime.fromtimestamp(date_s, UTC).strftime("%Y-%m-%d")
    stated = settings if None not in (settings.get("latitude"), settings.get("longitude")) else details
    at = {key: stated.get(key) for key in ("latitude", "longitude")}
    day_s = None if date is None else datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp()
    field = settings.get("field") or resolve_settings({**at, "date_s": day_s})["field"]
    declination = settings.get("declination_deg", field and field["declination_deg"])
    standard = combined(made.sources) if made.sources and not made.why else None
    common_keys = {
        "name": name,
        "kind": made.kind,
        "model": made.model,
        "coefficients": _by_letter(made.coefficients),
        "covariance": made.covariance if made.coefficients.size else None,
        "residual_rms_deg": made.residual_rms_deg,
        "n": made.n,
        "coverage": made.coverage,
        "uncertainty": {
            "rows": {row.name: {"standard_deg": row.standard_deg, "how": row.how} for row in made.sources},
            "standard_deg": standard,
            "coverage_factor": COVERAGE_FACTOR,
            "expanded_deg": None if standard is None else COVERAGE_FACTOR * standard,
        },
        "exact": {"coefficients": _by_letter(made.exact), "covariance": made.exact_covariance}
        if made.exact.size
        else None,
        "place": {**at, "date": date, "declination_deg": declination, "field": field},
        "parts": list(settings.get("parts") or ()),
        "comparison": None,
        "compared": [],
        "why": made.why,
        "warnings": [*made.warnings, *(weak_field_warnings(field["horizontal_nT"]) if field else ())],
    }
    near = {"object": settings["object"]} if settings.get("object") else {}
    return {**common_keys, **details, **near}


def _by_letter(values: Floats) -> dict[str, float] | None:
    return dict(zip(LETTERS, values.tolist(), strict=True)) if values.size else None


def log_line(content: Mapping[str, Any]) -> str:
    """Summarize a calibration in one line of the log, followed by its warnings."""
    name, expanded_deg = content["name"], content["uncertainty"]["expanded_deg"]
    line = f"{name}: {content['kind']}, {content['n']} readings, model {content['model']}"
    known = {k: x for k, x in (content["coefficients"] or {}).items() if x is not None and np.isfinite(x)}
    if known:
        line += f", {', '.join(f'{k} {x:+.2f}' for k, x in known.items())} degrees"
    if expanded_deg is not None:
        line += f", expanded uncertainty {expanded_deg:.2f} degrees (k = 2)"
    first = f"{name}: no calibration: {content['why']}" if content["why"] else line
    return "\n".join([first, *(f"{name}: warning: {text}" for text in content["warnings"])])


def compare_all(name: str, content: Mapping[str, Any], earlier: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Compare a calibration with earlier ones, the first of them without the object: keys of calibration.json."""
    near: dict[str, Any] = {"object": {**content["object"], "text": NO_BENCH}} if content.get("object") else {}
    if not earlier:
        return {"comparison": None, "compared": []} | near
    pages = {**earlier, name: content}
    first, *others = pages
    unknown = {"amplitude_deg": None, "phase_deg": None}
    compared = [{"name": first, "coefficients": pages[first]["coefficients"], **unknown}]
    for other in others:
        comparison = compare(pages[other], pages[first])
        change = comparison.get("one_cycle") or unknown
        compared.append({"name": other, "coefficients": pages[other]["coefficients"], **change})
    if near and not pages[first].get("object"):
        changes = changes_by_object(pages[first], [pages[other] for other in others])
        described = describe_object(changes, content["object"]["size_m"]) if changes else {}
        near = {"object": content["object"] | described}
    return {"comparison": comparison, "compared": compared} | near


def compare(after: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """Compare a calibration with an earlier one of the same compass, by the p-value (chi square) of no difference.

    Le Menn et al. 2023, sections 3 and 4, compare curves by eye and by their phase shift. Errors common to both
    calibrations cancel: the budgets are not included.
    """
    name = before["name"]
    if after["coefficients"] is None or before["coefficients"] is None:
        missing = name if before["coefficients"] is None else "this calibration"
        return {"with": name, "why": f"{missing} has no coefficients", "differ": None}
    from scipy.special import chdtrc  # imported late: only needed for comparisons

    values = [np.array([each["coefficients"][k] for k in LETTERS], dtype=float) for each in (after, before)]
    spreads = [np.array(each["covariance"], dtype=float) for each in (after, before)]
    off, covariance = values[0] - values[1], spreads[0] + spreads[1]
    both = np.isfinite(off)
    square = off[both] @ np.linalg.pinv(covariance[np.ix_(both, both)]) @ off[both]
    p_value = float(chdtrc(int(both.sum()), square))
    here, there = (_polar(*each) for each in zip(values, spreads, strict=True))
    change, sigma = here[0] - there[0], float(np.hypot(here[1], there[1]))
    size = {"after": here[0], "before": there[0], "difference": change, "sigma": sigma}
    phase, moved = None, "it is too small on one side to have a phase"
    if not min(here[0] / here[1], there[0] / there[1]) < 3.0:  # amplitudes in standard deviations
        shift, spread = float(angles.difference(here[2], there[2])), float(np.hypot(here[3], there[3]))
        phase = {"after": here[2], "before": there[2], "shift": shift, "sigma": spread}
        moved = f"its phase moves by {shift:+.0f} ± {2 * spread:.0f} degrees"
    differ = p_value < 0.05
    chance = f"p = {p_value:.2g}" if p_value >= 0.001 else "p < 0.001"
    return {
        "with": name,
        "one_cycle": {"amplitude_deg": size, "phase_deg": phase},
        "p_value": p_value,
        "differ": differ,
        "text": f"This calibration and {name} {'differ' if differ else 'do not differ significantly'} ({chance}). "
        f"The one-cycle part goes from {there[0]:.2f} to {here[0]:.2f} degrees, by {change:+.2f} ± {2 * sigma:.2f} "
        f"(k = 2); {moved}.",
    }


def _polar(coefficients: Floats, covariance: Floats) -> tuple[float, float, float, float]:
    """Convert B and C to amplitude, its sigma, phase (where B sin + C cos is largest) and its sigma, degrees."""
    pair, spread = coefficients[1:3], covariance[1:3, 1:3]
    amplitude = max(float(np.hypot(*pair)), 1e-12)
    along = pair / amplitude
    across = np.array([along[1], -along[0]])
    sigmas = [max(float(np.sqrt(x @ spread @ x)), 1e-12) for x in (along, across)]
    return amplitude, sigmas[0], float(angles.direction(*pair)), sigmas[1] / amplitude / angles.DEGREE


@dataclass(frozen=True)
class ObjectChange:
    """Change by an object at one distance."""

    name: str  # of the calibration
    distance_m: float  # compass to the object's centre
    change_deg: Floats  # (2,) of B and C relative to the bench without it
    covariance: Floats  # (2, 2) of the calibration with the object
    common: Floats  # (2, 2) covariance of the bench without it, whose error all changes have

    @property
    def size(self) -> tuple[float, float]:
        """Length of the vector of changes and its standard uncertainty, degrees."""
        size = float(np.hypot(*self.change_deg))
        along = self.change_deg / max(size, 1e-12)
        return size, float(np.sqrt(along @ (self.covariance + self.common) @ along))


def changes_by_object(without: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[ObjectChange]:
    """Collect the changes of (B, C) by an object from calibrations that state its distance, nearest first."""
    changes = []
    for content in others if without["coefficients"] else ():
        if content.get("object") and content["coefficients"]:
            change = np.array([content["coefficients"][k] - without["coefficients"][k] for k in "BC"])
            covariance, common = (np.array(each["covariance"], dtype=float)[1:3, 1:3] for each in (content, without))
            changes.append(ObjectChange(content["name"], content["object"]["distance_m"], change, covariance, common))
    return sorted(changes, key=lambda each: each.distance_m)


def describe_object(changes: Sequence[ObjectChange], size_m: float) -> dict[str, Any]:
    """Describe the changes by an object, nearest first, their decrease with distance and the safe distance."""
    from scipy.special import chdtrc  # imported late: only needed for objects

    least_m = FAR_SIZES * size_m  # the object is no dipole at less
    near, far = ([each for each in changes if (each.distance_m <= least_m) == nearer] for nearer in (True, False))
    listed = [f"{each.size[0]:.2f} ± {2.0 * each.size[1]:.2f}° at {each.distance_m:g} m" for each in changes]
    texts = [f"The object changes (B, C) by {', '.join(listed)} (k = 2)."]
    content: dict[str, Any] = {
        "changes": [
            {"name": each.name, "distance_m": each.distance_m, "size_deg": each.size[0], "sigma_deg": each.size[1]}
            | dict(zip("BC", each.change_deg.tolist(), strict=True))
            for each in changes
        ],
        **dict.fromkeys(("p_value", "safe_distance_m")),
    }
    if near:
        where = ", ".join(f"{each.distance_m:g} m" for each in near)
        texts.append(f"At {where} it is nearer than twice its size and no dipole: nothing follows for other distances.")
    if far:
        strength, covariance, misfit = fit_dipole(far)
        p_value = float(chdtrc(2 * len(far) - 2, misfit)) if len(far) > 1 else None
        content["p_value"] = p_value
        if p_value is not None and p_value < 0.01:
            texts.append("No dipole falls so: no safe distance follows.")
        else:
            size = float(np.hypot(*strength))
            sigma = float(np.sqrt(strength @ covariance @ strength)) / max(size, 1e-12)
            ends = {"value": size, "low": max(size - 2.0 * sigma, 0.0), "high": size + 2.0 * sigma}
            safe = {name: max((each / SAFE_DEG) ** (1.0 / DIPOLE), least_m) for name, each in ends.items()}
            content["safe_distance_m"] = safe
            law = "By a dipole's fall, which " + ("one distance cannot test" if p_value is None else "they fit")
            where = f"{safe['value']:.2f} m on ({safe['low']:.2f} to {safe['high']:.2f} m)"
            texts.append(f"{law}, no deviation changes by {SAFE_DEG:g}° from {where}.")
    return content | {"text": " ".join(texts)}


def fit_dipole(changes: Sequence[ObjectChange]) -> tuple[Floats, Floats, float]:
    """Fit the vector M of changes M / r^3 by generalized least squares: M, covariance, chi-squared."""
    n = len(changes)
    each = np.einsum("kl,kij->kilj", np.eye(n), [change.covariance for change in changes])
    precision = np.linalg.inv((each + changes[0].common[:, None]).reshape(2 * n, 2 * n))
    observed = np.concatenate([change.change_deg for change in changes])
    design = np.kron(np.array([[change.distance_m**-DIPOLE] for change in changes]), np.eye(2))
    covariance = np.linalg.inv(design.T @ precision @ design)
    strength = covariance @ design.T @ precision @ observed
    left = observed - design @ strength
    return strength, covariance, float(left @ precision @ left)
