"""Read MATLAB files of version 4 to 7.3: exports of WinADCP, structures of rdradcp, others by columns; ready pairs.

A file of version 7.3 is HDF5, which netCDF4 reads. Sources: WinADCP User's Guide (names and units of exported series);
R. Pawlowicz, rdradcp.m.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers import times
from compasslib.readers.delimited import read_table
from compasslib.readers.files import DAMAGE_ERRORS, MISSING_COUNT, refuse_large_arrays
from compasslib.readers.pd0.currents import true_pitch
from compasslib.readers.pd12 import BEAM_ANGLE_DEG
from compasslib.readers.table import SERIES
from compasslib.records import Record, join_records, new_record
from compasslib.types import Floats

HDF5 = b"\x89HDF"  # after the text header of 512 bytes in a file of version 7.3
CLOCK = ("SerYear", "SerMon", "SerDay", "SerHour", "SerMin", "SerSec")
WINADCP = {  # role -> name, and factor to the unit of records
    "east": ("SerEmmpersec", 0.001), "north": ("SerNmmpersec", 0.001), "up": ("SerVmmpersec", 0.001),
    "error_velocity": ("SerErmmpersec", 0.001), "heading": ("AnH100thDeg", 0.01), "tilt_x": ("AnP100thDeg", 0.01),
    "tilt_y": ("AnR100thDeg", 0.01), "depth": ("AnDepthmm", 0.001), "temperature": ("AnT100thDeg", 0.01),
}  # fmt: skip
RDRADCP = {
    "time": "mtime", "east": "east_vel", "north": "north_vel", "up": "vert_vel", "error_velocity": "error_vel",
    "heading": "heading", "tilt_x": "pitch", "tilt_y": "roll", "depth": "depth", "temperature": "temperature",
}  # fmt: skip
FIELDS = SERIES | {"voltage": "supply_voltage"}
VERTICAL = ("up", "error_velocity")
PAIR_ROLES = ("time", "heading", "upper_east", "upper_north", "lower_east", "lower_north")
PAIRS_ADVICE = "correct fit.columns in the mooring file"
LARGEST_DATENUM = 8.0e5  # year 2190; seconds since 1970 are larger
NO_BIAS = "WinADCP does not export the heading bias EB: none was taken out but for declination_applied."


@dataclass(frozen=True)
class Content:
    """Series by role, (n,), or (n, cells) with the axes in any order, and what the file states."""

    series: dict[str, Floats]
    orientation: str | None = None
    declination: float = 0.0  # in headings and velocities, degrees
    beam_angle_deg: float | None = None  # None if it is not known to be of RDI, whose recorded pitch is no angle
    dated: bool = False  # whether times are UTC seconds since 1970
    counts: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, Any] | None,
    orientation: str | None,
    declination_applied: float | Mapping[str, float] | None,
    direction_reference: str,
    time_format: str | None = None,
) -> Record:
    """Read the files of one instrument in order of time.

    Settings override what the file states; ``columns`` (role -> name of a variable, with dots for fields of structures)
    is needed for files of other programs.

    Raises:
        InputError: a file is damaged, lacks time or velocities, or does not state what only the mooring file can.
    """
    named = {role: name for role, name in (columns or {}).items() if name is not None}
    applied, records = parse_applied_declination(declination_applied), []
    for path in map(Path, paths):
        variables = load(path)
        adcp = next((x for x in variables.values() if isinstance(x, Mapping) and {"mtime", "east_vel"} <= {*x}), None)
        if {*CLOCK, "SerEmmpersec"} <= {*variables}:
            content = _of_winadcp(path, variables)
        elif adcp is not None:
            content = _of_rdradcp(path, adcp)
        elif named:
            content = Content({})
        else:
            advice = "name its variables in the mooring file: columns: {time: NAME, east: NAME, north: NAME}"
            expected, shown = "an export of WinADCP or a structure of rdradcp", ", ".join(variables) or "nothing"
            raise InputError(str(path), expected=expected, found=shown, advice=advice)
        for role in (role for role in named if role != "scale"):
            names = named[role] if isinstance(named[role], tuple | list) else [named[role]]
            parts = [np.atleast_1d(find_numbers(path, variables, name, role)) for name in names]
            values = times.from_parts(parts)[0] if len(parts) > 1 else parts[0]
            content.series[role] = named.get("scale", 1.0) * values if role in ("east", "north", "speed") else values
            if role == "time":
                content = replace(content, dated=len(parts) > 1)
        content = replace(content, orientation=orientation or content.orientation)
        inside = applied or AppliedDeclination(content.declination, content.declination)
        records.append(to_record(path, content, inside, direction_reference, time_format, named))
    return join_records(records)


def load(path: Path) -> dict[str, Any]:
    """Load the variables of a MATLAB file, structures as dictionaries.

    Raises:
        InputError: the file cannot be read within the limits of raw files.
    """
    from scipy.io import loadmat, whosmat  # only where such a file is given
    from scipy.io.matlab import MatReadError

    try:
        with path.open("rb") as stream:
            stream.seek(512)
            is_hdf5 = stream.read(len(HDF5)) == HDF5
        if is_hdf5:
            import netCDF4

            with netCDF4.Dataset(path) as file:
                return _group(path, file)
        sizes = [int(np.prod(shape)) for _, shape, form in whosmat(path) if form != "struct"]
        refuse_large_arrays(str(path), 8 * sum(sizes), path.stat().st_size)
        return {name: x for name, x in loadmat(path, simplify_cells=True).items() if not name.startswith("__")}
    except (*DAMAGE_ERRORS, MatReadError) as error:
        advice = "copy it again, or save it in MATLAB with save -v7"
        raise InputError(str(path), expected="a whole MATLAB file", found=error, advice=advice) from error


def _group(path: Path, group: Any) -> dict[str, Any]:
    """Read a group of an HDF5 file, whose arrays MATLAB stores in reverse order and whose texts are numbers."""
    content: dict[str, Any] = {name: _group(path, inner) for name, inner in group.groups.items() if name[0] != "#"}
    for name, variable in group.variables.items():
        refuse_large_arrays(f"{path}: {name}", 8 * variable.size, path.stat().st_size)
        values = np.ma.getdata(variable[...]).T
        is_text = str(getattr(variable, "MATLAB_class", "")) == "char"
        content[name] = "".join(map(chr, values.ravel())) if is_text else np.squeeze(values)
    return content


def _of_winadcp(path: Path, variables: Mapping[str, Any]) -> Content:
    """Select the series that WinADCP exports, as counts of hundredths of degrees, millimetres and so on."""
    numbers = {
        name: np.atleast_1d(np.asarray(x, float))
        for name, x in variables.items()
        if name.startswith(("Ser", "An", "RDI")) and np.asarray(x).dtype.kind in "iuf"
    }
    counts = {role: (numbers[name], factor) for role, (name, factor) in WINADCP.items() if name in numbers}
    series = {role: np.where(np.abs(x) == -MISSING_COUNT, np.nan, factor * x) for role, (x, factor) in counts.items()}
    year, *others = (numbers[name] for name in CLOCK)
    others[-1] = others[-1] + numbers.get("SerHund", np.zeros(1)) / 100.0
    series["time"], wrong = times.from_parts([times.full_years(year), *others])
    if wrong is not None:
        shown, expected = " ".join(f"{part[wrong]:g}" for part in (year, *others)), "a date and a time"
        raise InputError(f"{path}: SerYear to SerSec", expected=expected, found=shown, advice="export it again")
    if {"RDIBin1Mid", "RDIBinSize", "SerBins"} <= {*numbers}:
        series["range"] = numbers["RDIBin1Mid"] + numbers["RDIBinSize"] * (numbers["SerBins"] - 1.0)
    up = numbers.get("AnOrienUP", np.zeros(0))
    average_s = float(numbers.get("RDIPingsPerEns", np.zeros(1))[0] * numbers.get("RDISecPerPing", np.zeros(1))[0])
    notes = [NO_BIAS, *times.describe_averages(average_s, series["time"])]
    word = ("up" if np.mean(up) > 0.5 else "down") if len(up) else None
    return Content(series, word, beam_angle_deg=BEAM_ANGLE_DEG, dated=True, notes=tuple(notes))


def _of_rdradcp(path: Path, adcp: Mapping[str, Any]) -> Content:
    """Select the fields of rdradcp's structure."""
    config = adcp["config"] if isinstance(adcp.get("config"), Mapping) else {}
    system, alignment = str(config.get("coord_sys", "earth")), float(config.get("xducer_misalign", 0.0))
    if system != "earth" or alignment:
        shown, advice = f"{system} coordinates, EA {alignment:g}", "give the instrument's PD0 file: format: pd0"
        expected = "earth coordinates and a heading alignment EA of 0"
        raise InputError(str(path), expected=expected, found=shown, advice=advice)
    filled = np.ravel(adcp["mtime"]) != 0.0  # ensembles for which memory was reserved, but that the file did not hold
    values = {role: np.asarray(adcp[name], float).T for role, name in RDRADCP.items() if name in adcp}  # (n, cells)
    series = {role: x[filled] if len(x) == len(filled) else x for role, x in values.items()}
    series |= {"range": np.abs(np.asarray(config["ranges"], float))} if "ranges" in config else {}
    bias, angle = (float(config.get(name, 0.0)) for name in ("magnetic_var", "beam_angle"))
    notes = (f"The heading bias EB of {bias:g} degrees was taken out of the directions.",) * (bias != 0.0)
    return Content(series, config.get("orientation"), bias, angle, notes=notes)


