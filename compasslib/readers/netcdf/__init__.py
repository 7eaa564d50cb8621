"""Convert a netCDF file to a record: identify variables, locate bins and resolve the reference north.

Corrupted values go unnoticed in an HDF5 file without checksums, which is the usual case.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers import flags as vocabularies
from compasslib.readers import nortek
from compasslib.readers.netcdf import attributes, frames, ocean_contour, variables
from compasslib.readers.netcdf.variables import File, find, numbers, spans, values
from compasslib.readers.pd0.currents import true_pitch
from compasslib.readers.units import SPEED
from compasslib.records import DEEPEST_M, GOOD, PROBABLY_BAD, Flags, Record, join_records, new_record
from compasslib.types import Floats

ATMOSPHERE_DBAR = 10.1325  # IMOS' PRES is absolute pressure
SIGNED = ("HEIGHT_ABOVE_SENSOR",)  # ranges that are positive upward
NOMINAL = ("nominal_instrument_depth", "instrument_nominal_depth", "nominal_sensor_depth")
COMPONENTS = "dir"  # dolfyn's dimension of velocity components
SERIAL_NUMBERS = ("serial_number", "serialnum", "instrument_serial_number")
MANUFACTURERS = ("manufacturer", "instrument_manufacturer", "instrument_make", "inst_make", "sensor_manufacturer")
MODELS = ("model", "instrument_model", "inst_model", "sensor_model")
SPLIT_ADVICE = (
    "write the rows of one instrument as a table with time and depth (format: table): rows of one time are its bins"
)
ADVICE = "check that format: netcdf and the file belong together"
# Exceptions that netCDF4 raises on damaged files; UnicodeDecodeError is a ValueError.
DAMAGE_ERRORS = (OSError, RuntimeError, IndexError, KeyError, ValueError, AttributeError, TypeError)
VELOCITIES: Mapping[str, tuple[str, ...]] = {
    "up": ("WCUR", "w_1204", "vel_up", "up", "w"),
    "error_velocity": ("ERROR_VELOCITY", "ECUR", "Werr_1201", "Werr"),
}
AMONG = {"up": ("U", "U1"), "error_velocity": ("err",)}  # labels along dolfyn's dimension of components
COUNTS: Mapping[str, tuple[str, ...]] = {
    "echo": ("ECHO_INTENSITY", "ABSIC{}", "amp"),
    "correlation": ("CORRELATION", "CMAG{}", "corr"),
    "percent_good": ("PERCENT_GOOD", "PERG{}", "prcnt_gd"),
}
BEAMS = ("BEAM", "beam")


_Flow = tuple[Floats, Floats, Floats | None]  # (n, m) east, north and up, or the first to third of other axes, m/s


@dataclass(frozen=True)
class _Settings:
    """Settings of one instrument in the mooring file; None defers to the netCDF file."""

    columns: Mapping[str, Any]
    meanings: Mapping[str, int]  # flag value or meaning -> OceanSITES flag
    orientation: str | None
    reference: str
    declination: AppliedDeclination | None
    alignment: float | None
    grouped: bool  # whether the file is OceanContour's


@dataclass(frozen=True)
class _Bins:
    range_m: Floats  # (n, m) or (1, m) vertical distance from the transducer
    looks_up: bool
    depth_m: Floats  # (n,) of the instrument, or of its nearest bin if ranges are counted from there


def read(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, str | float | None] | None,
    orientation: str | None,
    declination_applied: float | Mapping[str, float] | None,
    direction_reference: str,
    heading_alignment: float | None = None,
    flags: Mapping[str, Sequence[object]] | None = None,
    grouped: bool = False,
) -> Record:
    """Read the files of one instrument in order of time, with currents relative to ``direction_reference``.

    Args:
        columns: role -> variable name, where names and standard names do not identify the variable.
        orientation: up or down; None uses that stated in the file.
        declination_applied: declination contained in headings and velocities, degrees; overrides the file's.
        heading_alignment: degrees to add to headings; required if the file states a nonzero heading alignment EA.
        flags: good, bad and unchecked -> flag meanings or values that are in no known vocabulary.
        grouped: whether the series stand in the groups of OceanContour.

    Raises:
        InputError: a file is unreadable, or its variables, units, bins or reference north are undetermined.
    """
    named = {role: name for role, name in (columns or {}).items() if name is not None}
    declination, meanings = parse_applied_declination(declination_applied), vocabularies.parse_flag_settings(flags)
    settings = _Settings(named, meanings, orientation, direction_reference, declination, heading_alignment, grouped)
    return join_records([_read_file(Path(path), settings) for path in paths])


def _read_file(path: Path, settings: _Settings) -> Record:
    try:
        with netCDF4.Dataset(path) as nc:
            return _record(path, ocean_contour.find_series(path, nc) if settings.grouped else nc, settings)
    except DAMAGE_ERRORS as error:
        shown = f"{type(error).__name__}: {error}"
        raise InputError(str(path), expected="a whole netCDF file", found=shown, advice=ADVICE) from None


def _record(path: Path, nc: Any, settings: _Settings) -> Record:
    file, time_s, time_flags = _open(path, nc, settings)
    east, northward, quality, pair = _velocities(file)
    file, n = _with_bins(file, pair[0]), len(time_s)
    heading_variable = find(file, "heading", (file.time,))
    recorded = _headings(file, n, heading_variable)
    stated_flags = None if heading_variable is None else attributes.read_flags(file, heading_variable)
    heading_flags = vocabularies.worst_flag([GOOD if stated_flags is None else stated_flags, time_flags])
    flow, words = (east, northward, _velocity(file, "up")), "" if pair[0] is pair[1] else frames.other_frame(file, pair)
    if by_heading := bool(words) and frames.turns_with_heading(file, pair) and heading_variable is not None:
        flow = _turn_axes(file, flow, recorded, settings)
        quality = vocabularies.worst_flag([quality, heading_flags[:, None]])
    elif words:
        turned = frames.turn_axes(file, pair, flow[:2])
        if turned is None:
            raise file.refuse("velocities", "east and north", words, frames.ADVICE)
        flow = (*turned, flow[2])
    east, northward, up = flow
    of_north = heading_variable if by_heading and heading_variable is not None else pair[0]
    stated = attributes.stated_north(file, of_north, heading_variable)
    in_velocity, in_heading = attributes.resolve_north(file, stated, settings.reference, settings.declination)
    if by_heading and in_heading is not None:
        in_velocity = in_heading
    if np.any(in_velocity):
        by = in_velocity[:, None] if in_velocity.ndim else in_velocity
        east, northward = angles.turn(east, northward, -by)
    alignment = attributes.heading_alignment(file, heading_variable, settings.alignment)
    heading = recorded + alignment
    heading = np.full(n, np.nan) if in_heading is None else heading - in_heading
    heading = np.where(np.isfinite(heading), angles.wrap360(heading), np.nan)
    bins = _bins(file, n, east.shape[1], settings.orientation)
    _refuse_rows(file, time_s, bins)
    quality = vocabularies.worst_flag([quality, time_flags[:, None]])
    backwards = bins.range_m.shape[1] > 1 and np.nanmedian(np.diff(bins.range_m, axis=1)) < 0.0
    order = slice(None, None, -1) if backwards else slice(None)
    attributes.note_unlinked(file)
    angle = file.attribute("beam_angle", "RDI_Beam_Angle", "TRDI_Beam_Angle")
    if angle is None and east.shape[1] > 1:
        file.notes.append("The file does not state the angle of the beams: bins that side lobes reach are not flagged.")
    pitch = _measured(file, "tilt_x", n)
    if file.text("inst_make") == "TRDI":  # dolfyn stores the tilt sensor's pitch, measured inside the roll
        pitch = true_pitch(pitch, _series(file, "tilt_y", n))
    return new_record(
        time_s,
        east[:, order],
        northward[:, order],
        bin_range_m=bins.range_m[:, order],
        heading_deg=heading,
        pitch_deg=pitch,
        roll_deg=_measured(file, "tilt_y", n),
        recorded_in="instrument" if by_heading else "",
        pressure_dbar=_pressure(file, n),
        depth_m=bins.depth_m,
        temperature_c=_measured(file, "temperature", n),
        quality=quality[:, order],
        heading_quality=heading_flags,
        looks_up=bins.looks_up,
        beam_angle_deg=0.0 if angle is None else float(np.asarray(angle).ravel()[0]),
        direction_reference=settings.reference,
        heading_bias_deg=float(np.median(in_heading)) if in_heading is not None else 0.0,
        velocity_bias_deg=float(np.median(in_velocity)),
        serial_number=str(file.attribute(*SERIAL_NUMBERS, f"SerialNum{file.suffix}") or ""),
        manufacturer=str(file.attribute(*MANUFACTURERS) or ""),
        model=str(file.attribute(*MODELS) or ""),
        profiles=_profiles(file, up, east.shape, order),
        counts={
            "samples": n,
            "velocities": int(np.isfinite(east).sum()),
            "velocities_flagged": int(((quality > 2) & np.isfinite(east + northward)).sum()),
        },
        warnings=tuple(f"{path.name}: {note}" for note in file.notes),
        unstated=(
            *["orientation"] * (file.bins is None and not (settings.orientation or _stated_orientation(file))),
            *["direction_reference"] * (not stated.word and settings.declination is None),
        ),
    )


def _open(path: Path, nc: Any, settings: _Settings) -> tuple[File, Floats, Flags]:
    """Open the file along its time dimension; read times, and flags that are GOOD unless the time is doubtful."""
    columns = settings.columns
    if nc.groups and not nc.variables:
        advice = "write the group with the velocities as a file of its own"
        advice = "write format: ocean_contour" if ocean_contour.is_ocean_contour(path) else advice
        shown = f"groups {', '.join(nc.groups)}"
        raise InputError(str(path), expected="variables at the top", found=shown, advice=advice)
    system = str(getattr(nc, "coord_sys", "earth"))
    if system != "earth":
        advice = "give the instrument's own file, or save it after rotate2(ds, 'earth')"
        raise InputError(f"{path}: coord_sys", expected="earth", found=system, advice=advice)
    time = variables.time_variable(columns.get("time"), nc)
    if time is None:
        shown = ", ".join(nc.variables) or "no variables"
        advice = "name it in the mooring file: columns: {time: NAME}"
        expected = "a variable with a unit such as days since"
        raise InputError(f"{path}: time", expected=expected, found=shown, advice=advice)
    long = [name for name in time.dimensions if nc.dimensions[name].size > 1] or list(time.dimensions[:1])
    file = File(path, nc, dict(columns), settings.meanings, time=long[0] if long else "")
    if len(long) != 1:
        shown = f"dimensions ({', '.join(time.dimensions)})"
        raise file.refuse(time.name, "one dimension", shown, "write one series a file, not bursts")
    _refuse_ragged(file)
    time_s, time_flags = variables.read_times(file, time), attributes.read_flags(file, time)
    bad = np.full(len(time_s), GOOD) if time_flags is None else np.where(time_flags < PROBABLY_BAD, GOOD, time_flags)
    return file, time_s, bad.astype(np.int8)


def _refuse_ragged(file: File) -> None:
    """Reject the concatenated series of several instruments or bins: CF's ragged arrays (9.3.3 and 9.3.4)."""
    for variable in file.nc.variables.values():
        instances = file.text("instance_dimension", variable) if variable.dimensions == (file.time,) else ""
        if not instances and variable.ndim and file.text("sample_dimension", variable) == file.time:
            instances = variable.dimensions[0]
        n = file.nc.dimensions[instances].size if instances in file.nc.dimensions else 0
        if n > 1:
            shown = f"{n} in one, by {variable.name}"
            raise file.refuse(file.time, "the series of one instrument", shown, SPLIT_ADVICE)


