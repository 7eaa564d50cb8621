"""Convert a netCDF file to a record: identify variables, locate bins and resolve the reference north.

Corrupted values go unnoticed in an HDF5 file without checksums, which is the usual case.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers import nortek, times, vocabulary
from compasslib.readers.files import DAMAGE_ERRORS
from compasslib.readers.netcdf import attributes, variables
from compasslib.readers.netcdf.variables import File, Variable, find, values
from compasslib.readers.pd0.currents import true_pitch
from compasslib.readers.vocabulary import SPEED
from compasslib.records import DEEPEST_M, GOOD, PROBABLY_BAD, Flags, Record, join_records, new_record
from compasslib.types import DAY_S, Floats

ATMOSPHERE_DBAR = 10.1325  # IMOS' PRES is absolute pressure
SIGNED = ("HEIGHT_ABOVE_SENSOR",)  # ranges that are positive upward
NOMINAL = ("nominal_instrument_depth", "instrument_nominal_depth", "nominal_sensor_depth")
SERIAL_NUMBERS = ("serial_number", "serialnum", "instrument_serial_number")
MANUFACTURERS = ("manufacturer", "instrument_manufacturer", "instrument_make", "inst_make", "sensor_manufacturer")
MODELS = ("model", "instrument_model", "inst_model", "sensor_model")
BEAM_ANGLES = ("beam_angle", "rdi_beam_angle", "trdi_beam_angle")
SPLIT_ADVICE = (
    "write the rows of one instrument as a table with time and depth (format: table): rows of one time are its bins"
)
ADVICE = "check that format: netcdf and the file belong together"
# Names of further profiles; the braces stand for dolfyn's suffix of averages, or the number of a beam.
VELOCITIES: Mapping[str, tuple[str, ...]] = {
    "up": ("WCUR", "w_1204", "vel_up", "up", "w", "vel{}[U]", "vel{}[U1]"),
    "error_velocity": ("ERROR_VELOCITY", "ECUR", "Werr_1201", "Werr", "vel{}[err]"),
}
COUNTS: Mapping[str, tuple[str, ...]] = {
    "echo": ("ECHO_INTENSITY", "ABSIC{}", "amp"),
    "correlation": ("CORRELATION", "CMAG{}", "corr"),
    "percent_good": ("PERCENT_GOOD", "PERG{}", "prcnt_gd"),
}
BEAMS = ("BEAM", "beam")
_Flow = tuple[Floats, Floats, Floats | None]  # (n, m) east, north and up, or the first to third of other axes, m/s


def read(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, str | float | None] | None,
    orientation: str | None,
    declination_applied: float | Mapping[str, float] | None,
    direction_reference: str,
    heading_alignment: float | None = None,
    flags: Mapping[str, Sequence[object]] | None = None,
) -> Record:
    """Read the files of one instrument in order of time, with currents relative to ``direction_reference``.

    Settings override what the file states; ``columns`` (role -> variable name) is for names that do not identify the
    variable, ``flags`` for flag meanings or values that are in no known vocabulary.

    Raises:
        InputError: a file is unreadable, or its variables, units, bins or reference north are undetermined.
    """
    settings = {
        "columns": {role: name for role, name in (columns or {}).items() if name is not None},
        "meanings": vocabulary.parse_flag_settings(flags),
        "orientation": orientation,
        "reference": direction_reference,
        "declination": parse_applied_declination(declination_applied),
        "alignment": heading_alignment,
    }
    records = []
    for path in map(Path, paths):
        try:
            with netCDF4.Dataset(path) as nc:
                variables.refuse_truncated(path, nc)
                records.append(_record(*_open(path, *variables.find_series(path, nc), settings)))
        except DAMAGE_ERRORS as error:
            shown = f"{type(error).__name__}: {error}"
            raise InputError(str(path), expected="a whole netCDF file", found=shown, advice=ADVICE) from None
    return join_records(records)


def _open(path: Path, nc: Any, stated: Mapping[str, Any], settings: Mapping[str, Any]) -> tuple[File, Floats, Flags]:
    """Open a file along its time dimension; read times, and flags that are GOOD unless the time is doubtful."""
    if (system := str(stated.get("coord_sys", "earth"))) != "earth":
        advice = "give the instrument's own file, or save it after rotate2(ds, 'earth')"
        raise InputError(f"{path}: coord_sys", expected="earth", found=system, advice=advice)
    sizes, holder = dict[str, int](), nc
    while holder is not None:
        sizes = {name: dimension.size for name, dimension in holder.dimensions.items()} | sizes
        holder = holder.parent
    file = File(stated, path, variables.variables_of(path, nc), sizes, **settings)
    time = variables.time_variable(file.columns.get("time"), file.variables)
    if time is None:
        shown = ", ".join(file.variables) or "no variables"
        advice = "name it in the mooring file: columns: {time: NAME}"
        raise file.refuse("time", "a variable with a unit such as days since", shown, advice)
    long = [name for name in time.dimensions if sizes[name] > 1] or list(time.dimensions[:1])
    if len(long) != 1:
        shown = f"dimensions ({', '.join(time.dimensions)})"
        raise file.refuse(time.name, "one dimension", shown, "write one series a file, not bursts")
    # A column map may name dolfyn's variable of all components, once or twice.
    given = file.columns.get("east") or file.columns.get("north")
    both = {role: f"{file.columns.get(role) or given}[{role[0].upper()}]" for role in ("east", "north")}
    components = {role: name for role, name in both.items() if name in file.variables}
    file = replace(file, time=long[0], columns={**file.columns, **components})
    for variable in file.variables.values():  # CF's ragged arrays (9.3.3 and 9.3.4)
        instances = variable.text("instance_dimension") if variable.dimensions == (file.time,) else ""
        if not instances and variable.dimensions and variable.text("sample_dimension") == file.time:
            instances = variable.dimensions[0]
        if (count := sizes.get(instances, 0)) > 1:
            shown = f"{count} in one, by {variable.name}"
            raise file.refuse(file.time, "the series of one instrument", shown, SPLIT_ADVICE)
    time_s, flags = variables.read_times(file, time), attributes.read_flags(file, time)
    known = time_s[np.isfinite(time_s)]
    year = 1970.0 + float(np.median(known)) / (365.2425 * DAY_S) if known.size else 1970.0
    if not times.YEARS[0] <= year < times.YEARS[1]:
        expected, shown = f"times of {times.YEARS[0]} to {times.YEARS[1] - 1}", f"the year {year:.0f}"
        other = "name another variable in the mooring file: columns: {time: NAME}"
        raise file.refuse(time.name, expected, shown, other)
    bad = np.full(len(time_s), GOOD) if flags is None else np.where(flags < PROBABLY_BAD, GOOD, flags)
    return file, time_s, bad.astype(np.int8)


def _record(file: File, time_s: Floats, time_flags: Flags) -> Record:
    file, n = _with_bins(file), len(time_s)
    pair, stored, quality = _read_flow(file, n)
    heading_variable, recorded, heading_flags = _read_heading(file, n)
    heading_flags = vocabulary.worst_flag([heading_flags, time_flags])
    flow, by_heading = _turn_other_frame(file, pair, stored, recorded)
    if by_heading:
        quality = vocabulary.worst_flag([quality, heading_flags[:, None]])
    east, northward, up = flow
    of_north = heading_variable if by_heading and heading_variable is not None else pair[0]
    north = attributes.find_north(file, of_north, heading_variable)
    in_velocity, in_heading = attributes.resolve_north(file, north)
    if by_heading and in_heading is not None:
        in_velocity = in_heading
    if np.any(in_velocity):
        by = in_velocity[:, None] if in_velocity.ndim else in_velocity
        east, northward = angles.turn(east, northward, -by)
    added = attributes.heading_alignment(file, heading_variable)
    heading = angles.wrap360(recorded + added - (np.nan if in_heading is None else in_heading))
    ranges, looks_up, depth = _bins(file, n, east.shape[1])
    by_depth = np.lexsort((depth, time_s))
    again = int(np.sum((np.diff(time_s[by_depth]) == 0.0) & (np.diff(depth[by_depth]) > 0.0)))
    if file.bins is None and again > 0.1 * n:  # bins as rows of one series
        shown = f"{again} of {n} times repeated at another depth"
        raise file.refuse(file.time, "one row a time", shown, SPLIT_ADVICE)
    quality = vocabulary.worst_flag([quality, time_flags[:, None]])
    backwards = ranges.shape[1] > 1 and np.nanmedian(np.diff(ranges, axis=1)) < 0.0
    order = slice(None, None, -1) if backwards else slice(None)
    attributes.note_unlinked(file)
    angle = file.attribute(*BEAM_ANGLES)
    if angle is None and east.shape[1] > 1:
        file.notes.append("The file does not state the angle of the beams: bins that side lobes reach are not flagged.")
    pitch, roll = (_series(file, role, n) for role in ("tilt_x", "tilt_y"))
    if file.text("inst_make") == "TRDI":  # dolfyn stores the tilt sensor's pitch, measured inside the roll
        pitch = true_pitch(pitch, roll)
    return new_record(
        time_s,
        east[:, order],
        northward[:, order],
        bin_range_m=ranges[:, order],
        heading_deg=heading,
        pitch_deg=pitch,
        roll_deg=roll,
        recorded_in="instrument" if by_heading else "",
        pressure_dbar=_read_pressure(file, n),
        depth_m=depth,
        temperature_c=_series(file, "temperature", n),
        quality=quality[:, order],
        heading_quality=heading_flags,
        looks_up=looks_up,
        beam_angle_deg=0.0 if angle is None else float(np.asarray(angle).ravel()[0]),
        direction_reference=file.reference,
        heading_bias_deg=float(np.median(in_heading)) if in_heading is not None else 0.0,
        velocity_bias_deg=float(np.median(in_velocity)),
        serial_number=str(file.attribute(*SERIAL_NUMBERS, f"serialnum{file.suffix}") or ""),
        manufacturer=str(file.attribute(*MANUFACTURERS) or ""),
        model=str(file.attribute(*MODELS) or ""),
        profiles=_profiles(file, up, east.shape, order),
        counts={
            "samples": n,
            "velocities": int(np.isfinite(east).sum()),
            "velocities_flagged": int(((quality > 2) & np.isfinite(east + northward)).sum()),
        },
        warnings=tuple(f"{file.path.name}: {note}" for note in file.notes),
        unstated=(
            *["orientation"] * (file.bins is None and not (file.orientation or _stated_orientation(file))),
            *["direction_reference"] * (not north.word and file.declination is None),
        ),
    )


def _read_flow(file: File, n: int) -> tuple[Sequence[Variable], _Flow, Flags]:
    """Read the two variables of the velocity, (n, m) m/s and flags, and name those that tell its frame."""
    roles = _flow_roles(file)
    pair = [_component(file, role) for role in roles]
    first, second = (values(file, role, variable).reshape(n, -1) for role, variable in zip(roles, pair, strict=True))
    known = [flags for variable in pair if (flags := attributes.read_flags(file, variable)) is not None]
    quality = vocabulary.worst_flag(known or [np.full(first.shape, GOOD)]).reshape(n, -1)
    if roles[0] == "direction":
        pair = pair[:1] * 2  # a direction has no other frame
        first, second = angles.components(second, np.where((first < -180.0) | (first > 360.0), np.nan, first))
    return pair, (first, second, _velocity(file, "up")), quality


def _read_heading(file: File, n: int) -> tuple[Variable | None, Floats, Flags]:
    """Find the variable of the heading, and read it, (n,), with its flags."""
    variable = find(file, "heading", (file.time,))
    if variable is None:
        return None, np.full(n, np.nan), np.full(n, GOOD, dtype=np.int8)
    heading = np.broadcast_to(values(file, "heading", variable), n)
    wrong = (heading < -180.0) | (heading > 360.0)  # as -999 and 65535 of a logger
    if wrong.any():
        file.note(f"{int(wrong.sum())} headings are no angles and count as missing.")
    flags = attributes.read_flags(file, variable)
    return variable, np.where(wrong, np.nan, heading), np.full(n, GOOD, dtype=np.int8) if flags is None else flags


def _read_pressure(file: File, n: int) -> Floats:
    """Read the pressure relative to the atmosphere's, (n,) dbar."""
    variable = find(file, "pressure", (file.time,))
    pressure = _series(file, "pressure", n, variable)
    beyond = np.abs(pressure) > DEEPEST_M  # MHKiT writes a pressure below the atmosphere's as 2^32
    if beyond.any():
        file.note(f"{int(beyond.sum())} pressures lie beyond {DEEPEST_M} dbar and count as missing.")
        pressure[beyond] = np.nan
    if variable is not None and variable.name == "PRES" and "IMOS" in file.text("conventions"):
        file.notes.append(f"PRES of IMOS is absolute: {ATMOSPHERE_DBAR} dbar of atmosphere were subtracted.")
        pressure -= ATMOSPHERE_DBAR
    return pressure


