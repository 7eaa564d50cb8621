"""Deviation curves fitted to reference and recorded headings by weighted least squares (Le Menn et al. 2023)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
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
    correct_residual_deg: Floats  # (n,) the same of the correct heading


def least_squares(columns: Floats, observed: Floats, weight: Floats) -> LeastSquares:
    """Solve a weighted linear least-squares problem."""
    root = np.sqrt(weight)[:, None]
    inverse = np.linalg.pinv(root * columns)
    coefficients = inverse @ (root[:, 0] * observed)
    leverage, residual = np.einsum("ni,in->n", root * columns, inverse), observed - columns @ coefficients
    return LeastSquares(coefficients, weight, inverse @ inverse.T, leverage, residual, residual)


@dataclass(frozen=True)
class CurveForm:
    """A family of curves that are linear in their coefficients."""

    name: str
    letters: str  # names of the coefficients
    source: str
    design: Callable[[Floats], Floats]  # recorded heading (n,) -> columns (n, k)
    tested_deg: Floats = field(default_factory=lambda: CIRCLE_DEG)  # readings at which the standard error is tested

    def solve(self, points: Points) -> LeastSquares | None:
        """Fit the coefficients; None where no curve of this form passes near the points."""
        return least_squares(self.design(points.recorded_deg), points.deviation_deg, np.ones(len(points)))

    def deviation(self, coefficients: Floats, recorded_deg: Floats) -> Floats:
        """Evaluate the deviation at recorded headings, (n,) degrees; NaN where it is not unique."""
        return self.design(recorded_deg) @ coefficients

    def nearest_deviation(self, coefficients: Floats, points: Points) -> Floats:
        """Evaluate the deviation at points, (n,) degrees; of two the nearer to the observed one."""
        return self.deviation(coefficients, points.recorded_deg)

    def gradient(self, coefficients: Floats, recorded_deg: Floats) -> Floats:
        """Compute the derivative of the deviation by each coefficient, (n, k)."""
        return self.design(recorded_deg)

    def around(self, coefficients: Floats) -> Floats:
        """Compute the weighted derivatives of the fitted quantity round the circle, (m, k)."""
        return self.design(self.tested_deg)


class ExactForm(CurveForm):
    """The exact compass, fitted to the recorded heading: Le Menn et al. 2023, eq. (4), with cos in its denominator."""

    def solve(self, points: Points) -> LeastSquares | None:
        correct = points.recorded_deg + points.deviation_deg
        # Start: sin D = A cos D + B sin g + C cos g + D sin(b + g) + E cos(b + g), which is Im(e^{-ig} q) = 0.
        sine, cosine = angles.sin_cos(points.recorded_deg)
        sine_sum, cosine_sum = angles.sin_cos(points.recorded_deg + correct)
        sine_off, cosine_off = angles.sin_cos(points.deviation_deg)
        columns = np.stack([cosine_off, sine, cosine, sine_sum, cosine_sum], axis=-1)
        coefficients = least_squares(columns, sine_off, np.ones(len(points))).coefficients
        for _ in range(20):  # Gauss-Newton; two steps suffice for readings of a real compass
            off = angles.difference(points.recorded_deg, compass.recorded_heading(coefficients, correct))
            step = least_squares(compass.gradient(coefficients, correct).T, off, self._weight(coefficients, correct))
            coefficients = coefficients + step.coefficients
            if np.max(np.abs(step.coefficients)) < 1e-9:
                # Minus the slope converts to the correct heading; it is bounded as it approaches 0 near a fold.
                slope = compass.slope(coefficients, correct)
                bounded = np.where(slope < 0, -1.0, 1.0) * np.maximum(np.abs(slope), 0.3)
                correct_residual = -1.0 / bounded * off
                return replace(step, coefficients=coefficients, residual_deg=off, correct_residual_deg=correct_residual)
            if not np.all(np.abs(coefficients) < 10.0):
                return None
        return None

    def deviation(self, coefficients: Floats, recorded_deg: Floats) -> Floats:
        if not compass.turns_full_circle(coefficients):
            return np.full(recorded_deg.shape, np.nan)
        return angles.difference(compass.inverse(coefficients, recorded_deg)[:, 0], recorded_deg)

    def nearest_deviation(self, coefficients: Floats, points: Points) -> Floats:
        observed = points.recorded_deg + points.deviation_deg
        off = angles.difference(compass.inverse(coefficients, points.recorded_deg), observed[:, None])
        nearer = np.argmin(np.where(np.isfinite(off), np.abs(off), np.inf), axis=1)
        return points.deviation_deg + off[np.arange(len(off)), nearer]

    def gradient(self, coefficients: Floats, recorded_deg: Floats) -> Floats:
        """Compute the derivative of the deviation by A to E, (n, 5): at a constant reading, -dγ / (dγ / dβ)."""
        root = recorded_deg + self.deviation(coefficients, recorded_deg)
        return -(compass.gradient(coefficients, root) / compass.slope(coefficients, root)).T

    def around(self, coefficients: Floats) -> Floats:
        weight = self._weight(coefficients, CIRCLE_DEG)
        return compass.gradient(coefficients, CIRCLE_DEG).T * np.sqrt(weight)[:, None]

    @staticmethod
    def _weight(coefficients: Floats, correct_deg: Floats) -> Floats:
        """Weigh recorded headings, (n,), for equal errors of compass and bench, the latter times the slope."""
        return 2.0 / (1.0 + compass.slope(coefficients, correct_deg) ** 2)


def harmonic_design(recorded_deg: Floats) -> Floats:
    """Compute the columns 1, sin k, cos k up to the sixth harmonic, (n, 13)."""
    columns = [np.stack(angles.sin_cos(k * np.asarray(recorded_deg)), axis=-1) for k in range(1, 7)]
    return np.column_stack([np.ones(np.shape(recorded_deg)), *columns])


ONE_CYCLE = CurveForm("one_cycle", "ABC", "Le Menn et al. 2023, eq. (3)", lambda x: series_design(x)[:, :3])
SMITH = CurveForm("smith", "ABCDE", "Le Menn et al. 2023, eq. (5)", series_design)
# Powers of the recorded heading scaled to [-1, 1): eq. (7) itself is ill-conditioned.
POLYNOMIAL = CurveForm(
    "polynomial",
    "ABCDEFG",
    "Le Menn et al. 2023, eq. (7)",
    lambda x: np.vander(angles.wrap360(x) / 180.0 - 1.0, POLYNOMIAL_DEGREE + 1, increasing=True),
)
# Deviations that iron cannot cause, such as a wrong table in the firmware: functions of the heading in any field.
EMPIRICAL = CurveForm(
    "empirical", "ABCDEFGHIJKLM", "von Appen 2015, footnote 1: any curve of the heading", harmonic_design
)
EXACT = ExactForm("exact", "ABCDE", "Le Menn et al. 2023, eq. (4)", series_design)


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

    def deviation(self, recorded_deg: ArrayLike) -> Floats:
        """Evaluate the deviation at recorded headings, (n,) degrees; NaN where it is not unique."""
        return self.form.deviation(self.coefficients, np.asarray(recorded_deg, dtype=float))

    def sigma(self, recorded_deg: ArrayLike) -> Floats:
        """Compute the standard uncertainty of the deviation due to the coefficients, (n,) degrees."""
        by = self.form.gradient(self.coefficients, np.asarray(recorded_deg, dtype=float))
        return np.sqrt(np.einsum("ni,ij,nj->n", by, self.covariance, by))

    def to_json(self) -> dict[str, Any]:
        """Describe the curve for calibration.json, a polynomial by A to G of eq. (7)."""
        coefficients = self.coefficients.tolist()
        if self.form is POLYNOMIAL:
            powers = np.polynomial.Polynomial(coefficients, [0.0, 360.0], [-1.0, 1.0]).convert().coef.tolist()
            coefficients = [*powers, *[0.0] * (POLYNOMIAL_DEGREE + 1 - len(powers))]  # numpy drops trailing zeros
        return {
            "coefficients": dict(zip(self.form.letters, coefficients, strict=True)),
            "left_out_rms_deg": angles.rms(self.left_out_deg),
            "residual_rms_deg": angles.rms(self.residual_deg),
            "dof": self.dof,
            "source": self.form.source,
        }


def deviation_points(recorded_deg: ArrayLike, reference_deg: ArrayLike) -> Points:
    """Compute observed deviations, continuous about their mean."""
    recorded, off = angles.wrap360(recorded_deg), angles.difference(reference_deg, recorded_deg)
    middle = angles.wrap180(angles.mean(off)) if off.size else 0.0
    return Points(recorded, middle + angles.difference(off, middle))


def count_sectors(recorded_deg: ArrayLike) -> int:
    """Count the sectors of ten degrees, of 36, that contain a recorded heading."""
    return len(np.unique(np.floor(angles.wrap360(recorded_deg) / angles.SECTOR_DEG)))


def student_widening(dof: int) -> float:
    """Inflate a standard deviation of few degrees of freedom so that two are 95.45 %, as for k = 2 (GUM, annex G)."""
    from scipy.special import stdtrit  # imported late: only fits need it

    return float(stdtrit(dof, 0.97725)) / 2.0


def fit_curve(form: CurveForm, points: Points) -> FittedCurve | str:
    """Fit a form to points at distinct headings; if it cannot be fitted, give the reason instead."""
    if len(points) <= (needed := len(form.letters)):
        return f"{needed} coefficients need at least {needed + 1} headings, there are {len(points)}"
    solution = form.solve(points)
    if solution is None:
        return "no curve of this form passes near the points"
    by = form.around(solution.coefficients)
    vague = np.einsum("ni,ij,nj->n", by, solution.cofactor, by)
    # The standard error of a determined curve is nowhere more than three times the scatter of a reading.
    if float(np.sqrt(np.max(vague))) > 3.0 or np.max(solution.leverage) > 1.0 - 1e-6:
        return "the headings do not determine it: they leave too wide a gap in the circle"
    residual = solution.correct_residual_deg
    if (off := angles.rms(residual)) > 10.0:
        return f"it misses the readings by {off:.0f} degrees rms"
    dof = len(points) - needed
    widening = student_widening(dof)
    return FittedCurve(
        form=form,
        coefficients=solution.coefficients,
        covariance=widening**2 * np.sum(solution.weight * solution.residual_deg**2) / dof * solution.cofactor,
        residual_deg=residual,
        left_out_deg=residual / (1.0 - solution.leverage),
        dof=dof,
        scatter_deg=widening * float(np.sqrt(np.sum(residual**2) / dof)),
    )


def select_curve(curves: Sequence[FittedCurve]) -> FittedCurve:
    """Select the first curve, unless another one with as many or more coefficients predicts left-out points better."""
    # Forms with fewer coefficients are contained in the first: their uncertainty would neglect the omitted terms. More
    # coefficients must be better by twice the standard error of the difference.
    best = curves[0]
    for other in (curve for curve in curves[1:] if curve.dof <= best.dof and best.dof >= 3):
        gain = best.left_out_deg**2 - other.left_out_deg**2
        same = len(other.form.letters) == len(best.form.letters)
        needed = 0.0 if same else 2.0 * float(np.std(gain, ddof=1)) / np.sqrt(len(gain))
        best = other if float(np.mean(gain)) > needed else best
    return best