def _refuse_rows(file: File, time_s: Floats, bins: _Bins, share: float = 0.1) -> None:
    """Reject bins that are listed as rows of one series: a share of the times is repeated at another depth."""
    if file.bins is not None or bins.depth_m.size < 2:
        return
    order = np.lexsort((bins.depth_m, time_s))
    again = (np.diff(time_s[order]) == 0.0) & (np.diff(bins.depth_m[order]) > 0.0)
    if again.sum() > share * len(time_s):
        shown = f"{int(again.sum())} of {len(time_s)} times repeated at another depth"
        raise file.refuse(file.time, "one row a time", shown, SPLIT_ADVICE)


def _with_bins(file: File, variable: netCDF4.Variable) -> File:
    """Add the bin dimension to the file, and treat ``depth`` of the column map as bin depths if it varies by bin."""
    components = {"dir", "beam", "earth", "inst"}
    other = [name for name in variable.dimensions if name in spans(variable) - {file.time} - components]
    if len(other) > 1:
        shown = ", ".join(f"{name} ({file.nc.dimensions[name].size})" for name in other)
        raise file.refuse(variable.name, "one dimension beside time", shown, "write one station a file")
    columns, bins = dict(file.columns), next(iter(other), None)
    named = file.nc.variables.get(str(columns.get("depth")))
    if named is not None and bins in named.dimensions:
        columns["cell_depth"] = columns.pop("depth")
    suffix = variable.name.removeprefix("vel") if COMPONENTS in variable.dimensions else ""
    return replace(file, bins=bins, columns=columns, suffix=suffix)


