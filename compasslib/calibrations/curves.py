"""Deviation curves fitted to reference and recorded headings by weighted least squares, in five forms.

Three forms are series in the recorded heading: one cycle (Le Menn et al. 2023, eq. 3), Smith's five terms (their eq. 5
with von Appen's letters: D goes with sin 2, E with cos 2) and a polynomial of degree six (eq. 7). The fourth is the
exact compass of Evans and Smith, the fifth an empirical series of six harmonics, for deviations not caused by iron.
Forms are compared by their leave-one-out residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles, compass
from compasslib.deviation.series import series_design
from compasslib.types import Floats

CIRCLE_DEG = np.arange(0.0, 360.0, 5.0)
POLYNOMIAL_DEGREE = 6


@dataclass(frozen=True)
class Points:
    """Observed deviations by recorded heading, (n,) each."""

    recorded_deg: Floats  # in [0, 360)
    deviation_deg: Floats  # reference minus recorded, continuous about its mean
    weight: Floats  # inverse variance in any unit

    def __len__(self) -> int:
        return len(self.recorded_deg)


@dataclass(frozen=True)
class LeastSquares:
    """Solution of a weighted least-squares problem."""

    coefficients: Floats  # (k,)
    weight: Floats  # (n,) weights used
    cofactor: Floats  # (k, k) covariance relative to the variance of a reading with weight 1
    leverage: Floats  # (n,) diagonal of the hat matrix
    residual_deg: Floats  # (n,) observed minus fitted, of the quantity to which the form is fitted


@dataclass(frozen=True)
class CurveForm:
    """A family of curves."""

    name: str
    letters: str  # names of the coefficients
    source: str
    solve: Callable[[Points], LeastSquares | None]  # None where no curve of this form passes near the points
    deviation: Callable[[Floats, Floats], Floats]  # coefficients (k,), recorded heading (n,) -> degrees (n,)
    gradient: Callable[[Floats, Floats], Floats]  # the same -> derivative of the deviation by each coefficient (n, k)
    around: Callable[[Floats], Floats]  # coefficients -> derivatives of the fitted quantity round the circle (m, k)
    steepness: Callable[[Floats, Points], Floats] | None = None  # d recorded / d correct, if recorded is fitted


@dataclass(frozen=True)
class FittedCurve:
    """A form fitted to points."""

    form: CurveForm
    coefficients: Floats  # (k,)
    covariance: Floats  # (k, k), inflated so that two standard deviations cover 95.45 % for few readings too
    residual_deg: Floats  # (n,) of the correct heading
    left_out_deg: Floats  # (n,) leave-one-out residuals of the correct heading
    dof: int
    scatter_deg: float  # standard deviation of correct headings about the curve, inflated for few readings

    @property
    def score_deg(self) -> float:
        """Leave-one-out rms error, degrees."""
        return angles.rms(self.left_out_deg)

    def deviation(self, recorded_deg: ArrayLike) -> Floats:
        """Evaluate the deviation at recorded headings, (n,) degrees; NaN where it is not unique."""
        return self.form.deviation(self.coefficients, np.asarray(recorded_deg, dtype=float))

    def sigma(self, recorded_deg: ArrayLike) -> Floats:
        """Compute the standard uncertainty of the deviation due to the coefficients, (n,) degrees."""
        by = self.form.gradient(self.coefficients, np.asarray(recorded_deg, dtype=float))
        return np.sqrt(np.einsum("ni,ij,nj->n", by, self.covariance, by))


def deviation_points(recorded_deg: ArrayLike, reference_deg: ArrayLike, weight: ArrayLike | None = None) -> Points:
    """Compute observed deviations, continuous about their mean; weights are inverse variances (n,), equal if None."""
    recorded, off = angles.wrap360(recorded_deg), angles.difference(reference_deg, recorded_deg)
    middle = angles.wrap180(angles.mean(off)) if off.size else 0.0
    equal = np.ones(recorded.shape) if weight is None else np.asarray(weight, dtype=float)
    return Points(recorded, middle + angles.difference(off, middle), equal)


def count_sectors(recorded_deg: ArrayLike) -> int:
    """Count the sectors of ten degrees, of 36, that contain a recorded heading."""
    return len(np.unique(np.floor(angles.wrap360(recorded_deg) / angles.SECTOR_DEG)))


def least_squares(columns: Floats, observed: Floats, weight: Floats) -> LeastSquares:
    """Solve a weighted linear least-squares problem."""
    root = np.sqrt(weight)[:, None]
    inverse = np.linalg.pinv(root * columns)
    coefficients = inverse @ (root[:, 0] * observed)
    leverage = np.einsum("ni,in->n", root * columns, inverse)
    return LeastSquares(coefficients, weight, inverse @ inverse.T, leverage, observed - columns @ coefficients)


def max_leakage(points: Points) -> float:
    """Bound the fraction of a quadrantal deviation that would appear in A, B or C if it is omitted."""
    columns = series_design(points.recorded_deg)
    return float(np.max(np.abs(np.linalg.pinv(columns[:, :3]) @ columns[:, 3:])))


def student_widening(dof: int) -> float:
    """Compute the factor that inflates a standard deviation estimated with few degrees of freedom.

    Two inflated standard deviations are Student's interval of 95.45 %, the nominal coverage of k = 2 (GUM, annex G).
    """
    from scipy.special import stdtrit  # imported late: only fits need it

    return float(stdtrit(dof, 0.97725)) / 2.0


def fit_curve(
    form: CurveForm, points: Points, *, max_vagueness: float = 3.0, max_residual_deg: float = 10.0
) -> FittedCurve | str:
    """Fit a form to points at distinct headings; if it cannot be fitted, give the reason instead.

    Args:
        max_vagueness: largest standard error of a determined curve anywhere on the circle, in units of the scatter of
            one reading.
        max_residual_deg: rms residual beyond which a curve is rejected.
    """
    if len(points) <= (needed := len(form.letters)):
        return f"{needed} coefficients need at least {needed + 1} headings, there are {len(points)}"
    solution = form.solve(points)
    if solution is None:
        return "no curve of this form passes near the points"
    by = form.around(solution.coefficients)
    vague = np.einsum("ni,ij,nj->n", by, solution.cofactor, by) * np.mean(points.weight)
    if float(np.sqrt(np.max(vague))) > max_vagueness or np.max(solution.leverage) > 1.0 - 1e-6:
        return "the headings do not determine it: they leave too wide a gap in the circle"
    dof = len(points) - len(form.letters)
    variance = student_widening(dof) ** 2 * float(np.sum(solution.weight * solution.residual_deg**2)) / dof
    # Residuals of the recorded heading, divided by minus the slope, are those of the correct heading.
    slope = -1.0 / form.steepness(solution.coefficients, points) if form.steepness else np.ones(len(points))
    residual = slope * solution.residual_deg
    if (off := angles.rms(residual)) > max_residual_deg:
        return f"it misses the readings by {off:.0f} degrees rms"
    mean_square = float(np.sum(points.weight * residual**2) / np.sum(points.weight))
    return FittedCurve(
        form=form,
        coefficients=solution.coefficients,
        covariance=variance * solution.cofactor,
        residual_deg=residual,
        left_out_deg=residual / (1.0 - solution.leverage),
        dof=dof,
        scatter_deg=student_widening(dof) * float(np.sqrt(mean_square * len(points) / dof)),
    )


def select_curve(
    curves: Sequence[FittedCurve], *, min_dof_to_select: int = 3, min_gain_sigmas: float = 2.0
) -> FittedCurve:
    """Select the first curve, unless another one predicts left-out points better.

    A form with more coefficients must be better by twice the standard error of the difference, one with as many just
    better. Forms with fewer are not considered: they are contained in the first, and their uncertainty would neglect
    the omitted terms. With too few degrees of freedom the first curve is returned.

    Args:
        min_dof_to_select: degrees of freedom; with fewer, a selection would be random.
        min_gain_sigmas: required gain of a form with more coefficients, in standard errors of the gain.
    """
    best = curves[0]
    for other in (curve for curve in curves[1:] if curve.dof <= best.dof and best.dof >= min_dof_to_select):
        gain = best.left_out_deg**2 - other.left_out_deg**2
        same = len(other.form.letters) == len(best.form.letters)
        needed = 0.0 if same else min_gain_sigmas * float(np.std(gain, ddof=1)) / np.sqrt(len(gain))
        best = other if float(np.mean(gain)) > needed else best
    return best


def series_form(
    name: str, letters: str, source: str, design: Callable[[Floats], Floats], around: Floats = CIRCLE_DEG
) -> CurveForm:
    """Make a form that is linear in its coefficients; ``around`` are readings where its standard error is tested."""
    return CurveForm(
        name=name,
        letters=letters,
        source=source,
        solve=lambda points: least_squares(design(points.recorded_deg), points.deviation_deg, points.weight),
        deviation=lambda coefficients, recorded: design(recorded) @ coefficients,
        gradient=lambda coefficients, recorded: design(recorded),
        around=lambda coefficients: design(around),
    )


def published_polynomial(curve: FittedCurve) -> list[float]:
    """Convert a curve of the form ``POLYNOMIAL`` to A to G of eq. (7), degrees over powers of degrees."""
    powers = np.polynomial.Polynomial(curve.coefficients, [0.0, 360.0], [-1.0, 1.0]).convert().coef
    return [*powers.tolist(), *[0.0] * (POLYNOMIAL_DEGREE + 1 - len(powers))]  # numpy drops trailing zeros


ONE_CYCLE = series_form("one_cycle", "ABC", "Le Menn et al. 2023, eq. (3)", lambda x: series_design(x)[:, :3])
SMITH = series_form("smith", "ABCDE", "Le Menn et al. 2023, eq. (5)", series_design)
# Powers of the recorded heading scaled to [-1, 1): eq. (7) itself is ill-conditioned.
POLYNOMIAL = series_form(
    "polynomial",
    "ABCDEFG",
    "Le Menn et al. 2023, eq. (7)",
    lambda x: np.vander(angles.wrap360(x) / 180.0 - 1.0, POLYNOMIAL_DEGREE + 1, increasing=True),
)


def harmonic_design(recorded_deg: Floats) -> Floats:
    """Compute the columns 1, sin k, cos k up to the sixth harmonic, (n, 13)."""
    columns = [np.stack(angles.sin_cos(k * np.asarray(recorded_deg)), axis=-1) for k in range(1, 7)]
    return np.column_stack([np.ones(np.shape(recorded_deg)), *columns])


# Deviations that iron cannot cause, such as a wrong table in the firmware: functions of the heading in any field.
EMPIRICAL = series_form(
    "empirical", "ABCDEFGHIJKLM", "von Appen 2015, footnote 1: any curve of the heading", harmonic_design
)


def curve_to_json(curve: FittedCurve) -> dict[str, Any]:
    """Describe a fitted curve for calibration.json."""
    coefficients = published_polynomial(curve) if curve.form is POLYNOMIAL else curve.coefficients.tolist()
    return {
        "coefficients": dict(zip(curve.form.letters, coefficients, strict=True)),
        "left_out_rms_deg": curve.score_deg,
        "residual_rms_deg": angles.rms(curve.residual_deg),
        "dof": curve.dof,
        "source": curve.form.source,
    }


def fit_exact_compass(points: Points) -> LeastSquares | None:
    """Fit A to E of the exact compass to the recorded heading by Gauss-Newton; None where it diverges.

    Le Menn et al. 2023, eq. (4), with the cosine in its denominator.
    """
    correct = points.recorded_deg + points.deviation_deg
    # sin D = A cos D + B sin g + C cos g + D sin(b + g) + E cos(b + g), which is Im(e^{-ig} q) = 0, gives the start.
    sine, cosine = angles.sin_cos(points.recorded_deg)
    sine_sum, cosine_sum = angles.sin_cos(points.recorded_deg + correct)
    sine_off, cosine_off = angles.sin_cos(points.deviation_deg)
    columns = np.stack([cosine_off, sine, cosine, sine_sum, cosine_sum], axis=-1)
    coefficients = least_squares(columns, sine_off, points.weight).coefficients
    for _ in range(20):  # two steps suffice for readings of a real compass
        off = angles.difference(points.recorded_deg, compass.recorded_heading(coefficients, correct))
        weight = points.weight * _exact_weight(coefficients, correct)
        step = least_squares(compass.gradient(coefficients, correct).T, off, weight)
        coefficients = coefficients + step.coefficients
        if np.max(np.abs(step.coefficients)) < 1e-9:
            return replace(step, coefficients=coefficients, residual_deg=off)
        if not np.all(np.abs(coefficients) < 10.0):
            return None
    return None


def exact_deviation(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Compute the deviation of an exact compass at recorded headings, degrees; NaN if it cannot turn full circle."""
    return angles.difference(_only_root(coefficients, recorded_deg), recorded_deg)


