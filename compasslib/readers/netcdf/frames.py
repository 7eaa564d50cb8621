"""Find by its words in which frame a netCDF file has its velocity components, and turn them to east and north.

Nortek's XYZ is turned by the heading beside it, and rotated components by the directions towards which they say that
they are positive. No other frame can be turned without a guess.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.readers.netcdf.variables import Attributes, File, Variable
from compasslib.readers.units import SPEED
from compasslib.types import Floats

_PLACES = "shore|shelf|slope|isobath|channel|stream|flow|track|ax[ie]s|canyon|strait|fjord|section|bank|river|valley"
_FLOW = "(?:velocity|speed|current|component|direction)"
_ELSEWHERE = re.compile(  # words of other frames, whatever else the text says
    rf"(?:along|cross|across)[ -]*(?:{_PLACES})|\blong-?shore|\b(?:on|off)shore {_FLOW}|\bstreamwise|\bdownstream"
    r"|(?:principal|major|minor)[ -]ax[ie]s|\b(?:model|native|curvilinear|rotated)[ -]grid"
    r"|\bgrid[ -]*(?:[xyuvij]\b|east|north|ax[ie]s|coord|relative|direction)"
    r"|\b(?:ship|vessel|platform)(?:'s)?[ -](?:frame|coord|ax[ie]s|relative)"
    rf"|relative (?:the )?(?:ship|vessel|platform)|\b(?:starboard|forward|fore-?aft|athwart\w*)[ -]{_FLOW}"
)
_ROTATED = re.compile(
    r"\brotat(?:ed|ion)\b"
    r"(?!.{0,40}(?:declination|variation|\b(?:in|on)?to (?:the )?(?:true|geographic|earth|enu|magnetic|east|north)))"
)
_INSTRUMENT = re.compile(  # words that "east" in the same text overrules, as in Nortek's "Velocity (Beam1|X|East)"
    rf"beam ?[1-5]\b|\bbeam[ -](?:{_FLOW}|coord|frame)|along[ -]beam|\bradial|\bxyz\b"
    rf"|\b[xy][ -](?:{_FLOW}|axis|sea water)"
    r"|\bvel(?:ocity)?[ -]?[xy]\b|\b(?:instrument|sensor|body|head)(?:'s)?[ -](?:frame|coord|ax[ie]s|reference)"
)
_NAMES = re.compile(r"(?:^| )(?:along|across|cross|rot|rotated|grid|inst|ship|[xy])(?:$| )")
_FROM = re.compile(r"\bfrom (?:\S+ ){1,3}(?:in)?to (?:the )?(?:earth|geographic|true|enu|east)\w*")
_EAST = re.compile(r"east|north|\b(?:[uv]cur|ewct|nsct|[uv] 120[56]|lc[en][ws]ap01)\b")
_SYSTEM = re.compile(r"coord\w*(?:sys|trans|frame)|(?:velocity|reference|ref)_?frame|^frame$", re.IGNORECASE)
_SYSTEMS = re.compile(r"\b(?:xyz|beam|inst|ship|vessel|body|grid|rotat|principal)|shore")
_ROTATION = re.compile(r"rotat\w*_?angle\w*|angle_of_rotation|rotation(?:_deg\w*)?", re.IGNORECASE)
_AZIMUTH = re.compile(r"(?:positive_)?(?:direction|azimuth|bearing)(?:_deg\w*)?", re.IGNORECASE)
_TOWARDS = re.compile(r"\b(?:along|towards?|positive)\b\D{0,15}?(\d+(?:\.\d+)?) ?(?:°|deg)")
_NOT_FROM_NORTH = re.compile(r"counter|anti|from (?:the )?east|mathematical")
ADVICE = (
    "give east and north or the instrument's own file, or write in both long names the direction from north, as "
    "'towards 36.5 degrees'"
)


def other_frame(file: File, pair: Sequence[Variable]) -> str:
    """Find the words that give two components another frame than east and north; empty without any."""
    for variable in pair:
        texts = list(_texts(variable))
        is_east = any(_EAST.search(text) for name, text in texts if name != "comment")
        for name, text in texts:
            words = _FROM.sub("", text)
            here = _EAST.search(words) or (is_east and name == "comment")
            if (
                _ELSEWHERE.search(words)
                or _ROTATED.search(words)
                or (not here and _INSTRUMENT.search(words))
                or (not name and not is_east and _NAMES.search(words))
                or (name != "comment" and _TOWARDS.search(words))
            ):
                return f"{variable.name} ({text})" if name else variable.name
        stated = [*_systems(variable), *_systems(file)]
        if stated and is_east:
            file.note(f"{stated[0]} stands beside {variable.name}, which counts as east and north, as it is named.")
        elif stated:
            return f"{variable.name} ({stated[0]})"
    return ""


def other_frames(file: File) -> str:
    """List the velocities of a file that are not named as east and north; empty without any."""
    flows = [variable for variable in file.variables.values() if variable.text("units").lower() in SPEED]
    return ", ".join(filter(None, (other_frame(file, [variable]) for variable in flows)))


def turns_with_heading(file: File, pair: Sequence[Variable]) -> bool:
    """Return whether the components are X and Y of Nortek's XYZ, of which X points along the heading."""
    words = [text for variable in pair for _, text in _texts(variable)]
    words += [text for holder in (file, *pair) for text in _systems(holder)]
    makers = " ".join(map(str, file.attributes.values()))
    return any(re.search(r"\bxyz\b", text) for text in words) and not re.search(r"(?i)rdi\b|teledyne|workhorse", makers)


def turn_axes(file: File, pair: Sequence[Variable], flow: Sequence[Floats]) -> tuple[Floats, Floats] | None:
    """Compute east and north from components along two stated directions; None unless these are at right angles.

    Both directions may be rounded to whole degrees.
    """
    texts = [" ".join(text for _, text in _texts(variable)) for variable in pair]
    found = [_TOWARDS.search(text) for text in texts]
    if not all(found) or any(map(_NOT_FROM_NORTH.search, texts)):
        return None
    towards = np.array([float(match[1]) for match in found if match])
    if abs(abs(float(angles.difference(*towards))) - 90.0) > 1.0:
        return None
    sine, cosine = angles.sin_cos(towards)
    file.note(f"{pair[0].name} and {pair[1].name} were turned from {towards[0]:g} and {towards[1]:g} degrees.")
    return flow[0] * sine[0] + flow[1] * sine[1], flow[0] * cosine[0] + flow[1] * cosine[1]


def _texts(variable: Variable) -> Iterator[tuple[str, str]]:
    """Yield attribute and text of what describes a variable, the name first, in lower case without underscores."""
    listed: list[tuple[str, Any]] = [("", variable.name)]
    listed += [(name, variable.text(name)) for name in ("standard_name", "long_name", "description", "comment")]
    listed += [(n, f"towards {value} degrees") for n, value in variable.attributes.items() if _AZIMUTH.fullmatch(n)]
    for name, text in listed:
        if text:
            yield name, re.sub(r"[_\s]+", " ", text).lower().replace("relative to", "relative")


def _systems(holder: Attributes) -> Iterator[str]:
    """Yield attributes that name another coordinate system than the earth's, or a rotation."""
    for name, stated in holder.attributes.items():
        value = str(stated).lower()
        other = _SYSTEM.search(name) and _SYSTEMS.search(value) and not re.search("earth|enu", value)
        angle = _ROTATION.fullmatch(name) and re.fullmatch(r"-?\d+\.?\d*", value) and float(value)
        if other or angle or (name in ("comment", "summary") and _ROTATED.search(_FROM.sub("", value))):
            yield f"{name}: {value}"