def _velocities(file: File) -> tuple[Floats, Floats, Flags, tuple[netCDF4.Variable, ...]]:
    """Read east and north velocities as recorded, (n, m) m/s, their flags, and their variables."""
    roles = _flow_roles(file)
    parts = [_component(file, role) for role in roles]
    east, northward = (
        values(_with_bins(file, variable), role, variable, part)
        for role, (variable, part) in zip(roles, parts, strict=True)
    )
    if roles[0] == "direction":
        east, northward = angles.components(northward, np.where((east < -180.0) | (east > 360.0), np.nan, east))
    n = file.nc.dimensions[file.time].size
    each = [attributes.read_flags(_with_bins(file, variable), variable, part) for variable, part in parts]
    known = [flag for flag in each if flag is not None] or [np.full(east.shape, GOOD)]
    worst = vocabularies.worst_flag(known).reshape(n, -1)
    pair = tuple(parts[0 if roles[0] == "direction" else k][0] for k in (0, 1))  # a direction has no other frame
    return east.reshape(n, -1), northward.reshape(n, -1), worst, pair


def _flow_roles(file: File) -> tuple[str, str]:
    """Choose direction and speed where the mooring file names them, or the file has no other velocities."""
    if {"east", "north"} & {*file.columns} or _all_components(file, "east") is not None:
        return "east", "north"
    lengths = [(file.time, name) for name in file.nc.dimensions if name != file.time]
    there = {role for role in ("east", "direction") if find(file, role, *lengths, (file.time,)) is not None}
    return ("direction", "speed") if "direction" in {*file.columns} or there == {"direction"} else ("east", "north")