def _with_bins(file: File) -> File:
    """Find the bin dimension, and treat ``depth`` of the column map as bin depths if it varies by bin."""
    first = _component(file, _flow_roles(file)[0])
    other = [name for name in first.dimensions if name in first.spans - {file.time}]
    if len(other) > 1:
        shown = ", ".join(f"{name} ({file.sizes[name]})" for name in other)
        raise file.refuse(first.name, "one dimension beside time", shown, "write one station a file")
    columns, bins = dict(file.columns), next(iter(other), None)
    named = file.variables.get(str(columns.get("depth")))
    if named is not None and bins in named.dimensions:
        columns["cell_depth"] = columns.pop("depth")
    of_dolfyn = first.name != first.source.name
    suffix = first.source.name.removeprefix("vel") if of_dolfyn else ""
    other_series = "vel" if suffix else "vel_avg"
    if of_dolfyn and other_series in file.variables and not {"time", "east", "north"} & {*columns}:
        file.note(
            f"{first.source.name} was read; {other_series} is another series of the same instrument, which columns: "
            f"{{time: time{other_series.removeprefix('vel')}}} reads instead."
        )
    return replace(file, bins=bins, columns=columns, suffix=suffix)


def _flow_roles(file: File) -> tuple[str, str]:
    """Choose direction and speed where the mooring file names them, or the file has no other velocities."""
    if {"east", "north"} & {*file.columns}:
        return "east", "north"
    there = {role for role in ("east", "direction") if find(file, role, *_profile_dimensions(file)) is not None}
    return ("direction", "speed") if "direction" in file.columns or there == {"direction"} else ("east", "north")


