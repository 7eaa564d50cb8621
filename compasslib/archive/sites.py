"""Daily means of the successive deployments of a site, joined to one file of the form of gridded_daily.nc."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.archive import gridded, provenance
from compasslib.archive.attributes import Site
from compasslib.archive.files import open_netcdf, read_variable
from compasslib.archive.netcdf import Columns, seconds_since_1970
from compasslib.errors import InputError
from compasslib.product.cells import Axes
from compasslib.product.errors import HeadingErrors
from compasslib.records import MISSING
from compasslib.types import DAY_S, HOUR_S, Complexes


@dataclass(frozen=True)
class _Deployment:
    """Content of gridded_daily.nc of one deployment."""

    name: str
    values: dict[str, NDArray[Any]]  # by variable
    attributes: dict[str, Any]
    instruments: list[str]
    modes: list[str]
    memory_h: tuple[float, float]  # of the random error of headings, and of other errors
    step_m: float

    @property
    def affected(self) -> int:
        """Number of affected instruments, the first ones."""
        return len(self.values["HEADING_ERROR_RANDOM"])

    @property
    def velocity(self) -> Complexes:
        return np.asarray(self.values["UCUR"] + 1j * self.values["VCUR"])


def _read(name: str, path: str | Path) -> _Deployment:
    with open_netcdf(path) as nc:
        values = {key: read_variable(nc, key) for key in nc.variables if key != "STATION"}
        for key in ("HEADING_ERROR_RANDOM", "HEADING_CORRECTION"):
            values[key] = np.atleast_2d(values[key])
        return _Deployment(
            name, values, {key: nc.getncattr(key) for key in nc.ncattrs()}, nc["SOURCE"].flag_meanings.split()[1:],
            nc["HEADING_ERROR_MODE"].mode_names.split(", "),
            (float(nc["HEADING_ERROR_RANDOM"].memory_hours), float(nc["UCUR_UNCERTAINTY"].error_memory_hours)),
            float(np.ptp(values["DEPTH_bnds"][-1])),
        )  # fmt: skip


def join_daily(
    path: str | Path, deployments: Mapping[str, str | Path], site: str, attributes: Mapping[str, object]
) -> list[str]:
    """Write the joined file, and return a sentence on each seam between two deployments.

    Of a cell that several deployments have, the one with most samples is used. The error of the declination is common
    to all deployments, every other mode to the instruments of one.

    Args:
        deployments: gridded_daily.nc by name of the deployment, in order of time.
        attributes: global attributes from the YAML files.

    Raises:
        InputError: depths of two deployments are not on one axis.
    """
    each = [made for name, file in deployments.items() if (made := _read(name, file)).values["TIME"].size]
    if not each:
        advice = "look at the reports of its moorings"
        raise InputError(f"site {site}", expected="daily means of a deployment", found="none", advice=advice)
    first, step_m = each[0], each[0].step_m
    top_m = min(float(d.values["DEPTH"][0]) for d in each)
    for d in each:
        level = (d.values["DEPTH"][0] - top_m) / step_m
        if abs(d.step_m - step_m) > 1e-6 or abs(level - round(level)) > 1e-3:
            expected = f"depths on the axis of {first.name}, {step_m:g} m apart from {first.values['DEPTH'][0]:g} m"
            actual = f"{d.step_m:g} m apart from {d.values['DEPTH'][0]:g} m"
            advice = "write the same product: {grid: {step_m: ..., from_m: ...}} for all"
            raise InputError(f"site {site}: {d.name}", expected=expected, found=actual, advice=advice)
    days = [np.floor(d.values["TIME"]).astype(int) for d in each]
    rows = [x - min(y[0] for y in days) for x in days]
    columns = [np.rint((d.values["DEPTH"] - top_m) / step_m).astype(int) for d in each]
    shape = max(x[-1] for x in rows) + 1, max(x[-1] for x in columns) + 1
    noon_s = seconds_since_1970(min(x[0] for x in days) + 0.5 + np.arange(shape[0]))
    axes = Axes(noon_s, DAY_S, top_m + step_m * np.arange(shape[1]), step_m)
    errors, turned, shrinkage, numbers = _join_headings(each, rows, shape[0])
    cells = _join_cells(each, rows, columns, shape, numbers)
    seams = [_describe_seam(*pair) for pair in pairwise(zip(each, rows, columns, strict=True))]
    place, written = _describe(site, each, axes, attributes, deployments.values(), seams)
    instruments = [""] * len(errors.shares)
    for d, number in zip(each, numbers, strict=True):
        for name, k in zip(d.instruments, number[1:], strict=True):
            instruments[k - 1] = f"{d.name}_{name}"
    memory_s = HOUR_S * max(d.memory_h[1] for d in each)
    with gridded.create_gridded(path, written, place, axes, errors, turned, instruments) as nc:
        gridded.put_columns(nc, cells | {"SHRINKAGE": (shrinkage, None)}, gridded.column_attributes({}, memory_s))
    return seams


def _join_headings(
    each: Sequence[_Deployment], rows: Sequence[NDArray[Any]], days: int
) -> tuple[HeadingErrors, NDArray[Any], NDArray[Any], list[NDArray[Any]]]:
    """Join the heading errors: errors, corrections (a, t), shrinkage (t,), and the new number of each SOURCE."""
    affected, total = sum(d.affected for d in each), sum(len(d.instruments) for d in each)
    names = ["declination", *(f"{d.name}: {mode}" for d in each for mode in d.modes[1:])]
    modes, shares = np.full((len(names), days), np.nan), np.zeros((total, len(names)))
    random, turned = (np.full((affected, days), np.nan) for _ in range(2))
    shrinkage, numbers = np.full(days, np.nan), []
    begin, mode, other = 0, 1, affected
    for d, row in zip(each, rows, strict=True):
        affected_d, more = d.affected, len(d.instruments) - d.affected
        number = np.array([0, *range(begin + 1, begin + affected_d + 1), *range(other + 1, other + more + 1)])
        place = np.array([0, *range(mode, mode + len(d.modes) - 1)])
        known = np.isfinite(d.values["HEADING_ERROR_MODE"])
        joined = modes[np.ix_(place, row)]
        modes[np.ix_(place, row)] = np.where(known, d.values["HEADING_ERROR_MODE"], joined)
        shares[np.ix_(number[1:] - 1, place)] = d.values["HEADING_ERROR_SHARE"]
        random[begin : begin + affected_d, row] = d.values["HEADING_ERROR_RANDOM"]
        turned[begin : begin + affected_d, row] = d.values["HEADING_CORRECTION"]
        shrinkage[row] = np.fmin(shrinkage[row], d.values["SHRINKAGE"])
        numbers.append(number)
        begin, mode, other = begin + affected_d, mode + len(d.modes) - 1, other + more
    memory_s = HOUR_S * max(d.memory_h[0] for d in each)
    return HeadingErrors(tuple(names), modes, random, memory_s, shares), turned, shrinkage, numbers


def _join_cells(
    each: Sequence[_Deployment], rows: Sequence[NDArray[Any]], columns: Sequence[NDArray[Any]], shape: tuple[int, int],
    numbers: Sequence[NDArray[Any]],
) -> Columns:  # fmt: skip
    """Join the variables of cells, each cell from the deployment with most samples."""
    names = [name for name, values in each[0].values.items() if values.shape == each[0].values["UCUR"].shape]
    joined: dict[str, NDArray[Any]] = {}
    for name in (name for name in names if not name.endswith("_bnds") and not name.startswith("HEADING_")):
        kind, empty = each[0].values[name].dtype, MISSING if name.endswith("_QC") else 0
        joined[name] = np.full(shape, np.nan if kind.kind == "f" else empty, dtype=kind)
    for d, row, column, number in zip(each, rows, columns, numbers, strict=True):
        place = np.ix_(row, column)
        better = d.values["N_SAMPLES"] > joined["N_SAMPLES"][place]
        low_passed = np.isfinite(d.values["UCUR_LOWPASS"]) & ~np.isfinite(joined["UCUR_LOWPASS"][place])
        for name, values in joined.items():
            given = number[d.values[name]].astype(np.int8) if name == "SOURCE" else d.values[name]
            taken = low_passed if "LOWPASS" in name else better
            values[place] = np.where(taken, given, values[place])
    flags = {name.removesuffix("_QC"): joined.pop(name) for name in [*joined] if name.endswith("_QC")}
    return {name: (values, flags.get(name)) for name, values in joined.items()}


def _describe_seam(earlier: tuple[Any, ...], later: tuple[Any, ...]) -> str:
    """Describe the gap between two deployments, or their differences on common days."""
    before, after = earlier[0], later[0]
    lat, lon = (np.array([float(d.values[axis]) for d in (before, after)]) for axis in ("LATITUDE", "LONGITUDE"))
    east = float(angles.wrap180(np.diff(lon))[0]) * float(angles.sin_cos(lat.mean())[1])
    apart_km = 111.2 * float(np.hypot(np.diff(lat)[0], east))  # of one degree on a sphere of 6371 km
    said = f"{before.name} to {after.name}, {apart_km:.1f} km apart: "
    days, levels = (np.intersect1d(earlier[k], later[k]) for k in (1, 2))
    if not len(days):
        return said + f"{later[1][0] - earlier[1][-1] - 1} days between them"
    flows = [d.velocity[np.ix_(np.isin(row, days), np.isin(column, levels))] for d, row, column in (earlier, later)]
    off = flows[1] - flows[0]
    off = 100.0 * off[np.isfinite(off)]
    if not off.size:
        return said + f"{len(days)} common days without common cells"
    mean, rms = off.mean(), np.sqrt(np.mean(np.abs(off) ** 2))
    return said + (
        f"{len(days)} common days; later minus earlier {mean.real:+.1f} cm/s east, {mean.imag:+.1f} cm/s north, rms "
        f"{rms:.1f} cm/s, in {off.size} common cells"
    )


def _describe(
    site: str, each: Sequence[_Deployment], axes: Axes, attributes: Mapping[str, object], files: Iterable[str | Path],
    seams: Sequence[str],
) -> tuple[Site, dict[str, Any]]:  # fmt: skip
    """Compose the position, that of the first deployment, and the global attributes."""
    first, names = each[0], ", ".join(d.name for d in each)
    place = Site(
        site, float(first.values["LATITUDE"]), float(first.values["LONGITUDE"]), first.attributes.get("water_depth")
    )
    recorded, corrected = (
        sum(int(d.attributes[f"headings_{part}"]) for d in each) for part in ("recorded", "corrected")
    )
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
    description = gridded.FileDescription(place, None, attributes, made, (recorded, corrected), also)
    return place, description.compose("gridded-daily", axes.time_s, axes.depth_m)[0]