def _headings(file: File, n: int, variable: netCDF4.Variable | None) -> Floats:
    """Read headings as recorded, NaN where they are no angle, as -999 and 65535 of a logger."""
    heading = _series(file, "heading", n, variable)
    with np.errstate(invalid="ignore"):
        wrong = (heading < -180.0) | (heading > 360.0)
    if wrong.any():
        file.note(f"{int(wrong.sum())} headings are no angles and count as missing.")
    return np.where(wrong, np.nan, heading)


def _turn_axes(file: File, flow: _Flow, heading: Floats, settings: _Settings) -> tuple[Floats, Floats, Floats | None]:
    """Turn x, y and z of Nortek to east, north and up by the heading, and by the tilts where z is known."""
    x, y, z = flow
    tilts = [np.nan_to_num(_measured(file, role, len(x))) * (z is not None) for role in ("tilt_x", "tilt_y")]
    side = np.full((1, 1), -1.0 if _looks_up(file, settings.orientation, None) else 1.0)
    axes = np.stack([x, y, np.zeros_like(x) if z is None else z], axis=-1)
    *level, up = nortek.turn_axes(axes, compass.levelling(*tilts), side, heading)
    how = "heading, pitch and roll" if np.any(tilts) else "heading alone"
    file.note(f"Velocities of the instrument's axes were turned to east and north by the {how}.")
    return level[0], level[1], None if z is None else up


