"""Immutable data classes of records, with names, units and shapes of their arrays.

n is the number of samples, m the number of bins. Times are UTC seconds since 1970-01-01. Directions are those towards
which the water flows. ``take`` selects samples, ``join_records`` joins the files of one instrument.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.types import Complexes, Floats

if TYPE_CHECKING:
    import xarray
    from _typeshed import DataclassInstance


def import_xarray() -> Any:
    """Import xarray, which is needed for labelled data only, or raise ImportError with the command that installs it.

    Raises:
        ImportError: xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        needed = "xarray is needed for labelled data; install it by: pip install 'compasslib[xarray]'"
        raise ImportError(needed) from error
    return xarray


class Labelled:
    """Mixin for the content of a netCDF file that can be loaded as an xarray dataset."""

    path: str = ""  # of the file that it was opened from

    def to_xarray(self) -> xarray.Dataset:
        """Load the file with its own names (UCUR, TIME, DEPTH ...), flags, attributes, and bounds as coordinates.

        Raises:
            InputError: it was not opened from a file.
            ImportError: xarray is not installed.
        """
        if not self.path:
            advice = "write it by compasslib.write_corrected, and open that file by compasslib.open_product"
            raise InputError("to_xarray", expected="a product opened from a file", found="one in memory", advice=advice)
        data: xarray.Dataset = import_xarray().load_dataset(self.path)
        return data.set_coords([each.attrs["bounds"] for each in data.coords.values() if "bounds" in each.attrs])


Flags = NDArray[np.int8]
MAGNETOMETER = ("magnetometer_x", "magnetometer_y", "magnetometer_z")  # channels in the instrument's axes, counts
Series = TypeVar("Series", bound="DataclassInstance")
_BY_NAME = ("channels", "profiles")  # fields of a record that hold arrays by name

# Quality flags of OceanSITES reference table 2 that are used.
NOT_CHECKED, GOOD, PROBABLY_GOOD, PROBABLY_BAD, BAD, MISSING = 0, 1, 2, 3, 4, 9
LEAST_PERCENT_GOOD = 25  # of the pings, that readers require
DEEPEST_M = 12000  # metres or dbar; no sea is deeper
PIECE = 32_768  # samples whose velocities are processed at once: 10 MB per array with forty bins
# Upward and error velocity, and for each beam echo intensity, correlation and percent good.
PROFILES = ("up", "error_velocity", "echo", "correlation", "percent_good")


