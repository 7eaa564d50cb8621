"""Input and output of gridded.nc and gridded_daily.nc (CF, ACDD, OceanSITES), and of the instruments to be gridded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles, earthfield, records
from compasslib.archive import variables
from compasslib.archive.attributes import Site, declination_attributes, global_attributes
from compasslib.archive.files import create_netcdf, open_netcdf, read_variable, write_variable
from compasslib.archive.netcdf import Columns, days_since_1950, seconds_since_1970, write_frame
from compasslib.archive.variables import GRIDDED, SECTION_SIGMA
from compasslib.errors import InputError
from compasslib.product.cells import NONE, Axes, Source, Velocities
from compasslib.product.errors import HeadingErrors, errors_by_time, sum_sigma
from compasslib.product.grid import INTERPOLATED, DailyMeans, GriddedProduct, Piece, empty_piece
from compasslib.types import DAY_S, HOUR_S, Bools, Complexes, Floats

if TYPE_CHECKING:
    import xarray


USUAL_BEAM_DEG = 20.0  # of a profiler whose files do not state the angle


def affected_source(
    name: str, path: str | Path, product: records.CorrectedRecord, record: records.Record, flags: Sequence[int]
) -> Source:
    """Return an affected instrument as a source of the grid, its velocities of these flags read from corrected.nc.

    Args:
        product: content of the same file, without velocities.
        record: the instrument's record, for the beam angle and whether its bins were mapped.
        flags: OceanSITES flags of the velocities to use.
    """

    def settle(which: slice, east: Floats, north: Floats, quality: records.Flags, depth: Floats) -> Velocities:
        return Velocities(np.where(np.isin(quality, flags), east + 1j * north, np.nan), depth, quality)

    names = ("UCUR", "VCUR", "UCUR_QC", "DEPTH")
    return _source(name, path, names, product.record, record, settle, record.beam_angle_deg or USUAL_BEAM_DEG)


def reference_source(
    name: str, path: str | Path, record: records.Record, field: records.EarthField, flags: Sequence[int],
    slowed: Sequence[tuple[float, float]] = (),
) -> Source:  # fmt: skip
    """Return a reference as a source of the grid, from true north.

    Args:
        slowed: begin and end, UTC seconds, of periods in which its rotor was fouled: probably good at best.
    """

    def settle(which: slice, east: Floats, north: Floats, quality: records.Flags, range_m: Floats) -> Velocities:
        time_s = record.time_s[which]
        doubtful = np.any([(time_s >= a) & (time_s <= b) for a, b in slowed], axis=0)
        quality = np.maximum(quality, np.where(doubtful, records.PROBABLY_GOOD, records.GOOD)[..., None])
        if record.direction_reference != "true":
            east, north = angles.turn(east, north, earthfield.declination_at(field, time_s)[:, None])
        depth = record.depth_m[which][:, None] + (-1.0 if record.looks_up else 1.0) * range_m
        return Velocities(np.where(np.isin(quality, flags), east + 1j * north, np.nan), depth, quality)

    names = [variables.RECORD[key].name for key in ("east", "north", "quality", "bin_range_m")]
    made = _source(name, path, names, record, record, settle, record.beam_angle_deg)
    return replace(made, slowed=tuple(slowed))


def _source(
    name: str, path: str | Path, names: Sequence[str], samples: records.Record, setup: records.Record,
    settle: Callable[..., Velocities], beam_angle_deg: float,
) -> Source:  # fmt: skip
    """Return a source whose rows of the variables are read on demand, and settled with the slice of the samples."""
    with open_netcdf(path) as nc:
        bins, rising = len(nc.dimensions["BIN"]), "WCUR" in nc.variables

    def rows(which: slice) -> Velocities:
        with open_netcdf(path) as nc:
            velocities = settle(which, *(read_variable(nc, key, which) for key in names))
            return replace(velocities, up=read_variable(nc, "WCUR", which)) if rising else velocities

    # The tilt puts a bin at different depths in the beams, unless bins were mapped.
    level = np.zeros(len(samples.time_s))
    tilt_deg = level if setup.bins_mapped else np.hypot(samples.pitch_deg, samples.roll_deg)
    return Source(name, samples.time_s, samples.depth_m, tilt_deg, bins, beam_angle_deg, rows, rising)


@dataclass(frozen=True)
class FileDescription:
    """Content of the global attributes of the gridded files of a mooring or site."""

    site: Site
    field: records.EarthField | None  # None for deployments whose declinations differ
    attributes: Mapping[str, object]  # the user's global attributes
    processing: Mapping[str, object]
    headings: tuple[int, int]  # numbers of recorded and of corrected headings of the affected instruments
    also: Mapping[str, object]  # further global attributes, such as the comparison with the reference

    def compose(self, kind: str, time_s: Floats, depth_m: Floats) -> tuple[dict[str, Any], dict[str, object]]:
        """Compose the global attributes of one file, and the attributes of its velocities on the declination."""
        spanned = global_attributes(
            self.site, time_s=time_s, depth_m=depth_m, headings=self.headings, attributes=self.attributes,
            processing=self.processing,
        )  # fmt: skip
        means, name = "daily means of " if kind.endswith("daily") else "", self.site.name
        written = {
            **spanned,
            "title": f"Currents of mooring {name} on fixed depths: {means}corrected and reference velocities",
            "summary": (
                f"Currents of mooring {name} on fixed depths and times, {means}velocities by corrected headings and of "
                "the reference instruments, with the uncertainty that sections and transports need."
            ),
            "processing_level": "Post-recovery calibrations have been applied",
            "QC_indicator": "mixed",
            **{key: spanned[key] for key in self.attributes if key in spanned},
            "comment": SECTION_SIGMA,
            "id": str(spanned["id"]).replace("compass-corrected", kind),
        }
        if "history" in spanned:
            step = f"{means}velocities put on fixed depths and times by {spanned['software_version']}"
            written["history"] = f"{spanned['history']}\n{spanned['date_created']}: {step}"
        declination = None if self.field is None else earthfield.declination_at(self.field, time_s)
        turned = {} if declination is None else declination_attributes(spanned, time_s, declination)
        return {**written, **self.also}, turned


def write_gridded(
    path: str | Path, product: GriddedProduct, description: FileDescription, daily: Sequence[DailyMeans] = ()
) -> dict[str, int]:
    """Write gridded.nc by pieces, which ``daily`` accumulates; return the numbers of all, filled and interpolated."""
    axes, counts = product.axes, np.zeros(3, dtype=int)
    instruments, rising = [source.name for source in product.sources], any(source.rising for source in product.sources)
    with create_gridded(
        path, "gridded", description, axes, product.errors, product.deviation_deg, instruments, product.memory_s
    ) as nc:
        for piece in product if len(axes.time_s) else [empty_piece(len(axes.depth_m), True)]:
            write_columns(nc, _columns(piece, rising), piece.slots)
            counts += piece.source.size, np.sum(piece.source >= 0), np.sum(piece.quality == INTERPOLATED)
            for each in daily:
                each.add(piece)
    return dict(zip(("cells", "filled", "interpolated"), counts.tolist(), strict=True))


def write_daily(
    path: str | Path, product: GriddedProduct, description: FileDescription, daily: DailyMeans, filtered: DailyMeans
) -> None:
    """Write gridded_daily.nc, means of days and tide-free velocities, from the sums accumulated over gridded.nc."""
    means, tide_free = daily.means(product), _columns(filtered.means(product).piece, False)
    names = ("UCUR", "VCUR", "UCUR_UNCERTAINTY", "VCUR_UNCERTAINTY")
    columns = _columns(means.piece, False) | {name.replace("CUR", "CUR_LOWPASS"): tide_free[name] for name in names}
    columns |= {"N_SAMPLES": (means.count, None), "SHRINKAGE": (means.shrinkage, None)}
    axes = replace(product.axes, time_s=means.time_s, step_s=DAY_S)
    instruments = [source.name for source in product.sources]
    with create_gridded(
        path, "gridded-daily", description, axes, means.errors, means.deviation_deg, instruments, product.memory_s
    ) as nc:
        write_columns(nc, columns)


@contextmanager
def create_gridded(
    path: str | Path, kind: str, description: FileDescription, axes: Axes, errors: HeadingErrors,
    deviation_deg: Floats, instruments: Sequence[str], memory_s: float,
) -> Iterator[netCDF4.Dataset]:  # fmt: skip
    """Yield a new file of the form of gridded.nc with attributes, coordinates, heading errors and corrections.

    The arguments after ``description`` are those of ``GriddedProduct``; ``instruments`` are the names of its sources.

    Args:
        deviation_deg: (a, t) corrected minus recorded headings of the affected instruments.
        instruments: names, affected instruments first.
        memory_s: correlation time of the errors that are not due to the heading.
    """
    attributes, turned = description.compose(kind, axes.time_s, axes.depth_m)
    affected, (sources, modes) = len(errors.random), errors.shares.shape
    sizes = {"DEPTH": len(axes.depth_m), "MODE": modes, "SOURCES": sources, "NV": 2, "AFFECTED": affected}
    halves = np.array([-0.5, 0.5])
    bounds_s, bounds_m = axes.time_s[:, None] + axes.step_s * halves, axes.depth_m[:, None] + axes.step_m * halves
    numbers, meanings = np.arange(len(instruments) + 1, dtype=np.int8), " ".join(["none", *instruments])
    with create_netcdf(path, "NETCDF4_CLASSIC") as nc:
        nc.setncatts(attributes)
        write_frame(nc, variables.GRID_TIME, axes.time_s, description.site)
        for dimension in [*sizes][: None if affected > 1 else -1]:
            nc.createDimension(dimension, sizes[dimension])
        write_variable(nc, variables.GRID_DEPTH, axes.depth_m)
        write_variable(nc, variables.BOUNDS["TIME"], days_since_1950(bounds_s))
        write_variable(nc, variables.BOUNDS["DEPTH"], np.maximum(bounds_m, 0.0))
        write_variable(nc, variables.MODE, np.arange(1, modes + 1))
        write_variable(nc, variables.SOURCES, np.arange(1, sources + 1))
        write_variable(nc, GRIDDED["HEADING_ERROR_MODE"], errors.modes, level=4)
        write_variable(nc, GRIDDED["HEADING_ERROR_SHARE"], errors.shares)
        for name, values in (("HEADING_ERROR_RANDOM", errors.random), ("HEADING_CORRECTION", deviation_deg)):
            described = replace(GRIDDED[name], dimensions=("AFFECTED", "TIME")) if affected > 1 else GRIDDED[name]
            write_variable(nc, described, values if affected > 1 else values[0], level=4)
        yield nc
        nc["HEADING_ERROR_MODE"].mode_names = ", ".join(errors.names)
        nc["HEADING_ERROR_RANDOM"].memory_hours = errors.memory_s / HOUR_S
        nc["SOURCE"].setncatts({"flag_values": numbers, "flag_meanings": meanings})
        for name in ("UCUR", "VCUR"):
            nc[name].setncatts(turned)
            nc[f"{name}_UNCERTAINTY"].error_memory_hours = memory_s / HOUR_S


def write_columns(nc: netCDF4.Dataset, columns: Columns, rows: slice | None = None) -> None:
    """Write variables of cells or times, by name."""
    for name, (values, flags) in columns.items():
        write_variable(nc, GRIDDED[name], values, flags, level=4, rows=rows)


def _columns(piece: Piece, rising: bool) -> Columns:
    cells, there = piece.cells, piece.source >= 0
    columns: Columns = {
        "UCUR": (cells.velocity.real, piece.quality),
        "VCUR": (cells.velocity.imag, piece.quality),
        "UCUR_UNCERTAINTY": (np.sqrt(piece.east_variance), None),
        "VCUR_UNCERTAINTY": (np.sqrt(piece.north_variance), None),
        "UV_COVARIANCE": (piece.covariance, None),
        "SOURCE": ((piece.source + 1).astype(np.int8), None),
        "N_CELLS": (np.where(there, cells.count, 0), None),
    }
    if rising:
        up = np.full(there.shape, np.nan) if cells.up is None else cells.up
        columns["WCUR"] = up, np.where(np.isfinite(up), piece.quality, records.MISSING).astype(np.int8)
    return columns


@dataclass(frozen=True)
class MeanProfile:
    """Mean current and its variance at each depth, (z,) each; NaN where too few times have a value."""

    mean: Complexes  # m/s
    east_variance: Floats  # (m/s)^2
    north_variance: Floats
    covariance: Floats


@dataclass(frozen=True)
class SectionMeans:
    """Section of gridded.nc: means over c equal intervals of time, and profiles over the whole record."""

    edges_s: Floats  # (c + 1,)
    depth_m: Floats  # (z,)
    before: Complexes  # (c, z) m/s, of affected instruments alone, by the recorded heading; NaN where there is none
    after: Complexes  # (c, z) m/s, of all instruments, those of affected ones by the corrected heading
    change: Complexes  # (c, z) m/s, corrected minus recorded, of affected instruments alone
    heading_sigma_deg: Floats  # (c,) rms over the interval, of the (first) affected instrument
    profiles: tuple[MeanProfile, MeanProfile]  # before and after correction
    profile_sigma: tuple[Floats, Floats]  # (z,) m/s, of the corrected mean east and north, by heading errors alone
    reference_share: Floats  # (z,) fraction of the values that are from references; NaN without values


OFTEN = 0.9  # share of the fullest depth's times: the mean of a depth reached in strong currents only is biased


def read_section(path: str | Path, columns: int = 400) -> SectionMeans:
    """Average gridded.nc over at most ``columns`` equal intervals of time, by default as many as a print shows."""
    grid = open_gridded(path)
    time_s, there, errors = grid.time_s, grid.source >= 0, grid.errors
    affected = there & grid.affected
    each = -(-max(len(time_s), 1) // columns)
    begins = np.arange(0, len(time_s), each)
    flows = np.where(there, [grid.recorded, grid.velocity], 0.0)
    sums = np.add.reduceat([flows[0] * affected, flows[1], flows[1] - flows[0]], begins, axis=1)
    number = np.add.reduceat(np.array([affected, there, affected], dtype=float), begins, axis=1)
    total = there.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        before, after, change = np.where(number > 0, sums / number, NONE)
    safe = np.where((total > 0) & (total >= OFTEN * total.max(initial=0)), total, np.nan)
    modes = np.nan_to_num(errors.modes)
    of_source = [np.where(grid.source == s, flows[1], 0.0) for s in range(len(errors.shares))]
    by_mode = sum((share[:, None] * modes) @ flow for share, flow in zip(errors.shares, of_source, strict=True))
    variance = errors.variance(0)
    known = [span[np.isfinite(span)] for span in (variance[begin : begin + each] for begin in begins)]
    step_s = grid.step_s if len(time_s) > 1 else DAY_S
    first = time_s[0] - step_s / 2.0 if len(time_s) else 0.0
    return SectionMeans(
        edges_s=first + step_s * each * np.arange(len(begins) + 1),
        depth_m=grid.depth_m,
        before=before,
        after=after,
        change=change,
        heading_sigma_deg=np.array([np.sqrt(x.mean()) if x.size else np.nan for x in known]) / angles.DEGREE,
        profiles=(_mean_profile(flows[0], safe), _mean_profile(flows[1], safe)),
        profile_sigma=(np.linalg.norm(by_mode.imag, axis=0) / safe, np.linalg.norm(by_mode.real, axis=0) / safe),
        reference_share=np.sum(there & ~grid.affected, axis=0) / np.where(total > 0, total, np.nan),
    )


def _mean_profile(flow: Complexes, number: Floats) -> MeanProfile:
    with np.errstate(invalid="ignore"):
        mean, square, pseudo = (np.sum(x, axis=0) / number for x in (flow, np.abs(flow) ** 2, flow**2))
    power, twice = square - np.abs(mean) ** 2, pseudo - mean**2
    return MeanProfile(mean, (power + twice.real) / 2.0, (power - twice.real) / 2.0, twice.imag / 2.0)


@dataclass(frozen=True)
class DepthSeries:
    """Gridded currents, each at the depth with most periods of days without a gap."""

    step_s: float
    latitude: float
    depth_m: dict[str, float]  # by "recorded", "corrected" and "reference"
    velocity: dict[str, Complexes]  # (t,) by the same names; NaN where there is none


def read_depth_series(path: str | Path) -> DepthSeries:
    """Read from gridded.nc the currents of the affected instrument, before and after, and of the reference.

    Of the depths with 0.9 as many unbroken periods of 15 days as any, that with most values is taken, for the reference
    the one nearest to it.
    """
    grid, depths, flows = open_gridded(path), dict[str, float](), dict[str, Complexes]()
    series = {"corrected": grid.velocity, "recorded": grid.recorded, "reference": grid.velocity}
    for names, there in (
        (("corrected", "recorded"), grid.affected), (("reference",), (grid.source >= 0) & ~grid.affected),
    ):  # fmt: skip
        missing = np.pad(np.cumsum(~there, axis=0), ((1, 0), (0, 0)))
        length = min(int(15.0 * DAY_S / grid.step_s), len(there))
        unbroken = np.sum(missing[length:] == missing[: len(missing) - length], axis=0)
        usual = np.flatnonzero(unbroken >= 0.9 * unbroken.max())
        level = int(usual[np.argmax(there.sum(axis=0)[usual])])
        if "corrected" in depths:
            level = int(usual[np.argmin(np.abs(grid.depth_m[usual] - depths["corrected"]))])
        for name in names if there[:, level].any() else ():
            depths[name] = float(grid.depth_m[level])
            flows[name] = np.where(there[:, level], series[name][:, level], NONE)
    with open_netcdf(path) as nc:
        return DepthSeries(grid.step_s, float(nc["LATITUDE"][...]), depths, flows)


@dataclass(frozen=True)
class GriddedCurrents(records.Labelled):
    """Velocities of a mooring on t times and z depths, NaN where there is none."""

    time_s: Floats  #: (t,) middle of each interval, UTC seconds since 1970
    depth_m: Floats  #: (z,) m below the surface, positive down
    bounds_m: Floats  #: (z, 2) upper and lower bound of each depth
    velocity: Complexes  #: (t, z) m/s, true east + i north
    east_sigma: Floats  #: (t, z) m/s, standard deviation of each cell
    north_sigma: Floats  #: (t, z) m/s, standard deviation of each cell
    quality: records.Flags  #: (t, z) OceanSITES flag, 8 for interpolated
    source: NDArray[np.intp]  #: (t, z) index into ``instruments``, -1 where there is no velocity
    instruments: tuple[str, ...]  #: names, affected instruments first
    errors: HeadingErrors  #: heading errors, which are correlated between cells and times
    memory_s: float  #: s, e-folding time of the errors that do not come from a heading
    correction_deg: Floats  #: (a, t) corrected minus recorded heading of each affected instrument
    path: str = ""  #: the file that they were read from

    @property
    def step_s(self) -> float:
        """Time step, s; an hour where there are no two times."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else HOUR_S

    @property
    def affected(self) -> Bools:
        """Whether a velocity is that of an affected instrument, (t, z)."""
        return (self.source >= 0) & (self.source < len(self.correction_deg))

    @property
    def recorded(self) -> Complexes:
        """Velocities, (t, z) m/s, those of affected instruments by the recorded heading."""
        instrument, time = np.where(self.affected, self.source, 0), np.arange(len(self.time_s))[:, None]
        angle = np.where(self.affected, np.nan_to_num(self.correction_deg)[instrument, time], 0.0)
        east, north = angles.turn(self.velocity.real, self.velocity.imag, -angle)
        return east + 1j * north

    def sum_cells(self, east: ArrayLike, north: ArrayLike) -> tuple[float, float]:
        """Compute a weighted sum of the velocities, such as a transport or a mean, and its standard deviation.

        Args:
            east: weights of the eastward velocity, broadcast to (t, z); cells without a velocity are left out.
            north: weights of the northward velocity, likewise.
        """
        flow, remainder, source = self._terms
        there = np.asarray(source >= 0)
        east, north = (np.where(there, np.broadcast_to(np.asarray(w, float), there.shape), 0.0) for w in (east, north))
        sigma = sum_sigma(east, north, flow, remainder, source, self.errors, self.step_s, memory_s=self.memory_s)
        return float(np.sum(east * flow.real + north * flow.imag)), sigma

    def transport(
        self, from_m: float, to_m: float, *, width_m: float, along_deg: float, least_share: float = 1.0
    ) -> xarray.DataArray:
        """Compute the volume transport past the mooring between two depths, m3/s, positive towards a direction.

        The coordinate ``sigma`` is the standard deviation of each time. The attributes ``mean_transport`` and
        ``mean_sigma`` are of the mean over all times with a transport, whose heading errors are partly common.

        Args:
            width_m: width of the section that the velocities stand for.
            along_deg: direction, clockwise from true north.
            least_share: share of the range that must have velocities; what has none is taken to move as the mean of the
                rest, without an uncertainty of its own.

        Raises:
            InputError: the depths do not lie within those of the file, the width is not positive, or no time has
                velocities at enough of the depths.
            ImportError: xarray is not installed.
        """
        upper, lower = self.bounds_m.T if len(self.bounds_m) else np.zeros((2, 1))
        if not upper[0] <= from_m < to_m <= lower[-1]:
            expected, advice = f"from_m and to_m within {upper[0]:g} to {lower[-1]:g} m", "name other depths"
            raise InputError(self.path, expected=expected, found=f"{from_m:g} to {to_m:g}", advice=advice)
        if not width_m > 0.0:
            raise InputError("width_m", expected="a width above 0 m", found=f"{width_m:g}", advice="write the width")
        flow, remainder, source = self._terms
        height_m = np.maximum(np.minimum(lower, to_m) - np.maximum(upper, from_m), 0.0) * (source >= 0)
        share = height_m.sum(axis=1) / (to_m - from_m)
        enough = share >= least_share - 1e-6
        if not enough.any():
            expected = f"a time with velocities at {100 * least_share:g} % of {from_m:g} to {to_m:g} m"
            advice = "name other depths, or a smaller least_share"
            raise InputError(self.path, expected=expected, found=f"{100 * share.max():.3g} %", advice=advice)
        area = width_m * height_m * np.where(enough, 1.0 / np.maximum(share, 1e-6), 0.0)[:, None]
        east, north = (area * float(part) for part in angles.sin_cos(along_deg))
        series = np.sum(east * flow.real + north * flow.imag, axis=1)
        modes, random, white = errors_by_time(east, north, flow, remainder, source, self.errors)
        sigma = np.sqrt(np.sum(modes**2, axis=0) + np.sum(random**2, axis=0) + white)
        mean, mean_sigma = self.sum_cells(east / enough.sum(), north / enough.sum())
        with records.import_xarray().open_dataset(self.path) as data:
            time = data.TIME.load()
        attributes = {
            "long_name": f"volume transport towards {along_deg:g} degrees, {from_m:g} to {to_m:g} m",
            "standard_name": "ocean_volume_transport_across_line", "units": "m3 s-1", "width_m": width_m,
            "mean_transport": mean, "mean_sigma": mean_sigma,
        }  # fmt: skip
        described = {"long_name": "standard deviation of the transport", "units": "m3 s-1"}
        return records.import_xarray().DataArray(
            np.where(enough, series, np.nan), dims="TIME", name="transport", attrs=attributes,
            coords={"TIME": time, "sigma": ("TIME", np.where(enough, sigma, np.nan), described)},
        )  # fmt: skip

    @cached_property
    def _terms(self) -> tuple[Complexes, Floats, NDArray[np.intp]]:
        """Velocities, 0 where there is none, the variance of a component not due to the heading, and the source."""
        there = np.isfinite(self.velocity) & np.isfinite(self.east_sigma)
        flow = np.where(there, self.velocity, 0.0)
        variances = np.array([self.errors.variance(s) for s in range(len(self.errors.shares))])
        of_heading = variances[np.maximum(self.source, 0), np.arange(len(there))[:, None]] * np.abs(flow) ** 2
        remainder = np.maximum((self.east_sigma**2 + self.north_sigma**2 - of_heading) / 2.0, 0.0)
        return flow, np.where(there, remainder, 0.0), np.where(there, self.source, -1)