def _profile_dimensions(file: File) -> list[tuple[str, ...]]:
    return [*((file.time, name) for name in file.sizes if name != file.time), (file.time,)]


def _component(file: File, role: str) -> Variable:
    variable = find(file, role, *_profile_dimensions(file))
    if variable is None:
        there, advice = ", ".join(file.variables), f"name it in the mooring file: columns: {{{role}: NAME}}"
        flows = [each for each in file.variables.values() if each.text("units").lower() in SPEED]
        if words := ", ".join(filter(None, (attributes.other_frame(file, [flow]) for flow in flows))):
            there, advice = words, attributes.OTHER_FRAME
        raise file.refuse(role, f"a variable of the velocity ({role})", there, advice)
    return variable


def _turn_other_frame(file: File, pair: Sequence[Variable], flow: _Flow, heading: Floats) -> tuple[_Flow, bool]:
    """Turn components that are not east and north, as far as the file says how, and tell whether by the heading."""
    words = "" if pair[0].source is pair[1].source else attributes.other_frame(file, pair)
    if not words:
        return flow, False
    if not attributes.turns_with_heading(file, pair) or find(file, "heading", (file.time,)) is None:
        turned = attributes.turn_axes(file, pair, flow[:2])
        if turned is None:
            raise file.refuse("velocities", "east and north", words, attributes.OTHER_FRAME)
        return (*turned, flow[2]), False
    x, y, z = flow
    tilts = [np.nan_to_num(_series(file, role, len(x))) * (z is not None) for role in ("tilt_x", "tilt_y")]
    side = np.full((1, 1), -1.0 if _looks_up(file, None) else 1.0)
    axes = np.stack([x, y, np.zeros_like(x) if z is None else z], axis=-1)
    east, north, up = nortek.turn_axes(axes, compass.levelling(*tilts), side, heading)
    how = "heading, pitch and roll" if np.any(tilts) else "heading alone"
    file.note(f"Velocities of the instrument's axes were turned to east and north by the {how}.")
    return (east, north, None if z is None else up), True