@dataclass(frozen=True)
class Record:
    """Measurements of one instrument, as returned by a reader or prepared by ``apply_deployment``.

    Headings are as recorded by the compass, relative to magnetic north, without heading bias and declination;
    velocities are rotated by the same heading, or to true north if ``direction_reference`` is ``true``. Of a stored
    record, arrays of (n, m) are objects that load their rows on access, in float64, as by ``take``.
    """

    time_s: Floats  #: (n,) UTC seconds since 1970
    east: Floats  #: (n, m) m/s, towards
    north: Floats  #: (n, m) m/s, towards
    bin_range_m: Floats  #: (n, m) vertical distance from the transducer, positive away from it; 0 for a point meter
    heading_deg: Floats  #: (n,) recorded, magnetic, clockwise; NaN where missing
    pitch_deg: Floats  #: (n,) degrees, forward up positive
    roll_deg: Floats  #: (n,) degrees, starboard down positive
    pressure_dbar: Floats  #: (n,) NaN without a sensor
    depth_m: Floats  #: (n,) m below the surface, as in the file, then as determined by ``apply_deployment``
    temperature_c: Floats  #: (n,) degrees Celsius
    supply_voltage: Floats  #: (n,) counts or volts; only its changes are used
    quality: Flags  #: (n, m) OceanSITES flag of each velocity
    heading_quality: Flags  #: (n,) OceanSITES flag of each heading
    looks_up: bool = True  #: whether the bins are above the transducer
    beam_angle_deg: float = 0.0  #: degrees from the vertical; 0 for a meter without slanted beams
    direction_reference: str = "magnetic"  #: magnetic | true
    heading_bias_deg: float = 0.0  #: heading bias removed from the file's headings, degrees, east positive
    #: heading bias removed from its velocities, degrees, east positive; None if it is that of the headings
    velocity_bias_deg: float | None = None
    serial_number: str = ""  #: of the instrument; empty if its files do not state it
    manufacturer: str = ""  #: as stated in its files
    model: str = ""  #: as stated in its files
    #: further logged series by name, (n,) each; NaN where missing
    channels: Mapping[str, Floats] = field(default_factory=dict)
    channel_units: Mapping[str, str] = field(default_factory=dict)  #: unit of each channel, if known
    #: further profiles, with the keys of ``PROFILES``; (n, m) m/s, NaN where missing, or (n, m, beams) counts in the
    #: integers of the file, -1 where missing; an array, or an object that loads its rows on access
    profiles: Mapping[str, Any] = field(default_factory=dict)
    recorded_in: str = ""  #: beam | instrument | ship | earth, if stated in the files
    sound_speed: str = ""  #: what was done where the speed of sound in its files is not that of the water
    bins_mapped: bool = False  #: whether beam velocities were combined at equal depth, accounting for tilt
    counts: dict[str, int] = field(default_factory=dict)  #: numbers of samples read, skipped and flagged
    warnings: tuple[str, ...] = ()  #: sentences for the report
    unstated: tuple[str, ...] = ()  #: keys of the mooring file that its files leave open
    tests: NDArray[np.int32] | None = None  #: (n, m) bits of the tests that each velocity failed; None without tests

    def bin_depth_m(self) -> Floats:
        """Compute the depth of every bin at every sample, including mooring blow-down, (n, m) metres."""
        return self.depth_m[:, None] + (-1.0 if self.looks_up else 1.0) * self.bin_range_m


def new_record(time_s: Floats, east: Floats, north: Floats, **known: Any) -> Record:
    """Create a record from what is known: series that were not measured are NaN, ranges 0.

    Velocities and headings have the flags ``quality`` and ``heading_quality``, by default GOOD, and MISSING where they
    are NaN, which is counted.
    """
    blank = np.full(len(time_s), np.nan)
    names = ("heading_deg", "pitch_deg", "roll_deg", "pressure_dbar", "depth_m", "temperature_c", "supply_voltage")
    values = dict.fromkeys(names, blank) | {"bin_range_m": np.zeros(east.shape)} | known
    values["bin_range_m"] = np.broadcast_to(values["bin_range_m"], east.shape)
    lost = {"quality": np.isnan(east + north), "heading_quality": np.isnan(values["heading_deg"])}
    for name, absent in lost.items():
        values[name] = np.where(absent, MISSING, values.get(name, GOOD)).astype(np.int8)
    missing = {"velocities_missing": int(lost["quality"].sum())}
    missing |= {"heading_missing": int(lost["heading_quality"].sum())} if "heading_deg" in known else {}
    return Record(time_s, east, north, **values | {"counts": known.get("counts", {}) | missing})


@dataclass(frozen=True)
class Readings:
    """Time series of one compass, and of the current in its instrument's frame, from which headings are estimated."""

    time_s: Floats  # (n,) increasing
    heading_deg: Floats  # (n,) recorded, magnetic, NaN where missing
    pitch_deg: Floats  # (n,) forward up
    roll_deg: Floats  # (n,) starboard down
    water: NDArray[np.complexfloating]  # (n,) speed times e^{i alpha}, alpha clockwise from forward, m/s; NaN: unknown


@dataclass(frozen=True)
class SlowShear:
    """Slow part of the difference between predicted and actual velocities across the flow, known from a profile."""

    size_m_s: float  #: rms
    memory_days: float  #: time in which its autocorrelation falls to 1/e
    log_sigma: float  #: standard deviation of the natural logarithm of ``size_m_s``
    memory_log_sigma: float  #: standard deviation of the natural logarithm of ``memory_days``