def open_gridded(path: str | Path) -> GriddedCurrents:
    """Read gridded.nc or gridded_daily.nc, or gridded.nc of the folder of a mooring's results."""
    path = Path(path) / "gridded.nc" if Path(path).is_dir() else Path(path)
    with open_netcdf(path) as nc:
        if "HEADING_ERROR_MODE" not in nc.variables:
            advice = "open corrected.nc by compasslib.open_product"
            raise InputError(str(path), expected="gridded velocities", found="another file", advice=advice)
        names = ("TIME", "DEPTH", "DEPTH_bnds", "UCUR", "VCUR", "UCUR_UNCERTAINTY", "VCUR_UNCERTAINTY")
        time, depth_m, bounds_m, east, north, east_sigma, north_sigma = (read_variable(nc, name) for name in names)
        modes = read_variable(nc, "HEADING_ERROR_MODE")
        random, memory_h = read_variable(nc, "HEADING_ERROR_RANDOM"), nc["HEADING_ERROR_RANDOM"].memory_hours
        errors = HeadingErrors(
            tuple(nc["HEADING_ERROR_MODE"].mode_names.split(", ")), modes, np.atleast_2d(random), memory_h * HOUR_S,
            read_variable(nc, "HEADING_ERROR_SHARE"),
        )  # fmt: skip
        return GriddedCurrents(
            seconds_since_1970(time), depth_m, bounds_m, east + 1j * north,
            east_sigma, north_sigma, np.asarray(nc["UCUR_QC"][:]), np.asarray(nc["SOURCE"][:], dtype=np.intp) - 1,
            tuple(nc["SOURCE"].flag_meanings.split()[1:]), errors,
            nc["UCUR_UNCERTAINTY"].error_memory_hours * HOUR_S,
            np.atleast_2d(read_variable(nc, "HEADING_CORRECTION")), str(path),
        )  # fmt: skip