def find_numbers(path: Path, variables: Mapping[str, Any], name: str, role: str) -> Floats:
    """Find an array of numbers by the name of its variable, with dots for the fields of structures.

    Raises:
        InputError: it does not exist, or is something else.
    """
    value: Any = variables
    for part in str(name).split("."):
        if not isinstance(value, Mapping) or part not in value:
            there = ", ".join(sorted(value)) if isinstance(value, Mapping) else type(value).__name__
            advice = "correct columns in the mooring file; fields of structures have dots, as adcp.mtime"
            raise InputError(f"{path}: {name} ({role})", expected="one of its variables", found=there, advice=advice)
        value = value[part]
    if isinstance(value, Mapping) or (array := np.asarray(value)).dtype.kind not in "iuf":
        shown = "a structure" if isinstance(value, Mapping) else "complex ones" if np.iscomplexobj(value) else "others"
        raise InputError(f"{path}: {name} ({role})", expected="real numbers", found=shown, advice="correct columns")
    return array.astype(float)


def to_record(
    path: Path,
    content: Content,
    inside: AppliedDeclination | None = None,
    reference: str = "magnetic",
    time_format: str | None = None,
    named: Collection[str] = (),
) -> Record:
    """Convert series by role to a record; those that the mooring file names must have one axis of time.

    Raises:
        InputError: series or facts are missing that a record needs, or a series has other axes than time and cells.
    """
    series = dict(content.series)
    flow = ("speed", "direction") if "speed" in series else ("east", "north")
    if lacking := [role for role in ("time", *flow) if role not in series]:
        advice = f"name it in the mooring file: columns: {{{lacking[0]}: NAME}}"
        raise InputError(str(path), expected=" and ".join(lacking), found=", ".join(series) or "none", advice=advice)
    try:
        time_s, note = times.from_numbers(series.pop("time").ravel(), "epoch" if content.dated else time_format)
    except times.Unreadable as error:
        raise InputError(f"{path}: time", expected=error.expected, found=error.shown, advice=error.advice) from None
    n = len(time_s)
    for role, x in series.items():
        along = [k for k, size in enumerate(x.shape) if size == n]
        if role != "range" and x.size != 1:
            if not along or (len(along) == 2 and role in named):
                expected, shown = f"one axis of {n}, the number of times", " x ".join(map(str, x.shape))
                raise InputError(f"{path}: {role}", expected=expected, found=shown, advice="correct columns")
            series[role] = np.moveaxis(x, along[0], 0)
    east, north = (series[role].reshape(n, -1) for role in flow)
    if flow[0] == "speed":
        east, north = angles.components(east, north)
    if inside and inside.velocity and reference == "magnetic":
        east, north = angles.turn(east, north, -inside.velocity)
    cells = east.shape[1]
    if cells > 1 and ("range" not in series or not content.orientation):
        missing = "range" if "range" not in series else "orientation"
        advice = "write columns: {range: NAME}" if missing == "range" else "write orientation: up or down"
        raise InputError(str(path), expected=f"the {missing} of the bins", found="none in the file", advice=advice)
    known = {name: np.broadcast_to(series[role].ravel(), n) for role, name in FIELDS.items() if role in series}
    if (heading := series.get("heading")) is not None:
        is_angle = (heading >= -180.0) & (heading <= 360.0)
        known["heading_deg"] = angles.wrap360(np.where(is_angle, heading, np.nan) - (inside.heading if inside else 0.0))
    if content.beam_angle_deg is not None:
        known["pitch_deg"] = true_pitch(*(known.get(name, np.full(n, np.nan)) for name in ("pitch_deg", "roll_deg")))
    return new_record(
        time_s,
        east,
        north,
        bin_range_m=np.abs(series["range"].ravel()) if cells > 1 else np.zeros(1),
        **known,
        profiles={role: series[role].reshape(n, -1).astype(np.float32) for role in VERTICAL if role in series},
        looks_up=content.orientation == "up",
        beam_angle_deg=content.beam_angle_deg or 0.0,
        direction_reference=reference,
        heading_bias_deg=inside.heading if inside else 0.0,
        velocity_bias_deg=inside.velocity if inside else None,
        counts=content.counts,
        warnings=(*content.notes, *([note] if note else [])),
        unstated=("orientation",) * (not content.orientation),
    )