@dataclass(frozen=True)
class ReferenceCompass:
    """Source of a reference's directions, with the standard deviations of its errors."""

    name: str  #: of the instrument
    sigma_deg: float  #: of a constant error of its directions
    iron_deg: float = 0.0  #: of B and of C, the coefficients of sine and cosine of its own heading
    declination_deg: float = 0.0  #: of the declination between its north and magnetic north; 0 if it is magnetic

    @property
    def magnetic(self) -> bool:
        """Whether its directions are from magnetic north."""
        return self.declination_deg == 0.0


@dataclass(frozen=True)
class Pairs:
    """Overlapping measurements of the affected (upper) instrument and the reference (lower), true east and north."""

    time_s: Floats  #: (n,) UTC seconds since 1970
    heading_deg: Floats  #: (n,) recorded by the affected compass, magnetic, clockwise
    pitch_deg: Floats  #: (n,) of the affected instrument, forward up positive
    roll_deg: Floats  #: (n,) of the affected instrument, starboard down positive
    upper_east: Floats  #: (n,) m/s, by the recorded heading plus declination
    upper_north: Floats  #: (n,) m/s, as ``upper_east``
    lower_east: Floats  #: (n,) m/s
    lower_north: Floats  #: (n,) m/s
    upper_depth_m: Floats  #: (n,) m below the surface, of the bins
    lower_depth_m: Floats  #: (n,) m below the surface, of the bins
    separation_minutes: Floats  #: (n,) minutes, lower minus upper
    declination_deg: Floats  #: (n,) east positive
    lower_heading_deg: Floats | None = None  #: (n,) of the reference's compass, NaN where missing; None if not logged
    reference_index: Flags | None = None  #: (n,) index of the reference of each pair, if there are several
    reference_names: tuple[str, ...] = ()  #: names of the references that ``reference_index`` refers to
    warnings: tuple[str, ...] = ()  #: sentences for the report
    #: m/s, expected rms error of one component, for the mean of the bins and for the prediction from the profile
    expected_m_s: tuple[float, float] | None = None
    #: uncertainty (1 sigma, degrees) of the mean veer between upper velocities and the reference over the record
    veer_deg: float = 0.0
    delay_h: float = 0.0  #: hours, 1 sigma, by which the current is later at one of the depths
    speed_late_h: float = 0.0  #: hours by which speeds of the reference, a rotor, are later than its time stamps
    slow_shear: SlowShear | None = None  #: between upper velocities and the reference; None if no profile shows it
    #: suspected errors of all headings, as indicated by the pairs, (1 sigma in degrees, reason) each
    doubts: tuple[tuple[float, str], ...] = ()
    compass: ReferenceCompass | None = None  #: of the reference; None if its errors are not considered
    #: where the speeds of a reference fall: (its index, begin and end in UTC seconds, ratio to the beginning) each
    slowed: tuple[tuple[int, float, float, float], ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def flows(self) -> tuple[Complexes, Complexes]:
        """Upper and lower velocities, east + i north, (n,) m/s."""
        return self.upper_east + 1j * self.upper_north, self.lower_east + 1j * self.lower_north


@dataclass(frozen=True)
class EarthField:
    """Time series of the earth's field at one place, linear between nodes."""

    time_s: Floats  #: (k,) UTC seconds since 1970
    declination_deg: Floats  #: (k,) declination to be used, degrees, east positive
    horizontal_nT: Floats  #: (k,) nT
    vertical_nT: Floats  #: (k,) nT, down positive
    model_declination_deg: Floats  #: (k,) declination by IGRF, degrees, east positive, even if not used
    source: str = "IGRF"  #: source of the declination, IGRF or metadata
    warnings: tuple[str, ...] = ()  #: sentences for the report


@dataclass(frozen=True)
class CorrectedRecord(Labelled):
    """The record of an affected instrument together with its correction.

    Headings are relative to magnetic north, velocities are true east and north.
    """

    record: Record  #: as recorded, including flags
    heading_corrected_deg: Floats  #: (n,) magnetic, clockwise; NaN where it cannot be corrected
    heading_uncertainty_deg: Floats  #: (n,) degrees, one standard deviation
    heading_common_deg: Floats  #: (n,) part of it that is common to the record
    heading_corrected_quality: Flags  #: (n,) OceanSITES flag of each corrected heading
    deviation_deg: Floats  #: (n,) corrected minus recorded heading, degrees
    branch_probability: Floats  #: (n,) probability of the corrected heading among those with the same reading
    declination_deg: Floats  #: (n,) east positive
    east: Floats  #: (n, m) m/s, corrected
    north: Floats  #: (n, m) m/s, corrected
    east_recorded: Floats  #: (n, m) m/s, by the recorded heading plus declination
    north_recorded: Floats  #: (n, m) m/s, as ``east_recorded``
    east_uncertainty: Floats  #: (n, m) m/s, one standard deviation due to the direction
    north_uncertainty: Floats  #: (n, m) m/s, as ``east_uncertainty``
    velocity_quality: Flags  #: (n, m) OceanSITES flag of the corrected velocities
    path: str = ""  #: the file that it was opened from


@dataclass(frozen=True)
class FieldSeries:
    """Record of a magnetic observatory; NaN where a value or a header entry is missing."""

    time_s: Floats  # (n,) increasing
    declination_deg: Floats  # (n,) east positive
    horizontal_nT: Floats  # (n,)
    vertical_nT: Floats  # (n,) down positive
    station: str  # name or else code
    latitude: float  # degrees north
    longitude: float  # degrees east
    elevation_m: float
    definitive: bool = False  # whether the file declares its data as definitive
    counts: dict[str, int] = field(default_factory=dict)  # rows read, damaged, fillers, missing, repeated
    warnings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    origin: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # (n,) index of the file

    def __len__(self) -> int:
        return len(self.time_s)


def take(series: Series, which: NDArray[Any] | slice) -> Series:
    """Select samples of a record whose arrays all run along them, by indices, a mask or a slice."""
    columns: dict[str, Any] = {k: column[which] for k, column in vars(series).items() if getattr(column, "ndim", 0)}
    for several in _BY_NAME:
        if shown := getattr(series, several, None):
            columns[several] = {name: column[which] for name, column in shown.items()}
    return replace(series, **columns)


def pieces(count: int) -> Iterator[slice]:
    """Divide samples into pieces of ``PIECE``, at least one."""
    yield from (slice(begin, min(begin + PIECE, count)) for begin in range(0, max(count, 1), PIECE))


def join_records(records: Sequence[Record]) -> Record:
    """Join the records of one instrument's files in order of their first times, and sum their counts.

    Raises:
        InputError: the records differ in number of bins, orientation, direction reference or serial number.
    """
    if len(records) == 1:
        return records[0]
    ordered = sorted(records, key=lambda record: float(np.nanmin(record.time_s, initial=np.inf)))
    kinds = {
        (record.east.shape[1], record.looks_up, record.direction_reference, record.serial_number) for record in records
    }
    if len(kinds) != 1:
        shown = " and ".join(f"{bins} bins looking {'up' if up else 'down'}" for bins, up, *_ in sorted(kinds))
        advice = "give each recording as an instrument of its own"
        raise InputError("files", expected="parts of one recording", found=shown or "none", advice=advice)
    columns = [name for name, column in vars(ordered[0]).items() if isinstance(column, np.ndarray)]
    together: dict[str, Any] = {name: np.concatenate([getattr(record, name) for record in ordered]) for name in columns}
    for several in _BY_NAME:
        first, *others = [getattr(record, several) for record in ordered]
        alike = [name for name in sorted(first)
                 if all(name in each and each[name].shape[1:] == first[name].shape[1:] for each in others)]  # fmt: skip
        together[several] = {name: np.concatenate([each[name] for each in (first, *others)]) for name in alike}
    counts = {key: sum(record.counts.get(key, 0) for record in ordered) for key in ordered[0].counts}
    warnings = tuple(dict.fromkeys(line for record in ordered for line in record.warnings))
    return replace(ordered[0], **together, counts=counts, warnings=warnings)


def iso_time(time_s: float) -> str:
    """Format UTC seconds since 1970 as ISO 8601."""
    return datetime.fromtimestamp(round(time_s), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
