"""Interpret the metadata of a netCDF file: quality flags, the reference north of directions, the frame of velocities.

Flags are read in CF's three forms (CF 3.5): ``flag_values`` lists mutually exclusive states, ``flag_masks`` independent
conditions, and both together bit fields with several states each. Among several conditions, flag variables or
components the worst flag applies.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from operator import or_
from typing import Any

import netCDF4
import numpy as np

from compasslib import angles
from compasslib.readers import vocabulary
from compasslib.readers.netcdf.variables import Attributes, File, Variable, find, values
from compasslib.readers.pd0 import refuse_alignment
from compasslib.records import GOOD, NOT_CHECKED, PROBABLY_BAD, PROBABLY_GOOD, Flags
from compasslib.types import Floats

SUFFIX = re.compile("_SEADATANET_QC|_quality_control|_quality_flag|_QC|_flag|_qc_agg|_qartod_results", re.IGNORECASE)
STATED = ("flag_values", "flag_masks", "flag_meanings")
ROLLUP = "aggregate_quality_flag"  # CF standard name of the flag that summarizes all others
TESTS = "_TESTS"  # suffix in this program's own product: failed tests, listed in addition to the quality flag
_Meaning = tuple[str, str]  # value or mask, and the word for it; empty without one
NAMING = ("conventions", "quality_control_conventions", "sdn_conventions_urn", "references", "long_name", "comment")


def read_flags(file: File, variable: Variable | None) -> Flags | None:
    """Read the OceanSITES flags of a variable along its dimensions of time and bins; None if it has none.

    An aggregate flag replaces all others.

    Raises:
        InputError: the flags have dimensions that the variable does not have.
    """
    if variable is None:
        return None
    names = _links(file)[variable.source.name]
    summing = [name for name in names if ROLLUP in file.variables[name].text("standard_name")]
    counted = [name for name in names if not name.endswith(TESTS)]
    component = variable.name.removeprefix(variable.source.name)
    chosen = [file.variables.get(name + component, file.variables[name]) for name in summing or counted or names]
    return vocabulary.worst_flag([_arrange(file, variable, flags) for flags in chosen]) if chosen else None


def note_unlinked(file: File) -> None:
    """Note flag variables along time that are not linked to any variable of the file."""
    links = {name: names for name, names in _links(file).items() if names}
    linked = {*links, *(name for names in links.values() for name in names)}
    alone = [name for name, v in file.variables.items() if file.time in v.spans and _states_flags(v)]
    if alone := [name for name in alone if name == file.variables[name].source.name and name not in linked]:
        file.notes.append(
            f"Flags {', '.join(alone[:5])} belong to no variable of the file and were not used; name them in the "
            "ancillary_variables of what they are about."
        )


def _links(file: File) -> dict[str, list[str]]:
    """List the flag variables of each variable: those listed as ancillary, and those named after it with a suffix."""
    whole = {name: v for name, v in file.variables.items() if name == v.source.name}
    links: dict[str, list[str]] = {}
    for name, variable in whole.items():
        listed = [each for each in re.split(r"[\s,;]+", variable.text("ancillary_variables")) if each in whole]
        links[name] = [each for each in listed if _states_flags(whole[each]) or SUFFIX.search(each)]
    for name in whole:
        for match in SUFFIX.finditer(name):
            if match.end() == len(name) and (stem := name[: match.start()]) in links and name not in links[stem]:
                links[stem].append(name)
    return links


def _states_flags(variable: Variable) -> bool:
    return variable.attribute(*STATED) is not None or "flag" in variable.text("standard_name")


def _arrange(file: File, variable: Variable, quality: Variable) -> Flags:
    """Reduce the flags of one flag variable to the time and bin dimensions of the variable they refer to."""
    wanted = [name for name in (file.time, file.bins) if name in variable.dimensions]
    if other := quality.spans - {*wanted}:  # the worst flag of beams or tests applies
        apart = [name for name in other if not re.search("beam|test|dir", name, re.IGNORECASE)]
        if apart or file.time not in quality.dimensions:
            shown = f"dimensions ({', '.join(quality.dimensions)})"
            advice = f"write them along those of {variable.name}, or take {quality.name} out of the file"
            raise file.refuse(quality.name, f"flags along {', '.join(filter(None, wanted))}", shown, advice)
    names = quality.dimensions
    present = [names.index(name) for name in wanted if name in names]
    codes = _decode(file, quality).transpose([*present, *(k for k in range(len(names)) if k not in present)])
    codes = codes.reshape([*(file.sizes[name] if name in names else 1 for name in wanted), -1])
    worst = vocabulary.worst_flag(list(np.moveaxis(codes, -1, 0)))
    return np.broadcast_to(worst, [file.sizes[name] for name in wanted])


def _decode(file: File, quality: Variable) -> Flags:
    """Decode the values of a flag variable to OceanSITES flags of the same shape; note unknown and unset flags."""
    stored = quality.stored()
    if stored.dtype.kind in "SUO":
        stored = np.char.strip(np.array(np.ma.filled(stored, ""), dtype=bytes if stored.dtype.kind == "S" else str))
        stored = np.char.decode(stored, "latin-1") if stored.dtype.kind == "S" else stored
    distinct, where, counts = np.unique(stored, return_inverse=True, return_counts=True)
    meanings_of, unknown, empty = _interpreter(file, quality), Counter[str](), 0
    codes = np.full(len(distinct), NOT_CHECKED, dtype=np.int8)
    for k, (value, n) in enumerate(zip(distinct.tolist(), counts.tolist(), strict=True)):
        if _is_empty(quality, value):
            empty += n
            continue
        meanings = meanings_of(_label(value))
        known = {word or label: vocabulary.flag_of(label, word, file.meanings) for label, word in meanings}
        unknown.update({word: n for word, flag in known.items() if flag is None})
        flags = [PROBABLY_BAD if flag is None else flag for flag in known.values()]
        codes[k] = vocabulary.worst_flag(flags or [NOT_CHECKED])
    if empty:
        file.note(f"{quality.name}: {empty} flags were never written; they count as not checked.")
    if unknown:
        file.note(vocabulary.describe_unknown_flags(quality.name, unknown))
    return codes[where].reshape(stored.shape)


def _is_empty(quality: Variable, value: Any) -> bool:
    """Return whether a value was never written: a blank, NaN, or a fill value without a stated meaning."""
    if value == "" or value != value:
        return True
    # The default fill value of a byte may be a regular value.
    is_byte = not isinstance(quality.dtype, np.dtype) or quality.dtype.itemsize == 1
    default = None if is_byte else netCDF4.default_fillvals.get(quality.dtype.str[1:])
    fills = [quality.attributes.get("_fillvalue", default), quality.attribute("missing_value")]
    is_fill = any(np.asarray(fill).size == 1 and np.asarray(fill).item() == value for fill in fills if fill is not None)
    return is_fill and _label(value) not in _listed(quality.attribute("flag_values"))


def _interpreter(file: File, quality: Variable) -> Callable[[str], list[_Meaning]]:
    """Choose the function that interprets a flag value, by the form in which the variable states meanings."""

    def by_values(table: Mapping[str, str]) -> Callable[[str], list[_Meaning]]:
        return lambda label: [(label, table.get(label, ""))]

    meanings = quality.attribute("flag_meanings")
    words = [word for word in re.split(r"[\s,;]+", meanings.strip()) if word] if isinstance(meanings, str) else []
    words = words or [vocabulary.normalize(word) for word in np.atleast_1d(meanings if meanings is not None else [])]
    values, masks = (_listed(quality.attribute(name)) for name in ("flag_values", "flag_masks"))
    is_number = isinstance(quality.dtype, np.dtype) and quality.dtype.kind in "iu"
    if len(values) == 1 < len(words) == len(values[0]):
        values = list(values[0])  # characters joined in one string
    if words and is_number and len(masks) == len(words) and len(values) in (0, len(words)):
        return partial(_by_masks, file, 8 * quality.dtype.itemsize, words, masks, values)
    if words and len(values) == len(words):
        table = dict(zip(values, words, strict=True))
        if not is_number and all(map(str.isdigit, values)):  # characters stated by their codes
            table = {chr(int(value)): word for value, word in table.items()} | table
        return by_values(table)
    texts = [quality.text(name) for name in NAMING]
    texts += [quality.name, file.text("conventions"), file.text("data_type")]
    name, known = vocabulary.find_vocabulary(*texts)
    says = f"those of {name} are taken, which the file names." if name else "the file names no vocabulary."
    file.note(f"{quality.name} does not state what its flags mean: {says}")
    return by_values({str(ord(value)): word for value, word in known.items()} | {**known})


def _listed(stated: Any) -> list[str]:
    """Split flag values or masks into strings, from an array or from a single string."""
    if stated is None:
        return []
    if isinstance(stated, str):
        items = [item for item in re.split(r"[\s,;]+", stated.strip("[] ")) if item]
        return [re.sub(r"^([-+]?\d+)[bBsSlLuU]+$", r"\1", item) for item in items]
    return [_label(item) for item in np.atleast_1d(stated).tolist()]


def _label(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _by_masks(
    file: File, bits: int, words: Sequence[str], masks: Sequence[str], values: Sequence[str], label: str
) -> list[_Meaning]:
    """List the conditions of a bit field that hold, and the value itself if it has bits or a state without meaning."""
    number, *fields = (int(text) % 2**bits for text in (label, *masks))
    states = [int(text) % 2**bits for text in values] or fields
    pairs = zip(fields, states, strict=True)
    holds = [number & mask == state if values else number & mask > 0 for mask, state in pairs]
    conditions = [*zip(masks, words, strict=True)]
    holding = [each for each, is_so in zip(conditions, holds, strict=True) if is_so]
    explained = reduce(or_, (mask for mask, is_so in zip(fields, holds, strict=True) if is_so), 0)
    flags = {vocabulary.flag_of(*each, file.meanings) for each in conditions}
    is_not_good = not holding and bool({GOOD, PROBABLY_GOOD} & flags)  # a condition that means "good" does not hold
    if label in file.meanings:
        return [(label, "")]
    return [*holding, (label, "")] if number & ~explained or is_not_good else holding


# Reference north of a file's directions, and the declination contained in them.
#
# For magnetic north a stated declination is removed, or ``declination_applied`` instead; other contradictions to the
# mooring file raise an error, as a wrong north rotates every current. Recognized are statements of CF (eastward is
# true), IMOS (``UCUR_MAG``, ``compass_correction_applied``), dolfyn (``declination``), ADCPy
# (``magnetic_variation_applied``), stglib (in its history) and this program's product (``reference``, ``DECLINATION``).

TRUE_BY_NAME = (  # CF standard names
    *("eastward_sea_water_velocity", "sea_water_velocity_to_direction", "direction_of_sea_water_velocity"),
)
MAGNETIC, TRUE = "magnetic", "true"
STGLIB = re.compile(r"[Rr]otating heading and horizontal velocities by ([-+]?[\d.]+) degrees")
# For example IMOS' compass_correction_applied, EPIC's magnetic_variation_applied, WHOI's magnetic_correction_applied.
APPLIED = re.compile(r"(?=.*(?:compass|magnetic|magvar|declination)).*_applied")
ALIGNMENTS = {"heading_misalign_deg": 1.0, "heading_alignment": 0.01}  # unit, degrees: of dolfyn; of ADCPy and stglib
ALIGNMENTS |= {"trdi_heading_alignment_hundredths_of_deg": 0.01, "trdi_heading_alignment_hundredths_of_deg.": 0.01}
WHICH = "write direction_reference: true, or declination_applied: DEGREES where the declination is to be taken out"


@dataclass(frozen=True)
class North:
    """Reference north stated by a file; a declination is None where its value is not stated."""

    word: str  # magnetic, true or empty
    degrees: Floats | None  # declination contained in the velocities
    heading_degrees: Floats | None  # declination contained in the headings
    why: str  # attribute or variable that states it


def find_north(file: File, east: Variable, heading: Variable | None) -> North:
    """Find the reference north that the file states for its velocities and headings."""
    stated = [(f"{name} {degrees:g}", degrees) for name, degrees in [*_applied(east), *_applied(file)]]
    stated += [("stglib's history", float(degrees)) for degrees in STGLIB.findall(file.text("history"))[-1:]]
    if "coord_sys" in file.attributes:  # dolfyn rotates by the declination only, and records it
        degrees = _number(file.attribute("declination")) or 0.0
        stated.append((f"dolfyn's declination {degrees:g}", degrees))
    words, why, in_velocity = _words(east), east.name, None
    if stated:
        why, word, in_velocity = stated[0][0], TRUE if stated[0][1] else MAGNETIC, np.asarray(stated[0][1])
    elif MAGNETIC in words:
        word, in_velocity = MAGNETIC, np.zeros(())
    elif "true north" in words or east.text("standard_name") in TRUE_BY_NAME:
        word, series = TRUE, find(file, "declination", (file.time,), ())
        why += "'s reference" if "true north" in words else "'s standard_name"
        if series is not None:
            why, in_velocity = f"{why} and {series.name}", values(file, "declination", series)
    else:
        word = ""
    in_heading = in_velocity
    if heading is None or MAGNETIC in _words(heading):
        in_heading = np.zeros(())
    elif own := _applied(heading):
        in_heading = np.asarray(own[0][1])
    return North(word, in_velocity, in_heading, why)


def _applied(holder: Attributes) -> list[tuple[str, float]]:
    """List the attributes that state a declination in degrees as applied."""
    names = filter(APPLIED.fullmatch, holder.attributes)
    return [(name, degrees) for name in names if (degrees := _number(holder.attribute(name))) is not None]


def resolve_north(file: File, north: North) -> tuple[Floats, Floats | None]:
    """Determine the declination to remove from velocities, and from headings unless these cannot be used, degrees.

    Raises:
        InputError: mooring file and netCDF file contradict each other, or leave the declination undetermined.
    """
    reference, applied = file.reference, file.declination
    if applied is not None:
        if applied.velocity and (reference == TRUE or north.word == MAGNETIC):
            said = "direction_reference: true" if reference == TRUE else north.why
            advice = "delete one of the two" if reference == TRUE else "delete declination_applied"
            raise file.refuse("directions", f"no declination_applied beside {said}", str(applied), advice)
        if north.degrees is not None and np.round(north.degrees - applied.velocity, 2).any():
            reason = f"although {north.why} says {_in_degrees(north.degrees)}"
            file.notes.append(f"declination_applied of {applied} degrees was taken out of the directions, {reason}.")
        if applied.differs:
            return np.asarray(applied.velocity), np.asarray(applied.heading)
        magnetic = north.heading_degrees is not None and north.word == TRUE and not np.any(north.heading_degrees)
        return np.asarray(applied.velocity), np.asarray(0.0 if magnetic else applied.heading)
    if reference == TRUE:
        if north.word == MAGNETIC:
            expected, advice = "true north, as direction_reference says", "write direction_reference: magnetic"
            raise file.refuse("directions", expected, f"magnetic north by {north.why}", advice)
        if north.heading_degrees is None:
            file.notes.append(
                "Headings are left out, as the file does not tell the declination in them; declination_applied: "
                "DEGREES, beside direction_reference: magnetic, takes it out of headings and velocities, "
                "declination_applied: {heading: DEGREES, velocity: 0} out of headings alone, {heading: 0, velocity: "
                "DEGREES} out of velocities alone, as where only these were rotated."
            )
        return np.zeros(()), north.heading_degrees
    if north.degrees is not None and np.any(north.degrees):
        file.notes.append(f"{north.why}: {_in_degrees(north.degrees)} of declination were taken out of the directions.")
    if north.word == TRUE and north.degrees is None:
        expected = "magnetic north, as direction_reference says"
        raise file.refuse("directions", expected, f"true north by {north.why}", WHICH)
    if not north.word:
        for name in ("magnetic_variation", "magnetic_variation_at_site", "magnetic_declination"):
            if stated := _number(file.attribute(name)):
                advice = f"write declination_applied: {stated:g} where the directions hold it, 0 where they do not"
                raise file.refuse(name, "a word whether it was applied", f"{stated:g} degrees without one", advice)
        file.notes.append(
            "The file does not say which north its directions count from; direction_reference: magnetic counts."
        )
    degrees = np.zeros(()) if north.degrees is None else north.degrees
    return degrees, degrees if north.heading_degrees is None else north.heading_degrees


def heading_alignment(file: File, heading: Variable | None) -> float:
    """Determine the degrees to add to headings for the instrument's heading alignment EA.

    Raises:
        InputError: a nonzero EA without ``heading_alignment`` in the mooring file, or the reverse.
    """
    if heading is None:
        return 0.0
    stated, holders = file.alignment, (heading, file)
    given = ((n, unit * (_number(each.attribute(n)) or 0.0)) for n, unit in ALIGNMENTS.items() for each in holders)
    name, degrees = next(((name, degrees) for name, degrees in given if degrees), ("heading alignment EA", 0.0))
    refuse_alignment(f"{file.path}: {name}", np.array([degrees]), stated)
    if degrees:
        added = f"heading_alignment of {stated or 0.0:g} degrees was added to the headings"
        file.note(f"{added}; {name} is {degrees:g} degrees.")
    return stated or 0.0


def _words(variable: Variable) -> str:
    parts = [variable.text(name) for name in ("standard_name", "long_name", "reference", "reference_datum", "units")]
    return " ".join([*parts, "magnetic" * variable.name.upper().endswith("_MAG")]).lower()


def _number(value: object) -> float | None:
    try:
        return None if value is None else float(np.asarray(value, dtype=float).ravel()[0])
    except (TypeError, ValueError, IndexError):
        return None


def _in_degrees(degrees: Floats) -> str:
    return f"{np.nanmedian(degrees):.2f} degrees"


# Frames: Nortek's XYZ is turned by the heading beside it, and rotated components by the directions towards which they
# say that they are positive. No other frame can be turned without a guess.

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
OTHER_FRAME = (
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
