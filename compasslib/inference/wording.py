"""Describe findings in sentences for an oceanographer: where, which physics, how large, how certain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from compasslib.effects import CATALOGUE, COMPOSED, SLOW_WATER, all_effects, driver_of, side_of
from compasslib.effects.composed import FORMS
from compasslib.records import iso_time

VERDICTS = {
    "consistent": "no compass error beyond the fitted deviation was detected",
    "explained": "the mismatch is attributed",
    "ambiguous": "a mismatch is established, its cause is not settled",
    "unexplained": "a mismatch is established, nothing in the catalogue fits it",
    "insufficient": "too little data to judge",
}
UNITS = {
    "heading": "degrees", "pitch": "degrees", "roll": "degrees", "depth": "m", "separation": "m", "speed": "m/s",
    "temperature": "degrees C", "supply_voltage": "V or counts", "hour_of_day": "h", "time": "",
    "declination_observatory": "degrees", "horizontal_observatory": "degrees", "reference_heading": "degrees",
    "transmit_current": "counts", "heading_spread": "degrees", "echo": "counts", "field_strength": "percent",
}  # fmt: skip
TURN_PREFIX = "turn_by_"  # prefix of the turn by an effect, degrees
SIZE_PREFIX = "size_of_"  # prefix of the size of a dated effect, along time
UNITS_OF_CALIBRATIONS = UNITS | {
    "turn_rate": "degrees/s",
    "speed": "kn",
    "vertical_field": "of its mean",
    "reading": "",
}
# Wording of each effect, from its first form. Effects of other packages are shown along the series that they need.
PHYSICS = {term.name: term.words for term in reversed(all_effects()) if term.words} | {
    SLOW_WATER: "slowly changing shear of the water between the two depths; no instrument is at fault"
}
SHOWN_ALONG = {term.name: term.needs for term in all_effects() if term not in CATALOGUE and term.needs} | {
    term.name: term.shows_along for term in all_effects() if term.shows_along
}  # all other effects are shown along time
SEPARATED_BY = {
    frozenset((term.name, other)): how for term in all_effects() for other, how in term.separated_by.items()
}
LONG_RECORD_S = 10 * 86400.0  # length of a record above which dates are given to the day
WATER_OR_COMPASS = "a second reference, or a swing of the compass on land: {} is in the water, {} is not"
TRUSTED_OR_NOT = "a second reference (reference as a list), or a swing of either compass on land"
OTHERWISE = "a record in which {} and {} vary independently"


def separating_observations(effect: str, alternatives: Sequence[str]) -> str:
    """List the observations that would separate an effect from its alternatives, one phrase per pair."""
    phrases = []
    for other in alternatives:
        first, second = (display_name(name) if name.startswith(COMPOSED) else name for name in (effect, other))
        if how := SEPARATED_BY.get(frozenset((effect, other))):
            text = how
        elif len([name for name in (effect, other) if name.startswith("reference_")]) == 1:
            text = TRUSTED_OR_NOT
        elif (side_of(effect) == "water") != (side_of(other) == "water"):
            text = WATER_OR_COMPASS.format(*((first, second) if side_of(effect) == "water" else (second, first)))
        elif driver_of(effect) == driver_of(other):
            text = f"a record with a wider range of {driver_of(effect).replace('_', ' ')}"
        else:
            text = OTHERWISE.format(first, second)
        phrases.append(f"{first} or {second}: {text}")
    return "; ".join(dict.fromkeys(phrases))


def level_text(level: str | None, probability: float | None, side: str, driver: str) -> str:
    """State the side and driver if only these are established; empty if the effect itself is."""
    if level == "effect":
        return ""
    if level is None or probability is None:
        return " Not even the side on which it acts is established."
    if level == "driver" and not side:
        what = driver.replace("_", " ")
        return (
            f" Established (P = {probability:.2f}): one of the two instruments changed with {what}; which of them this "
            "record cannot tell."
        )
    how = f", driven by {driver.replace('_', ' ')}" if level == "driver" and driver else ""
    return f" Established (P = {probability:.2f}): it acts on the {side}{how}."


def rank_text(placebo: Mapping[str, Any]) -> str:
    """State the rank of a gain among those of surrogates; empty without surrogates."""
    n, p = placebo["n"], placebo["rank_p"]
    return "" if p is None else f"better predicted than {n + 1 - round(p * (n + 1))} of {n}"


ACTED_ON = {
    "field_forward": "a magnetic field along the instrument",
    "field_starboard": "a magnetic field across the instrument",
    "field_down": "a magnetic field along the instrument's vertical",
    "reading": "the compass's reading",
    "lobe3": "the third harmonic of the compass's reading",
    "lobe4": "the fourth harmonic of the compass's reading",
    "flow_gain": "the gain of one beam pair over the other's",
    "flow_offset": "a velocity that is added in the instrument's frame",
    "flow_direction": "the directional shear of the current between the two depths",
}


def describe_composition(acts_on: str, driver: str, form: str) -> tuple[str, str]:
    """Describe what a composed effect acts on, and its driver and form, in words."""
    named = {
        "voltage": "supply voltage",
        "turn_rate": "rate of turn",
        "hour": "day",
        "tide": "tide (12.42 h)",
        "heading_spread": "spread of the headings within a sample",
    }
    drives = " times ".join(named.get(name, name.replace("_", " ")) for name in driver.split("*"))
    return ACTED_ON[acts_on], FORMS[form].words.format(f"the {drives}" if driver not in ("heading", "time") else drives)


def unexplained_text(where: str, size_deg: float, named: Sequence[str]) -> str:
    """Describe a mismatch that nothing in the catalogue fits."""
    beyond = f" beyond {join_names(named)}" if named else ""
    return (
        f"Recording and simulation differ{beyond} {where}, by {size_deg:.1f}° rms. "
        "No effect of the catalogue fits; the curve shows how the heading is turned."
    )


def range_text(covariate: str, low: float, high: float, *, on_land: bool = False, clocked: bool = True) -> str:
    """Describe the range of a covariate."""
    if covariate == "time" and clocked:
        return f"from {date_text(low, high - low)} to {date_text(high, high - low)}"
    units = UNITS_OF_CALIBRATIONS if on_land else UNITS
    return f"along {covariate.replace('_', ' ')} from {low:.3g} to {high:.3g} {units.get(covariate, '')}".rstrip()


def date_text(time_s: float, span_s: float) -> str:
    """Format a time: to the day in records of more than ten days, else to the second."""
    return iso_time(time_s)[:10] if span_s > LONG_RECORD_S else iso_time(time_s)


def unsettled_reason(effect: str, alternatives: Sequence[str], level: str | None, probability: float) -> str:
    """State why the attribution of a mismatch to an effect is not settled."""
    named = f"{display_name(effect)} is the likeliest cause ({100.0 * probability:.0f} %)"
    if alternatives:
        return f"{named}, but {join_names(alternatives)} would fit as well"
    return f"{named}, but {'held-out days do not confirm it' if level == 'effect' else 'it is not established'}"


def displayed_residuals(diagnosis: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Select the binned residuals to show: unexplained ones first, each covariate once."""
    left = diagnosis["unexplained"]["curves"] if diagnosis["unexplained"] else []
    taken = {curve["covariate"] for curve in left}
    others = [curve for curve in diagnosis.get("curves", []) if curve["covariate"] not in taken]
    return [curve for curve in [*left, *others] if len(curve["centre"]) > 1]


def display_name(effect: str) -> str:
    """Format the name of an effect for readers; a composed one, composed:ACTS_ON/DRIVER/FORM, is put into words."""
    if effect.startswith(COMPOSED):
        return " changing ".join(describe_composition(*effect.removeprefix(COMPOSED).split("/")))
    return "slow directional shear" if effect == SLOW_WATER else effect.replace("_", " ")


def join_names(names: Sequence[str], last: str = " or ") -> str:
    """Join the names of effects into an enumeration."""
    words = [display_name(name) for name in names]
    return last.join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
