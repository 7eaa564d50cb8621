"""Files of many layouts and formats, drawn by seed with the values that they hold, written by plain numpy and text."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from scipy.io import savemat

DAY_S = 86400.0
COLUMNS = {"time": "t", "east": "u", "north": "v", "heading": "h"}
L20 = {"good": ["1"], "bad": ["4"]}


@dataclass(frozen=True)
class Truth:
    """What a file holds; flags are those of OceanSITES."""

    time: np.ndarray  # (n,) datetime64[s]
    east: np.ndarray  # (n, m) m/s, three decimals
    north: np.ndarray
    heading: np.ndarray  # (n,) degrees, one decimal
    flag: np.ndarray  # (n,)

    @property
    def time_s(self) -> np.ndarray:
        return self.time.astype("datetime64[s]").astype(float)

    @property
    def parts(self) -> np.ndarray:
        """Year, month, day, hour, minute and second, (n, 6)."""
        return np.array([t.timetuple()[:6] for t in self.time.astype("datetime64[s]").astype(object)])


def draw(rng: np.random.Generator, cells: int = 1) -> Truth:
    """Draw the values of a file."""
    n = int(rng.integers(30, 90))
    begin = np.datetime64("2003-01-01T00:00:00") + rng.integers(0, 6000) * np.timedelta64(1, "D")
    step = np.timedelta64(int(rng.choice([60, 600, 1800])), "s")
    east, north = rng.normal(0.0, 0.3, (2, n, cells)).round(3)
    flag = np.where(np.arange(n) < n // 2, 1, 4)
    return Truth(begin + step * np.arange(n), east, north, rng.uniform(0.0, 359.9, n).round(1), flag)


def _rows(path: Path, truth: Truth, times: list[list[str]], head: str = "", by: str = ",", **how: Any) -> None:
    """Write a table: times, u, v, heading and flag; ``decimal`` and ``scale`` change the numbers."""
    decimal, scale = how.get("decimal", "."), how.get("scale", 1.0)
    cells = [
        [*t, *(f"{x:.3f}".replace(".", decimal) for x in (scale * u, scale * v, h)), str(q)]
        for t, u, v, h, q in zip(times, truth.east[:, 0], truth.north[:, 0], truth.heading, truth.flag, strict=True)
    ]
    path.write_text(head + "".join(by.join(row) + "\n" for row in cells))


def _iso(truth: Truth) -> list[list[str]]:
    return [[str(t)] for t in truth.time]


def _by_number(path: Path, truth: Truth) -> dict[str, Any]:
    _rows(path, truth, [[str(x) for x in row] for row in truth.parts], by="  ")
    return {"columns": {"time": [1, 2, 3, 4, 5, 6], "east": 7, "north": 8, "heading": 9}}


def _short_names(path: Path, truth: Truth) -> dict[str, Any]:
    names = ["yr", "mon", "day", "hr", "min", "sec"]
    _rows(path, truth, [[str(x) for x in row] for row in truth.parts], ",".join([*names, "u,v,h,q\n"]))
    return {"columns": COLUMNS | {"time": names}}


def _odf(path: Path, truth: Truth) -> dict[str, Any]:
    times = [t.strftime("'%d-%b-%Y %H:%M:%S.00'").split() for t in truth.time.astype(object)]
    _rows(path, truth, times, "ODF_HEADER,\n  FILE_SPECIFICATION='M1',\n-- DATA --\n", by="  ")
    return {"columns": {"date": 1, "clock": 2, "east": 3, "north": 4, "heading": 5}, "skip_rows": 3}


def _day_of_year(path: Path, truth: Truth) -> dict[str, Any]:
    new_year = truth.time.astype("datetime64[Y]").astype("datetime64[s]")
    days = 1.0 + (truth.time - new_year).astype(float) / DAY_S
    years = truth.parts[:, 0]
    times = [[str(year), f"{day:.8f}"] for year, day in zip(years, days, strict=True)]
    _rows(path, truth, times, "YEAR,DAY_OF_YEAR,u,v,h,q\n")
    return {"columns": COLUMNS | {"time": ["YEAR", "DAY_OF_YEAR"]}}


def _matplotlib(path: Path, truth: Truth) -> dict[str, Any]:
    old = 719163.0 * (len(truth.time) % 2)  # as before version 3.3
    _rows(path, truth, [[f"{t / DAY_S + old:.8f}"] for t in truth.time_s], "t;u;v;h;q\n", ";")
    return {"columns": COLUMNS, "time_format": "matplotlib"}


def _twice(path: Path, truth: Truth) -> dict[str, Any]:
    _rows(path, truth, [[str(t), "9.9"] for t in truth.time], "mooring M1,\nt,u,u,v,h,h\n")
    return {"columns": COLUMNS | {"east": "u.2", "flag": "h.2"}, "flags": L20}


def _header_line(path: Path, truth: Truth) -> dict[str, Any]:
    head = "! made by hand\nt,u,v,h,q\n! 3 lines\nt,u,v,h,q\n"
    _rows(path, truth, _iso(truth), head)
    text = path.read_text().replace("\n", "\n! a remark\n", 9)
    path.write_text(text.replace("! 3 lines\n! a remark\nt,u,v,h,q\n", "! 3 lines\n"))
    return {"columns": COLUMNS, "comment": "!", "header": text.split("\n").index("t,u,v,h,q") + 1}


def _units_in_comment(path: Path, truth: Truth) -> dict[str, Any]:
    _rows(path, truth, _iso(truth), "# M1\n# t,u,v,h,q\n# ,cm/s,cm/s,degrees,\n", scale=100.0)
    return {"columns": COLUMNS}


def _day_first(path: Path, truth: Truth) -> dict[str, Any]:
    times = [[f"{d}/{m}/{y} {h}:{i:02d}:{s:02d}"] for y, m, d, h, i, s in truth.parts]
    _rows(path, truth, times, "t\tu\tv\th\tq\n", "\t")
    return {"columns": COLUMNS | {"flag": "q"}, "time_format": "%d/%m/%Y %H:%M:%S", "flags": L20}


def _quoted(path: Path, truth: Truth) -> dict[str, Any]:
    _rows(path, truth, [[f'"{t}"'] for t in truth.time], '"t","u, east",v,h,q\n')
    return {"columns": COLUMNS | {"east": "u, east"}}


def _odv(path: Path, truth: Truth, *, julian: bool = False) -> dict[str, Any]:
    head = "//<subject>SDN:LOCAL:U</subject><object>SDN:P01::LCEWEL01</object><units>SDN:P06::UVBB</units>\n"
    names = ["Cruise", "Station", "Type", "YYYY-MM-DDThh:mm:ss.sss", "Bot. Depth [m]", "time_ISO8601", "QV:SEADATANET"]
    names[5] = "Chronological Julian Date [days]" if julian else names[5]
    times = [f"{t / DAY_S + 2440588.0:.8f}" for t in truth.time_s] if julian else [f"{t}.000" for t in truth.time]
    names += [x for name in ("U [cm/s]", "NSCT [cm/s]", "Heading [degrees]") for x in (name, "QV:SEADATANET")]
    rows = [["Cr", "M1", "*", "2019-05-03T00:00:00.000", "200"], *[[""] * 5] * (len(truth.time) - 1)]
    numbers = zip(times, 100 * truth.east[:, 0], 100 * truth.north[:, 0], truth.heading, truth.flag, strict=True)
    cells = [[t, "1", f"{u:.1f}", str(q), f"{v:.1f}", "1", f"{h:.1f}", "1"] for t, u, v, h, q in numbers]
    lines = ["\t".join([*row, *cell]) for row, cell in zip(rows, cells, strict=True)]
    path.write_text(head + "\n".join(["\t".join(names), *lines, ""]))
    return {}


def _winadcp(path: Path, truth: Truth) -> dict[str, Any]:
    clock = ("SerYear", "SerMon", "SerDay", "SerHour", "SerMin", "SerSec")
    made: dict[str, Any] = {
        k: x[:, None] * 1.0 for k, x in zip(clock, (truth.parts - [2000, 0, 0, 0, 0, 0]).T, strict=True)
    }
    made |= {"SerEmmpersec": np.rint(1000 * truth.east), "SerNmmpersec": np.rint(1000 * truth.north)}
    made |= {"AnH100thDeg": np.rint(100 * truth.heading)[:, None], "AnOrienUP": np.ones((len(truth.time), 1))}
    made |= {"RDIBin1Mid": 6.0, "RDIBinSize": 4.0, "SerBins": 1.0 + np.arange(truth.east.shape[1])[None]}
    made["RDIFileName"] = "A_000.000"
    savemat(path, made)
    return {"direction_reference": "magnetic"}


def _rdradcp(path: Path, truth: Truth) -> dict[str, Any]:
    ranges = 6.0 + 4.0 * np.arange(truth.east.shape[1])[:, None]
    config = {"ranges": ranges, "orientation": "down", "coord_sys": "earth", "magnetic_var": 0.0}
    adcp = {"mtime": truth.time_s[None] / DAY_S + 719529.0, "east_vel": truth.east.T, "north_vel": truth.north.T}
    adcp["heading"] = truth.heading[None]
    adcp = {name: np.pad(values, ((0, 0), (0, 2))) for name, values in adcp.items()}  # ensembles that were not read
    savemat(path, {"adcp": adcp | {"config": config}})
    return {"direction_reference": "magnetic"}


def _named_arrays(path: Path, truth: Truth) -> dict[str, Any]:
    flow = {"t": truth.time_s, "u": 100 * truth.east.T, "v": 100 * truth.north.T}
    savemat(path, {"d": flow, "h": truth.heading, "z": 2.0 + np.arange(truth.east.shape[1])})
    columns = {"time": "d.t", "east": "d.u", "north": "d.v", "heading": "h", "range": "z", "scale": 0.01}
    return {"columns": columns, "orientation": "up", "direction_reference": "magnetic", "time_format": "epoch"}


SENSORS = (
    "Month|Day|Year|Hour|Minute|Second|Error code|Status code|Battery voltage|Soundspeed|Heading|Pitch|Roll|"
    "Pressure   (dbar)|Pressure   (m)"
)
FLOW = ("Velocity (Beam1|X|East)  (m/s)", "Velocity (Beam2|Y|North)  (m/s)", "Velocity (Beam3|Z|Up)  (m/s)")


def _conversion(path: Path, truth: Truth, *, profiler: bool) -> dict[str, Any]:
    cells = truth.east.shape[1]
    flow = np.stack([truth.east, truth.north, 0.0 * truth.east])
    lines = []
    for k, (y, m, d, h, i, s) in enumerate(truth.parts):
        own = "" if profiler else " ".join(f"{x:8.3f}" for x in flow[:, k, 0])
        begin = f"{m:2d} {d:2d} {y} {h:2d} {i:2d} {s:2d} 00000000 00110000 {own} 12.1 1480.0"
        lines.append(f"{begin} {truth.heading[k]:6.1f} 1.0 0.5 100.0 99.1")
    names = SENSORS.split("|")
    names = names if profiler else [*names[:8], *FLOW, *names[8:]]
    suffix = "sen" if profiler else "dat"
    path.with_suffix(f".{suffix}").write_text("\n".join([*lines, ""]))
    for k in (1, 2, 3) if profiler else ():
        np.savetxt(path.with_suffix(f".v{k}"), flow[k - 1], fmt="%8.3f")
    listed = "\n".join(f"{k:2d}   {name}" for k, name in enumerate(names, 1))
    head = f"[C:\\a\\x.prf]\nAverage interval             60 sec\nNumber of cells              {cells}\n"
    head += "Cell size                             200 cm\nBlanking distance                     0.41 m\n"
    path.write_text(f"{head}Coordinate system                     ENU\n\n[C:\\a\\x.{suffix}]\n{listed}\n")
    return {}


def _contour(path: Path, truth: Truth) -> dict[str, Any]:
    """Directions hold two declinations that add up to 90 degrees, so that east is north and north is minus east."""
    with netCDF4.Dataset(path, "w") as nc:
        config, group = nc.createGroup("Config"), nc.createGroup("Data/Burst")
        config.setncattr("DataInfo_transformsAndCorrections_magneticDeclination", "60.0")
        config.setncattr("Instrument_user_decl", "30.0")
        group.createDimension("time", len(truth.time))
        ranges = "BurstVelocityENU_Range"
        group.createDimension(ranges, truth.east.shape[1])
        series = {"Velocity_East": (truth.north, "m/s"), "Velocity_North": (-truth.east, "m/s")}
        for name, (values, unit) in series.items():
            group.createVariable(name, "f8", ("time", ranges))[:] = values
            group[name].units = unit
        for name, values, unit in (
            ("MatlabTimeStamp", truth.time_s / DAY_S + 719529.0, "days"),
            ("Heading", (truth.heading + 90.0) % 360.0, "degrees"),
            ("Status", np.full(len(truth.time), 5 << 25), "1"),
        ):
            group.createVariable(name, "f8", ("time",))[:] = values
            group[name].units = unit
        group.createVariable(ranges, "f8", (ranges,))[:] = 3.0 + np.arange(truth.east.shape[1])
        group[ranges].units = "m"
    return {"direction_reference": "magnetic"}


def _polar(path: Path, truth: Truth) -> dict[str, Any]:
    with netCDF4.Dataset(path, "w") as nc:
        nc.createDimension("time", len(truth.time))
        speed = np.hypot(truth.east, truth.north)[:, 0]
        direction = np.rad2deg(np.arctan2(truth.east, truth.north))[:, 0]
        for name, values, unit, standard in (
            ("time", truth.time_s, "seconds since 1970-01-01", "time"),
            ("CSPD", 100 * speed, "cm/s", "sea_water_speed"),
            ("CDIR", direction % 360.0, "degrees", "sea_water_velocity_to_direction"),
        ):
            nc.createVariable(name, "f8", ("time",))[:] = values
            nc[name].setncatts({"units": unit, "standard_name": standard})
    return {"direction_reference": "true", "orientation": "up"}


# Kind -> format, suffix, number of cells, writer, which gives the settings, and whether it holds headings and flags.
KINDS: dict[str, tuple[str, str, int, Callable[[Path, Truth], dict[str, Any]], bool, bool]] = {
    "columns by number": ("table", ".dat", 1, _by_number, True, False),
    "short names of date and time": ("table", ".csv", 1, _short_names, True, False),
    "ODF": ("table", ".odf", 1, _odf, True, False),
    "year and day of the year": ("table", ".csv", 1, _day_of_year, True, False),
    "matplotlib": ("table", ".csv", 1, _matplotlib, True, False),
    "names that repeat": ("table", ".csv", 1, _twice, True, True),
    "header line and comments": ("table", ".csv", 1, _header_line, True, False),
    "units in a comment": ("table", ".csv", 1, _units_in_comment, True, False),
    "day first and flags": ("table", ".txt", 1, _day_first, True, True),
    "quoted": ("table", ".csv", 1, _quoted, True, False),
    "odv": ("odv", ".txt", 1, _odv, True, True),
    "odv by Julian days": ("odv", ".txt", 1, partial(_odv, julian=True), True, True),
    "WinADCP": ("mat", ".mat", 5, _winadcp, True, False),
    "rdradcp": ("mat", ".mat", 5, _rdradcp, True, False),
    "arrays by columns": ("mat", ".mat", 4, _named_arrays, True, False),
    "Aquadopp": ("nortek", ".hdr", 1, partial(_conversion, profiler=False), True, False),
    "Aquadopp profiler": ("nortek", ".hdr", 6, partial(_conversion, profiler=True), True, False),
    "OceanContour": ("ocean_contour", ".nc", 3, _contour, True, False),
    "speed and direction": ("netcdf", ".nc", 1, _polar, False, False),
}