def _series(file: File, role: str, n: int, variable: Variable | None = None) -> Floats:
    """Read a series with flagged bad values set to NaN, and note their number."""
    variable = variable or find(file, role, (file.time,))
    if variable is None:
        return np.full(n, np.nan)
    series = np.broadcast_to(values(file, role, variable), n).astype(float)
    flags = attributes.read_flags(file, variable)
    if flags is not None and (bad := (flags >= PROBABLY_BAD) & np.isfinite(series)).any():
        file.note(f"{variable.name}: {int(bad.sum())} values are flagged and count as missing.")
        series[bad] = np.nan
    return series


def _bins(file: File, n: int, m: int) -> tuple[Floats, bool, Floats]:
    """Locate the bins from their distances to the transducer, or else from their depths.

    Return ranges, (n, m) or (1, m) metres, whether the instrument looks up, and its depth, (n,), or that of its nearest
    bin if ranges are counted from there.
    """
    depth = _series(file, "depth", n)
    if m == 1 or file.bins is None:
        cell = find(file, "cell_depth", ())
        if cell is not None and not np.isfinite(depth).any():
            depth = np.abs(_series(file, "cell_depth", n, cell))
        return np.zeros((1, 1)), (file.orientation or _stated_orientation(file)) == "up", depth
    along_bins = (file.bins,), (file.time, file.bins)
    distance, cells = (find(file, role, *along_bins) for role in ("range", "cell_depth"))
    if distance is not None:
        ranges = _places(file, "range", distance)
        sign = "down" if np.nanmax(ranges) <= 0.0 else "up" if distance.name in SIGNED else None
        return np.abs(ranges), _looks_up(file, sign), depth
    if cells is None:
        advice = "name one in the mooring file: columns: {range: NAME} (from the transducer) or {depth: NAME}"
        raise file.refuse(file.bins, "distances or depths of the bins", ", ".join(file.variables), advice)
    below = _places(file, "cell_depth", cells)
    below = -below if cells.text("positive") == "up" or np.nanmax(below) <= 0.0 else below
    if not np.isfinite(depth).any():
        scalar = file.variables.get("NOMINAL_DEPTH")
        one = scalar is not None and math.prod(scalar.shape) == 1
        nominal = scalar.numbers().item() if scalar is not None and one else file.attribute(*NOMINAL)
        depth = depth if nominal is None else np.full(n, float(nominal))
    if np.isfinite(depth).any():
        instrument = depth[:, None] if len(below) == n else np.full((1, 1), np.nanmedian(depth))
        looks_up = _looks_up(file, "up" if float(np.nanmedian(instrument - below)) > 0.0 else "down")
        return (instrument - below) * (1.0 if looks_up else -1.0), looks_up, depth
    looks_up = _looks_up(file, None)
    nearest = np.nanmax(below, axis=1) if looks_up else np.nanmin(below, axis=1)
    return np.abs(nearest[:, None] - below), looks_up, np.broadcast_to(nearest, n).astype(float)


