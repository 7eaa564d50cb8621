"""A bench against the five-term series: whether the exact compass, or a harmonic, or a change half way, is missing.

With fewer readings than a dozen headings the third and fourth harmonics cannot be proven: five coefficients and four
more are nine, and noise needs some of its own. Then what is left is told, and which headings to swing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibration import curves, platform, series
from compasslib.calibration.exact_curve import EXACT
from compasslib.calibration.series import SMITH, Curve, Points
from compasslib.deviation import von_appen
from compasslib.discrepancy import verdict
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.recordings import curve, large, report, search
from compasslib.discrepancy.recordings.channel import Channel
from compasslib.discrepancy.recordings.terms import Drift, IronDrift
from compasslib.discrepancy.verdict import Diagnosis
from compasslib.physics.hard_iron_step import HardIronStep
from compasslib.physics.heading_slip import HeadingSlip
from compasslib.physics.octantal import Octantal
from compasslib.physics.sextantal import Sextantal
from compasslib.physics.term import Term

Floats = NDArray[np.floating]

FEWEST_HEADINGS = 12  # nine coefficients up to the fourth harmonic, and three degrees of freedom
READOUT: tuple[type[Term], ...] = (Sextantal, Octantal, HeadingSlip, Drift)
TERMS: tuple[type[Term], ...] = (*READOUT, HardIronStep, IronDrift)
SWING = "swing 16 to 24 headings all round the circle"
NO_CLOCK = "the readings carry no temperature, voltage or tilt"


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Return what a bench shows that its fitted five-term series does not hold.

    Args:
        files: CSV files with reference and recorded headings.
        settings: settled keys of the calibration's file.
        options: what may be chosen.
    """
    made = platform.calibrate(files, settings)
    if not len(made.points["recorded_deg"]):
        return verdict.insufficient(made.why)
    correct, recorded = made.points["reference_deg"], made.points["recorded_deg"]
    return judge(correct, recorded, field=settings.get("field"), options=options, why=made.why)


def judge(
    correct_deg: Floats, recorded_deg: Floats, *, field: Mapping[str, float] | None, options: Options, why: str = ""
) -> Diagnosis:
    """Return the diagnosis of readings in the order in which they were taken.

    Args:
        correct_deg: directions of the bench, magnetic, (n,).
        recorded_deg: what the compass showed, (n,).
        field: the earth's field there, None where the place is unknown.
        options: what may be chosen.
        why: why no curve could be fitted, empty where one could.
    """
    headings = len(np.unique(np.round(angles.wrap360(correct_deg) / curves.SAME_HEADING_DEG)))
    seen = series.points(recorded_deg, correct_deg)
    if headings < FEWEST_HEADINGS:
        return verdict.insufficient(too_few(headings, seen, why), _untested())
    smith, exact = (series.fit(form, seen) for form in (SMITH, EXACT))
    folds = isinstance(exact, Curve) and isinstance(smith, str)
    if not isinstance(exact, Curve) and not isinstance(smith, Curve):
        return verdict.insufficient(why or f"no curve passes near the readings ({smith})", _untested())
    first = large.findings(seen, options.min_effect_deg, options.alarm) if isinstance(exact, Curve) else []
    by_series = not folds and not first and large.series_fits_better(seen)
    channel = _channel(correct_deg, recorded_deg, field, exact if not by_series else None)
    named = search.search(channel, alarm=options.alarm, min_effect_deg=options.min_effect_deg)
    return report.diagnosis([named], min_effect_deg=options.min_effect_deg, beside=first, not_testable=_untested())


def _channel(
    correct_deg: Floats, recorded_deg: Floats, field: Mapping[str, float] | None, exact: Curve | str | None
) -> Channel:
    number = np.arange(1.0, len(correct_deg) + 1.0)
    scene, unit = curve.scene(number, field)
    form: curve.Compass | curve.Series
    if isinstance(exact, Curve):
        form, start, steps, terms = (
            curve.Compass(correct_deg, recorded_deg, scene),
            exact.coefficients,
            curve.STEPS,
            TERMS,
        )
    else:
        form, start, steps = curve.Series(correct_deg, recorded_deg, scene), np.zeros(5), np.ones(5)
        terms = READOUT
    return Channel(
        what="the fitted curve against the bench",
        residual=form,
        start=start,
        steps=steps,
        time_s=number,
        clocked=False,
        terms=terms,
        covariates={"heading": recorded_deg, "reading": number},
        field_unit=unit,
        independent=True,
    )


def too_few(headings: int, seen: Points, why: str = "") -> str:
    """Return why readings at few headings prove nothing, and what to swing.

    Args:
        headings: different ones.
        seen: the readings.
        why: why no curve could be fitted, empty where one could.
    """
    if headings <= 5 or why:
        return f"{why or f'{headings} headings determine no curve with anything to spare'}; {SWING}".replace(
            f"{SWING}; {SWING}", SWING
        )
    left = angles.wrap180(seen.deviation_deg - von_appen.design(seen.recorded_deg) @ _five(seen))
    sizes = {k: _harmonic(seen.recorded_deg, left, k) for k in (3, 4)}
    return (
        f"{headings} headings carry at most {headings} coefficients and five are the curve's: what those leave "
        f"({angles.rms(left):.1f} degrees rms) lies in the third ({sizes[3]:.1f}) and fourth harmonics "
        f"({sizes[4]:.1f} degrees rms, each fitted alone), sextantal and octantal; neither can be proven; {SWING}"
    )


def _five(seen: Points) -> Floats:
    return np.linalg.lstsq(von_appen.design(seen.recorded_deg), seen.deviation_deg, rcond=None)[0]


def _harmonic(recorded_deg: Floats, left_deg: Floats, k: int) -> float:
    """Return what one harmonic takes of a residual, the five terms refitted beside it, rms degrees."""
    five, pair = von_appen.design(recorded_deg), np.column_stack(angles.sin_cos(k * recorded_deg))
    after = (
        left_deg
        - np.column_stack([five, pair]) @ np.linalg.lstsq(np.column_stack([five, pair]), left_deg, rcond=1e-6)[0]
    )
    return float(np.sqrt(max(angles.rms(left_deg) ** 2 - angles.rms(after) ** 2, 0.0)))


def _untested() -> tuple[tuple[str, str], ...]:
    return tuple((effect, NO_CLOCK) for effect in ("temperature", "supply_voltage", "heeling"))