def _component(file: File, role: str) -> tuple[netCDF4.Variable, tuple[str, int] | None]:
    """Find the variable of a component, and its (dimension, index) in dolfyn's variable of all components."""
    if (velocity := _all_components(file, role)) is not None:
        labels = file.labels(COMPONENTS)
        if role[0].upper() in labels:
            return velocity, (COMPONENTS, labels.index(role[0].upper()))
    lengths = [(file.time, name) for name in file.nc.dimensions if name != file.time]
    variable = find(file, role, *lengths, (file.time,))
    if variable is None:
        there = ", ".join(file.nc.variables)
        advice = f"name it in the mooring file: columns: {{{role}: NAME}}"
        if velocity is not None:
            advice = f"{velocity.name} has no components E and N: save the file after rotate2(ds, 'earth')"
        elif words := frames.other_frames(file):
            there, advice = words, frames.ADVICE
        raise file.refuse(role, f"a variable of the velocity ({role})", there, advice)
    return variable, None


def _all_components(file: File, role: str) -> netCDF4.Variable | None:
    """Find dolfyn's variable of all components: that named in the column map, else the first along time."""
    named = [name for name in (file.columns.get(role), file.columns.get("east"), file.columns.get("north")) if name]
    there = [file.nc.variables[name] for name in (*named[:1], *variables.DOLFYN) if name in file.nc.variables]
    fitting = [variable for variable in there if {COMPONENTS, file.time} <= {*variable.dimensions}]
    if named and (not fitting or fitting[0].name != named[0]):
        return None
    here = [name for name in variables.DOLFYN if name in file.nc.variables]
    others = [name for name in here if name != fitting[0].name] if fitting else []
    if others and not named and not file.columns.get("time"):
        file.note(
            f"{fitting[0].name} was read; {others[0]} is another series of the same instrument, which columns: "
            f"{{time: time{others[0].removeprefix('vel')}}} reads instead."
        )
    return fitting[0] if fitting else None


def _series(file: File, role: str, n: int, variable: netCDF4.Variable | None = None) -> Floats:
    variable = find(file, role, (file.time,)) if variable is None else variable
    return np.full(n, np.nan) if variable is None else np.broadcast_to(values(file, role, variable), n).astype(float)


def _measured(file: File, role: str, n: int, variable: netCDF4.Variable | None = None) -> Floats:
    """Read a series with flagged bad values set to NaN, and note their number."""
    variable = find(file, role, (file.time,)) if variable is None else variable
    series = _series(file, role, n, variable)
    known = None if variable is None else attributes.read_flags(file, variable)
    if variable is None or known is None or not (bad := (known >= PROBABLY_BAD) & np.isfinite(series)).any():
        return series
    file.note(f"{variable.name}: {int(bad.sum())} values are flagged and count as missing.")
    return np.where(bad, np.nan, series)


def _pressure(file: File, n: int) -> Floats:
    variable = find(file, "pressure", (file.time,))
    pressure = _measured(file, "pressure", n, variable)
    if wrong := int(np.sum(np.abs(pressure) > DEEPEST_M)):  # MHKiT writes a pressure below the atmosphere\'s as 2^32
        file.notes.append(f"{wrong} pressures lie beyond {DEEPEST_M} dbar and count as missing.")
        pressure = np.where(np.abs(pressure) > DEEPEST_M, np.nan, pressure)
    if variable is None or variable.name != "PRES" or "IMOS" not in file.text("Conventions"):
        return pressure
    file.notes.append(f"PRES of IMOS is absolute: {ATMOSPHERE_DBAR} dbar of atmosphere were subtracted.")
    return pressure - ATMOSPHERE_DBAR