def _places(file: File, role: str, variable: Variable) -> Floats:
    places = np.atleast_2d(values(file, role, variable))
    if not np.isfinite(places).any(axis=0).all():
        advice = "name another variable in columns"
        raise file.refuse(variable.name, "a number for every bin", "bins without any", advice)
    return places


def _stated_orientation(file: File) -> str | None:
    text = file.text("orientation").lower()
    return "up" if "up" in text else "down" if "down" in text else None


def _looks_up(file: File, by_sign: str | None) -> bool:
    orientation, stated = file.orientation, by_sign or _stated_orientation(file)
    if orientation and stated and orientation != stated:
        file.notes.append(f"The file says that it looked {stated}; {orientation} counts, as the metadata do.")
    if not (orientation or stated):
        raise file.refuse("orientation", "up or down", "neither in the file", "write orientation: up or down")
    return (orientation or stated) == "up"


def _profiles(file: File, up: Floats | None, shape: tuple[int, ...], order: slice) -> dict[str, NDArray[Any]]:
    """Read the profiles of a record: upward and error velocity, echo, correlation and percent good.

    As no heading depends on them, ambiguous variables are dropped without an error.
    """
    flows = {"up": up, "error_velocity": _velocity(file, "error_velocity")}
    profiles: dict[str, Any] = {key: flow.astype(np.float32) for key, flow in flows.items() if flow is not None}
    for key, names in COUNTS.items():
        for name in (*(f"{name}{file.suffix}" for name in names if file.suffix), *names):
            beams = [name.format(beam) for beam in range(1, 5)] if "{}" in name else [name]
            found = [file.variables[beam] for beam in beams if beam in file.variables]
            each = [counts for variable in found if (counts := _arranged(file, variable, *BEAMS)) is not None]
            if len(each) == len(beams):
                counts = each[0] if len(each) == 1 else np.stack(each, axis=-1)
                missing = ~((counts >= 0) & (counts <= 255))
                whole = np.where(missing, -1, np.rint(counts)).astype(np.int16)  # back to the recorded bytes
                profiles[key] = whole if missing.any() else whole.astype(np.uint8)
                break
    return {key: values[:, order] for key, values in profiles.items() if values.shape[:2] == shape}


def _velocity(file: File, key: str) -> Floats | None:
    names = (name.format(file.suffix) for name in VELOCITIES[key])
    variable = next((file.variables[name] for name in names if name in file.variables), None)
    flow = None if variable is None else _arranged(file, variable)
    if variable is None or flow is None:
        return None
    factor = SPEED.get(variable.text("units").lower())
    return None if factor is None else factor * flow


def _arranged(file: File, variable: Variable, *last: str) -> Floats | None:
    """Read values along time, bin and a last dimension, others squeezed; None if another is longer than 1."""
    along = {file.time, file.bins, *last}
    if not variable.is_number or variable.spans - along or file.time not in variable.dimensions:
        return None
    data = variables.arranged(file, variable, *last)
    return data if file.bins in variable.dimensions else data[:, None]