def read_ready_pairs(path: Path, columns: Mapping[str, str]) -> dict[str, Floats]:
    """Read time (UTC seconds since 1970), heading (degrees) and velocities (in the file's unit), (n,) each.

    Times in a MATLAB file may be datenum or seconds since 1970.

    Raises:
        InputError: the file or a column is missing, or cannot be read within the limits of raw files.
    """
    if path.suffix.lower() != ".mat":
        return read_table(path, columns, PAIRS_ADVICE).columns
    variables = load(path)
    series = {role: np.atleast_1d(find_numbers(path, variables, name, role)) for role, name in columns.items()}
    if len({values.shape for values in series.values()}) != 1 or series["time"].ndim > 1:
        shapes = (f"{columns[role]} {' x '.join(map(str, values.shape))}" for role, values in series.items())
        expected = "series of one length, 1 x n or n x 1"
        raise InputError(str(path), expected=expected, found=", ".join(shapes), advice=PAIRS_ADVICE)
    scale = "datenum" if np.nanmin(series["time"], initial=np.inf) < LARGEST_DATENUM else "epoch"
    try:
        series["time"], _ = times.from_numbers(series["time"], scale)
    except times.Unreadable as error:
        where, expected = f"{path}: {columns['time']}", "times as datenum or as seconds since 1970"
        raise InputError(where, expected=expected, found=error.shown, advice=PAIRS_ADVICE) from None
    return series
