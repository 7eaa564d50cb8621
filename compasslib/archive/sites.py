"""Daily means of the successive deployments of a site, joined to one file of the form of gridded_daily.nc."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.archive import gridded, provenance
from compasslib.archive.attributes import Site
from compasslib.archive.files import open_netcdf, read_variable
from compasslib.archive.gridded import GriddedCurrents
from compasslib.archive.netcdf import Columns
from compasslib.archive.variables import CELLS
from compasslib.earthfield import DEGREE_KM
from compasslib.errors import InputError
from compasslib.product.cells import Axes
from compasslib.product.errors import HeadingErrors
from compasslib.records import MISSING
from compasslib.types import DAY_S, Complexes, Floats


@dataclass(eq=False)
class _Deployment:
    """Content of gridded_daily.nc of one deployment, and its place in the joined file."""

    name: str
    grid: GriddedCurrents
    cells: dict[str, NDArray[Any]]  # (t, z) by variable
    shrinkage: Floats  # (t,)
    attributes: dict[str, Any]
    latitude: float
    longitude: float
    number: NDArray[np.intp]  # number in the joined file of each value of SOURCE
    days: NDArray[np.intp]  # since 1970
    levels: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # depths in the joined file

    @property
    def affected(self) -> int:
        """Number of affected instruments."""
        return len(self.grid.errors.random)


def _read(name: str, path: str | Path) -> _Deployment:
    grid = gridded.open_gridded(path)
    with open_netcdf(path) as nc:
        cells = {key: read_variable(nc, key) for key in nc.variables if nc[key].dimensions == CELLS}
        attributes = {key: nc.getncattr(key) for key in nc.ncattrs()}
        latitude, longitude = (float(nc[axis][...]) for axis in ("LATITUDE", "LONGITUDE"))
        number, days = np.zeros(len(grid.instruments) + 1, dtype=np.intp), np.floor(grid.time_s / DAY_S).astype(np.intp)
        shrinkage = read_variable(nc, "SHRINKAGE")
    return _Deployment(name, grid, cells, shrinkage, attributes, latitude, longitude, number, days)


def join_daily(
    path: str | Path, deployments: Mapping[str, str | Path], site: str, attributes: Mapping[str, object],
    common: Sequence[str] = (),
) -> list[str]:  # fmt: skip
    """Write the joined file, and return a sentence on each seam between two deployments.

    Of a cell that several deployments have, the one with most samples is used. The error of the declination is common
    to all deployments, every other mode to the instruments of one.

    Args:
        deployments: gridded_daily.nc by name of the deployment, in order of time.
        attributes: global attributes from the YAML files.
        common: further sentences, on what the deployments have in common.

    Raises:
        InputError: no deployment has any.
    """
    each = [made for name, file in deployments.items() if (made := _read(name, file)).days.size]
    if not each:
        raise InputError(f"site {site}", "daily means of a deployment", "none", "look at the reports of its moorings")
    top_m = min(float(d.grid.depth_m[0]) for d in each)
    step_m = float(np.ptp(each[0].grid.bounds_m[-1]))
    for d in each:  # the configuration has one axis for all deployments of a site
        d.levels = np.rint((d.grid.depth_m - top_m) / step_m).astype(np.intp)
    # Affected instruments of all deployments are numbered first.
    order = [(d, k) for d in each for k in range(d.affected)]
    order += [(d, k) for d in each for k in range(d.affected, len(d.grid.instruments))]
    for number, (d, k) in enumerate(order, 1):
        d.number[k + 1] = number
    days = np.arange(min(d.days[0] for d in each), max(d.days[-1] for d in each) + 1)
    depth_m = top_m + step_m * np.arange(max(d.levels[-1] for d in each) + 1)
    axes = Axes(DAY_S * (days + 0.5), DAY_S, depth_m, step_m)
    seams = [*(_describe_seam(*pair) for pair in pairwise(each)), *common]
    errors, turned, shrinkage = _join_headings(each, days)
    with gridded.create_gridded(
        path, "gridded-daily", _describe(site, each, attributes, deployments.values(), seams), axes, errors, turned,
        [f"{d.name}_{d.grid.instruments[k]}" for d, k in order], max(d.grid.memory_s for d in each),
    ) as nc:  # fmt: skip
        cells = _join_cells(each, days, len(depth_m))
        gridded.write_columns(nc, cells | {"SHRINKAGE": (shrinkage, None)})
    return seams


def _join_headings(
    each: Sequence[_Deployment], days: NDArray[np.intp]
) -> tuple[HeadingErrors, NDArray[Any], NDArray[Any]]:
    """Join the heading errors, the corrections (a, t) and the shrinkage (t,)."""
    names = ["declination", *(f"{d.name}: {mode}" for d in each for mode in d.grid.errors.names[1:])]
    affected, total = sum(d.affected for d in each), sum(len(d.grid.instruments) for d in each)
    modes, shares = np.full((len(names), len(days)), np.nan), np.zeros((total, len(names)))
    random, turned = (np.full((affected, len(days)), np.nan) for _ in range(2))
    shrinkage, mode = np.full(len(days), np.nan), 1
    for d in each:
        rows, sources, errors = d.days - days[0], d.number[1:] - 1, d.grid.errors
        place = np.array([0, *range(mode, mode + len(errors.names) - 1)])
        mode += len(errors.names) - 1
        modes[np.ix_(place, rows)] = np.where(np.isfinite(errors.modes), errors.modes, modes[np.ix_(place, rows)])
        shares[np.ix_(sources, place)] = errors.shares
        random[np.ix_(sources[: d.affected], rows)] = errors.random
        turned[np.ix_(sources[: d.affected], rows)] = d.grid.correction_deg
        shrinkage[rows] = np.fmin(shrinkage[rows], d.shrinkage)
    memory_s = max(d.grid.errors.memory_s for d in each)
    return HeadingErrors(tuple(names), modes, random, memory_s, shares), turned, shrinkage


def _join_cells(each: Sequence[_Deployment], days: NDArray[np.intp], depths: int) -> Columns:
    """Join the variables of cells, each cell from the deployment with most samples."""
    joined: dict[str, NDArray[Any]] = {}
    for name, values in each[0].cells.items():
        empty = np.nan if values.dtype.kind == "f" else MISSING if name.endswith("_QC") else 0
        joined[name] = np.full((len(days), depths), empty, dtype=values.dtype)
    for d in each:
        place = np.ix_(d.days - days[0], d.levels)
        better = d.cells["N_SAMPLES"] > joined["N_SAMPLES"][place]
        low_passed = np.isfinite(d.cells["UCUR_LOWPASS"]) & ~np.isfinite(joined["UCUR_LOWPASS"][place])
        for name, values in joined.items():
            given = d.number[d.cells[name]].astype(np.int8) if name == "SOURCE" else d.cells[name]
            values[place] = np.where(low_passed if "LOWPASS" in name else better, given, values[place])
    flags = {name.removesuffix("_QC"): joined.pop(name) for name in [*joined] if name.endswith("_QC")}
    return {name: (values, flags.get(name)) for name, values in joined.items()}


def _describe_seam(before: _Deployment, after: _Deployment) -> str:
    """Describe the gap between two deployments, or their differences on common days."""
    middle = (before.latitude + after.latitude) / 2.0
    east = float(angles.difference(after.longitude, before.longitude)) * float(angles.sin_cos(middle)[1])
    apart_km = DEGREE_KM * float(np.hypot(after.latitude - before.latitude, east))
    said = f"{before.name} to {after.name}, {apart_km:.1f} km apart: "
    days, levels = np.intersect1d(before.days, after.days), np.intersect1d(before.levels, after.levels)
    if not len(days):
        return said + f"{after.days[0] - before.days[-1] - 1} days between them"
    flows = [d.grid.velocity[np.ix_(np.isin(d.days, days), np.isin(d.levels, levels))] for d in (before, after)]
    off: Complexes = flows[1] - flows[0]
    off = 100.0 * off[np.isfinite(off)]
    if not off.size:
        return said + f"{len(days)} common days without common cells"
    mean, rms = off.mean(), np.sqrt(np.mean(np.abs(off) ** 2))
    return said + (
        f"{len(days)} common days; later minus earlier {mean.real:+.1f} cm/s east, {mean.imag:+.1f} cm/s north, rms "
        f"{rms:.1f} cm/s, in {off.size} common cells"
    )


def _describe(
    site: str, each: Sequence[_Deployment], attributes: Mapping[str, object], files: Iterable[str | Path],
    seams: Sequence[str],
) -> gridded.FileDescription:  # fmt: skip
    """Describe the joined file, at the position of the first deployment."""
    first, names = each[0], ", ".join(d.name for d in each)
    place = Site(site, first.latitude, first.longitude, first.attributes.get("water_depth"))
    recorded, corrected = (sum(int(d.attributes[f"headings_{x}"]) for d in each) for x in ("recorded", "corrected"))
    made: dict[str, Any] = provenance.origin("daily means of deployments joined", provenance.hashes(map(str, files)))
    made["method"] = "; ".join(dict.fromkeys(d.attributes["correction_method"] for d in each))
    also = {
        "title": f"Currents of site {site} on fixed depths: daily means of {len(each)} deployments",
        "summary": f"Daily mean currents of site {site} on fixed depths, joined from the deployments {names}, with the "
        "uncertainty that sections and transports need.",
        "history": "\n".join([*(d.attributes["history"] for d in each), made["history"]]),
        "deployments": names,
        "seams": "; ".join(seams),
    }
    return gridded.FileDescription(place, None, attributes, made, (recorded, corrected), also)