def exact_gradient(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Compute the derivative of the deviation by A to E, (n, 5) degrees per unit."""
    root = _only_root(coefficients, recorded_deg)
    # At a constant reading, d beta = -d gamma / (d gamma / d beta).
    return -(compass.gradient(coefficients, root) / compass.slope(coefficients, root)).T


def recorded_slope(coefficients: Floats, points: Points, *, min_slope: float = 0.3) -> Floats:
    """Compute d recorded / d correct heading at each point, bounded away from 0, (n,).

    Args:
        min_slope: lower bound of the slope near a fold, where errors of the correct heading would diverge.
    """
    slope = compass.slope(coefficients, points.recorded_deg + points.deviation_deg)
    return np.where(slope < 0, -1.0, 1.0) * np.maximum(np.abs(slope), min_slope)


def exact_circle_design(coefficients: Floats) -> Floats:
    """Compute the weighted derivative of the recorded heading by A to E round the circle, (m, 5) degrees per unit."""
    return compass.gradient(coefficients, CIRCLE_DEG).T * np.sqrt(_exact_weight(coefficients, CIRCLE_DEG))[:, None]


def _exact_weight(coefficients: Floats, correct_deg: Floats) -> Floats:
    """Compute weights of recorded headings, (n,), for equal errors of compass and bench, the latter times the slope."""
    return 2.0 / (1.0 + compass.slope(coefficients, correct_deg) ** 2)


def _only_root(coefficients: Floats, recorded_deg: Floats) -> Floats:
    if not compass.turns_full_circle(coefficients):
        return np.full(recorded_deg.shape, np.nan)
    return compass.inverse(coefficients, recorded_deg)[:, 0]


EXACT = CurveForm(
    "exact",
    "ABCDE",
    "Le Menn et al. 2023, eq. (4)",
    fit_exact_compass,
    exact_deviation,
    exact_gradient,
    exact_circle_design,
    recorded_slope,
)