def _bins(file: File, n: int, m: int, orientation: str | None) -> _Bins:
    """Locate the bins from their distances to the transducer, or else from their depths."""
    depth = _measured(file, "depth", n)
    if m == 1 or file.bins is None:
        cell = find(file, "cell_depth", ())
        if cell is not None and not np.isfinite(depth).any():
            depth = np.abs(_series(file, "cell_depth", n, cell))
        return _Bins(np.zeros((1, 1)), (orientation or _stated_orientation(file)) == "up", depth)
    distance = find(file, "range", (file.bins,), (file.time, file.bins))
    if distance is not None:
        ranges = _known(file, distance, np.atleast_2d(values(file, "range", distance)))
        sign = "down" if np.nanmax(ranges) <= 0.0 else "up" if distance.name in SIGNED else None
        return _Bins(np.abs(ranges), _looks_up(file, orientation, sign), depth)
    cells = find(file, "cell_depth", (file.bins,), (file.time, file.bins))
    if cells is None:
        advice = "name one in the mooring file: columns: {range: NAME} (from the transducer) or {depth: NAME}"
        raise file.refuse(file.bins, "distances or depths of the bins", ", ".join(file.nc.variables), advice)
    below = _known(file, cells, np.atleast_2d(values(file, "cell_depth", cells)))
    below = -below if file.text("positive", cells) == "up" or np.nanmax(below) <= 0.0 else below
    if not np.isfinite(depth).any():
        scalar = file.nc.variables.get("NOMINAL_DEPTH")
        nominal = file.attribute(*NOMINAL) if scalar is None or scalar.size != 1 else float(scalar[...].item())
        depth = depth if nominal is None else np.full(len(depth), float(nominal))
    if np.isfinite(depth).any():
        instrument = depth[:, None] if len(below) == len(depth) else np.full((1, 1), np.nanmedian(depth))
        above = float(np.nanmedian(instrument - below))
        looks_up = _looks_up(file, orientation, "up" if above > 0.0 else "down")
        return _Bins((instrument - below) * (1.0 if looks_up else -1.0), looks_up, depth)
    looks_up = _looks_up(file, orientation, None)
    nearest = np.nanmax(below, axis=1) if looks_up else np.nanmin(below, axis=1)
    return _Bins(np.abs(nearest[:, None] - below), looks_up, np.broadcast_to(nearest, len(depth)).astype(float))


def _known(file: File, variable: netCDF4.Variable, places: Floats) -> Floats:
    if not np.isfinite(places).any(axis=0).all():
        advice = "name another variable in columns"
        raise file.refuse(variable.name, "a number for every bin", "bins without any", advice)
    return places


def _stated_orientation(file: File) -> str | None:
    text = file.text("orientation").lower()
    return "up" if "up" in text else "down" if "down" in text else None


def _looks_up(file: File, orientation: str | None, by_sign: str | None) -> bool:
    stated = by_sign or _stated_orientation(file)
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
        counts = _beam_counts(file, names)
        if counts is not None:  # back to the recorded bytes, -1 where missing
            missing = ~((counts >= 0) & (counts <= 255))
            whole = np.where(missing, -1, np.rint(counts)).astype(np.int16)
            profiles[key] = whole if missing.any() else whole.astype(np.uint8)
    return {key: values[:, order] for key, values in profiles.items() if values.shape[:2] == shape}


def _velocity(file: File, key: str) -> Floats | None:
    variable = next((file.nc.variables[name] for name in VELOCITIES[key] if name in file.nc.variables), None)
    if variable is not None and (flow := _arranged(file, variable)) is not None and flow.ndim == 2:
        factor = SPEED.get(str(getattr(variable, "units", "")).lower())
        return None if factor is None else factor * flow
    velocity = file.nc.variables.get(f"vel{file.suffix}")
    if velocity is None or "dir" not in velocity.dimensions:
        return None
    labels = file.labels("dir")
    label = next((label for label in AMONG[key] if label in labels), None)
    components = _arranged(file, velocity, "dir")
    return None if label is None or components is None else components[..., labels.index(label)]


def _beam_counts(file: File, names: tuple[str, ...]) -> Floats | None:
    """Read counts of beams by the first available name, (n, m, beams) or (n, m), NaN where missing."""
    for name in (*(f"{name}{file.suffix}" for name in names if file.suffix), *names):
        several = [name.format(beam) for beam in range(1, 5)] if "{}" in name else [name]
        there = [file.nc.variables[beam] for beam in several if beam in file.nc.variables]
        each = [values for variable in there if (values := _arranged(file, variable, *BEAMS)) is not None]
        if len(each) == len(several):
            return each[0] if len(each) == 1 else np.stack(each, axis=-1)
    return None


def _arranged(file: File, variable: netCDF4.Variable, *last: str) -> Floats | None:
    """Read values along time, bin and a last dimension, others squeezed; None if another is longer than 1."""
    wanted = (file.time, file.bins, *last)
    long = [name for name, size in zip(variable.dimensions, variable.shape, strict=True) if size > 1]
    if not np.issubdtype(variable.dtype, np.number) or {*long} - {*wanted} or file.time not in variable.dimensions:
        return None
    present = [name for name in wanted if name in variable.dimensions]
    data: Floats = variables.transposed(numbers(file, variable), variable.dimensions, present)
    return data if file.bins in present else data[:, None]
