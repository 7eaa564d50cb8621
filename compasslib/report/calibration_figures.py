"""What each figure of a calibration shows, in words and numbers, for whoever cannot see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from compasslib.report import words
from compasslib.report.mooring_figures import of_diagnosis


def alternatives(content: Mapping[str, Any], diagnosis: Mapping[str, Any] | None) -> dict[str, Callable[[], str]]:
    """Return the texts by the figures' names, each made where it is asked for.

    Args:
        content: calibration.json.
        diagnosis: diagnosis.json; None where there is none.
    """
    told = {
        "deviation": lambda: _deviation(content),
        "residuals": lambda: _residuals(content),
        "certificate": lambda: _certificate(content),
        "magnetometer": lambda: _magnetometer(content),
        "swing": lambda: _swing(content),
        "difference": lambda: f"Heading of the first minus the second instrument against heading. {_offset(content)}",
        "tilt_check": lambda: (
            f"Tilts of the two instruments, turned onto each other. {(content.get('frame') or {}).get('text', '')}"
        ),
        "series": lambda: f"Declination along time, observed and by the field model. {_constant(content)}",
        "disturbance": lambda: _disturbance(content),
        "along_time": lambda: f"Headings of both instruments along time and their difference. {_offset(content)}",
    }
    return told | ({"diagnosis": lambda: of_diagnosis(diagnosis)} if diagnosis else {})


def _deviation(content: Mapping[str, Any]) -> str:
    if not content["coefficients"]:
        return f"Deviation against recorded heading: {content['n']} readings, no curve."
    letters = ", ".join(f"{k} {words.number(x, 2)}" for k, x in content["coefficients"].items())
    return (
        f"Deviation against recorded heading: {words.plural(content['n'], 'reading')}, the curve of model "
        f"{words.plain(content['model'])} with its 95 % band. Coefficients in degrees: {letters}."
    )


def _residuals(content: Mapping[str, Any]) -> str:
    rms = content["residual_rms_deg"]
    left = f"they are {words.degrees(rms, 2)} rms" if rms is not None else "there are none, for want of a curve"
    return f"Residuals of {words.plural(content['n'], 'reading')} against recorded heading: {left}."


def _certificate(content: Mapping[str, Any]) -> str:
    expanded = content["uncertainty"]["expanded_deg"]
    sure = (
        f"expanded uncertainty {words.degrees(expanded, 2)} (k = 2)" if expanded else "no uncertainty could be stated"
    )
    what = "coefficients, table of deviations and budget"
    return f"Certificate on one page: {what}; {sure}. All its numbers stand in the tables here."


def _magnetometer(content: Mapping[str, Any]) -> str:
    left = content.get("modulus_residual_percent") or {}
    told = "Magnetometer readings before and after taking out hard and soft iron."
    if left.get("after") is None:
        return f"{told} {words.sentence(content['why'])}"
    before, after = (words.number(left[key], 2) for key in ("before", "after"))
    return f"{told} The modulus of the field scatters by {before} % before and {after} % after."


def _swing(content: Mapping[str, Any]) -> str:
    water = (content.get("drift") or {}).get("text", "")
    verdict = (content.get("iso_25862") or {}).get("text", "")
    told = f"The swing: courses against compass headings, {words.plural(content['n'], 'sample')}."
    return " ".join(part for part in (told, water, verdict) if part)


def _offset(content: Mapping[str, Any]) -> str:
    if content.get("offset_deg") is None:
        return "No offset was found."
    return f"The offset is {words.with_sigma(content['offset_deg'], content.get('offset_sigma_deg'), '°')} (1σ)."


def _constant(content: Mapping[str, Any]) -> str:
    value, sigma = content.get("constant_deg"), content.get("constant_sigma_deg")
    return f"The constant between them is {words.with_sigma(value, sigma, '°')} (1σ)."


def _disturbance(content: Mapping[str, Any]) -> str:
    storms = content.get("storms") or []
    largest = max((one["range_deg"] for one in storms), default=None)
    range_ = f", the largest of {words.degrees(largest, 2)} from end to end" if storms else ""
    return f"What level and quiet day leave along time: {words.plural(len(storms), 'storm')}{range_}."
