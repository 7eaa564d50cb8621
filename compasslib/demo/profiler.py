"""Simulation of a McLane profiler with a Falmouth 3D-ACM, two profiles a day, and of the files of the meter.

A real profiler logs its whole profile at 2 Hz, about 600 MB per mooring and year. Here the scans are thinned to 20 MB:
one in two seconds in the uppermost 60 m, next to the bumper under the sphere, and one every 8 m down to the bottom.
While the wire leans too much, the profiler is stuck at depth for days and logs one minute of each profile there.
"""

import struct
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.demo import water as sea
from compasslib.demo.compass import Field
from compasslib.demo.water import NOMINAL_M, Motion, Water, clockwise
from compasslib.types import HOUR_S, Complexes, Floats

ROW = "   %s%9.2f%9.2f%9.2f%10.4f%10.4f%10.4f%10.2f%10.2f%10.2f%10.2f\r\n"
COLUMNS = (
    "   MM-DD-YYYY HH:MM:SS     HDNG       TX       TY        HX        HY        HZ"
    "      VPAB      VPCD      VPEF      VPGH\r\n"
)
PARTIAL_EVERY = 97  # one of this number of profiles ends in the middle of a row
FLAGS = {
    "op_flag1": " TIME HDNG",
    "op_flag2": " TX   TY   HX   HY   HZ  ",
    "op_flag4": " TILT COMP VPTH",
    "op_flag5": " ECHO LOG ",
    "op_mode": " NRML",
}

_RECORD = np.dtype([("clock", "u1", (3,)), ("month", "u1"), ("day", "u1"), ("year", "<u2"), ("values", "<f4", (10,))])


@dataclass(frozen=True)
class Acm:
    """Current meter, as described in the header of its files."""

    serial: int
    user: str
    latitude_deg: float
    longitude_deg: float
    rate_hz: float = 1.0


@dataclass(frozen=True)
class Scans:
    """Logged data: r scans in p profiles; magnetic headings in degrees, velocities along paths in cm/s."""

    number: NDArray[np.int64]  # (p,) of the profile
    size: NDArray[np.int64]  # (p,) scans in it
    on_s: NDArray[np.int64]  # (p,) switched on, UTC seconds since 1970
    off_s: NDArray[np.int64]  # (p,)
    time_s: NDArray[np.int64]  # (r,) the clock has whole seconds
    values: Floats  # (r, 10) HDNG TX TY HX HY HZ VPAB VPCD VPEF VPGH


def write_text(path: Path, acm: Acm, scans: Scans) -> None:
    """Write unpacked ASCII, space delimited, with header."""
    iso = np.datetime_as_string(scans.time_s.astype("datetime64[s]")).tolist()
    stamps, fields = [f"{text[5:10]}-{text[:4]} {text[11:]}" for text in iso], _header_fields(acm)
    header_size = struct.calcsize("<" + "".join(code for _, code, _ in fields))
    with path.open("w", newline="") as file:
        for k, number, begin, end in _profiles(scans):
            cells = np.empty((end - begin, 11), dtype=object)
            cells[:, 0], cells[:, 1:] = stamps[begin:end], scans.values[begin:end]
            # One format for a whole profile, as one call per row would take most of the run time.
            rows = (ROW * (end - begin)) % tuple(cells.ravel())
            if number % PARTIAL_EVERY == 0:
                rows = rows[:-57] + "\r\n"
            on, off = (
                np.datetime64(int(t), "s").item().strftime("%m/%d/%Y %H:%M:%S") for t in (scans.on_s[k], scans.off_s[k])
            )
            listing = [("FILELEN", "I", header_size + _RECORD.itemsize * (end - begin)), *fields]
            shown = "".join(f"{name:<12}: {_shown(name, code, value)}\r\n" for name, code, value in listing if name)
            file.write(f"Sample rate: {acm.rate_hz:.4f} Hz\r\n\r\n\r\n Profile {number}\r\n\r\n{COLUMNS}\r\n{rows}\r\n")
            file.write(f" Profile {number}\r\n  ACM turned on at {on}\r\n  ACM turned off at {off}\r\n\r\n")
            file.write(f"ACM+ Header Contents:\r\n\r\n{shown}")


def write_binary(path: Path, acm: Acm, scans: Scans) -> None:
    """Write the binary format of the logger, with all files ``A*.DAT`` concatenated."""
    year, month, day, *clock = sea.calendar(scans.time_s)
    records = np.zeros(scans.time_s.size, dtype=_RECORD)
    records["clock"] = np.stack(clock, axis=-1)
    records["month"], records["day"], records["year"], records["values"] = month, day, year, scans.values
    header = b"".join(struct.pack("<" + code, value) for _, code, value in _header_fields(acm))
    with path.open("wb") as file:
        for k, _, begin, end in _profiles(scans):
            body = header + records[begin:end].tobytes()
            file.write(struct.pack(">I", len(body)) + body + struct.pack(">II", scans.on_s[k], scans.off_s[k]))


def _profiles(scans: Scans) -> list[tuple[int, int, int, int]]:
    """List position, number, first scan and end of each profile."""
    ends = np.cumsum(scans.size)
    begins = ends - scans.size
    return list(zip(range(ends.size), scans.number.tolist(), begins.tolist(), ends.tolist(), strict=True))


def _shown(name: str, code: str, value: float | int | bytes) -> str:
    if isinstance(value, bytes):
        text = value.decode("latin-1")
        return text if text.isprintable() else value.hex(" ").upper() + " "
    if code == "B":
        return f"{value:02X} : {FLAGS.get(name, '')}"
    return f"{value:.4f}" if isinstance(value, float) else str(value)


def _header_fields(acm: Acm) -> list[tuple[str, str, float | int | bytes]]:
    """List name, struct code and value in the order of the file; 279 bytes, unnamed fields fill gaps."""
    unity = [(f"T{row}{column}", "f", 0.0002 * (row == column)) for column in (1, 2, 3) for row in (1, 2, 3)]
    zeros = ("tilt_temp0", "K9", "sal", "dbar")
    ks = (0.49, 0.30, 0.0, 0.0, 0.49, 0.30, 0.0, 0.0)
    return [
        ("cal_date", "3s", bytes((0x07, 0x06, 0x15))), ("ser_num", "H", acm.serial),
        ("mux", "H", 0), ("wdly", "H", 0), ("mux2", "H", 0), ("", "8s", b""),
        ("UserID", "32s", acm.user.encode()), ("BaudRate", "f", 19200.0), ("InitValue", "H", 1066), ("", "6s", b""),
        ("SRate", "f", acm.rate_hz), ("Latitude", "d", acm.latitude_deg), ("Longitude", "d", acm.longitude_deg),
        *[(name, "f", 0.0) for name in ("abof", "cdof", "efof", "ghof")],
        *[(name, "f", 1.0) for name in ("absl", "cdsl", "efsl", "ghsl")],
        *[(f"K{k}", "f", value) for k, value in enumerate(ks, 1)],
        *[(name, "f", 0.0) for name in zeros],
        ("seatoff", "f", -2.1), ("seatslp", "f", 0.0097), ("velscl", "f", 1.0),
        ("zhx", "f", -510.0), ("zhy", "f", 24.0), ("zhz", "f", -480.0), *unity,
        *[(name, "f", 0.0) for name in ("dex", "dey", "dez")],
        ("aux_delay", "I", 0), ("avgintv", "3s", bytes(3)), ("intv", "3s", bytes((0, 5, 0))),
        ("on", "3s", bytes((0, 0, 10))), ("dly_strt", "8s", bytes((0, 1, 10, 28, 9, 17, 4, 0))),
        ("op_flag1", "B", 0x28), ("op_flag2", "B", 0xF8), ("op_flag3", "B", 0x00), ("op_flag4", "B", 0x07),
        ("op_flag5", "B", 0x22), ("op_mode1", "B", 0x00), ("op_mode", "B", 0x10), ("version", "5s", b"v3.20"),
        ("Declination", "f", 0.0), ("checksum", "1s", bytes(1)), ("", "2s", b""), ("start", "4s", b"DATA"),
    ]  # fmt: skip


SPEED_M_S = 0.25
BUMPER_M = 2.0  # below the sphere


@dataclass(frozen=True)
class Profiler:
    """First profile, depth range and file format of a profiler."""

    first_s: float  # seconds from deployment to the first profile's start, at the bottom
    bottom_m: float
    binary: bool  # whether files are binary as logged, not unpacked to text
    serial: int


@dataclass(frozen=True)
class Plan:
    """All profiles of the deployment, (p,) each, and their r scans."""

    number: NDArray[np.int64]
    ascending: NDArray[np.bool_]
    scans: NDArray[np.int64]  # number of each profile's scans
    time_s: Floats  # (r,) of the scans
    top_s: Floats  # time at the bumper: arrival or departure
    stuck_m: Floats  # depth at which it is stuck, NaN if it moves
    bottom_m: float

    @property
    def first(self) -> NDArray[np.int64]:
        """Index of the first scan of each profile, (p,)."""
        return np.asarray(np.cumsum(self.scans) - self.scans)


def plan(rng: np.random.Generator, profiler: Profiler, motion: Motion, span_s: tuple[float, float]) -> Plan:
    """Plan the profiles: odd numbers ascend, even ones descend, and none reaches the top while it is stuck."""
    start = np.arange(span_s[0] + profiler.first_s, span_s[1] - 4 * HOUR_S, 12 * HOUR_S)
    number = np.arange(start.size) + 1
    ascending = number % 2 == 1
    way_s = (profiler.bottom_m - NOMINAL_M - BUMPER_M) / SPEED_M_S
    top = np.rint(start + np.where(ascending, way_s, 30.0))
    blown_m = np.interp(top, motion.time_s, motion.sphere_depth_m) - NOMINAL_M
    depths, depth, stuck = rng.uniform(0.45, 0.85, top.size) * profiler.bottom_m, nan, np.empty(top.size)
    for k, blown in enumerate(blown_m.tolist()):
        if isnan(depth) and blown > 100.0:
            depth = depths[k]
        elif blown < 25.0:
            depth = nan
        stuck[k] = depth
    # Ten seconds at the bumper, then a scan in 2 s in the uppermost water and in 32 s below.
    down = np.concatenate([np.arange(-10.0, 230.0, 2.0), np.arange(230.0, np.floor(way_s), 32.0)])
    parked = 120.0 + np.arange(60.0)
    times = [
        begin + parked if held else at - down[::-1] if up else at + down
        for begin, at, up, held in zip(np.rint(start), top, ascending, ~np.isnan(stuck), strict=True)
    ]
    scans = np.array([time.size for time in times])
    return Plan(number, ascending, scans, np.concatenate(times), top, stuck, profiler.bottom_m)


def log(rng: np.random.Generator, schedule: Plan, water: Water, motion: Motion, *, field: Field) -> Scans:
    """Simulate the data logged by the current meter."""
    count, first, time = schedule.number.size, schedule.first, schedule.time_s
    profile = np.repeat(np.arange(count), schedule.scans)
    sphere = np.interp(time, motion.time_s, motion.sphere_depth_m)
    depth, sinking = _position(schedule, profile, time, sphere)
    flow = sea.velocity(water, time, depth)
    flow = clockwise(flow, -field.at(time)[0])
    heading, turning = _swing(rng, flow, time, profile, first)
    compass = _compass(rng, heading, profile, field.at(time))
    paths = _paths(rng, flow, heading, sinking=sinking, turning=turning, ascending=schedule.ascending[profile])
    reading = np.column_stack([*compass, *paths])
    # The first scan after switching on is aliased.
    reading[first] += rng.normal(0.0, (30.0, 3.0, 3.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0), (count, 10))
    reading[:, 0] = angles.wrap360(np.round(reading[:, 0], 2))
    on, off = time[first] - rng.integers(5, 11, count), time[first + schedule.scans - 1] + 1.0
    return Scans(schedule.number, schedule.scans, on.astype(int), off.astype(int), time.astype(int), reading)


def write_engineering(path: Path, schedule: Plan, motion: Motion, latitude_deg: float) -> None:
    """Write the profiler's own table of time and pressure, every 10 s near the top and half a minute below."""
    ends = schedule.time_s[schedule.first], schedule.time_s[schedule.first + schedule.scans - 1]
    times = []
    for begin, end, top in zip(*ends, schedule.top_s, strict=True):
        whole = np.arange(begin - 20.0, end + 30.0, 10.0)
        times.append(whole[(np.abs(whole - top) < 300.0) | (np.arange(whole.size) % 3 == 0)])
    profile, time = np.repeat(np.arange(len(times)), [each.size for each in times]), np.concatenate(times)
    depth = _position(schedule, profile, time, np.interp(time, motion.time_s, motion.sphere_depth_m))[0]
    stamps = np.datetime_as_string(time.astype("datetime64[s]")).tolist()
    pairs = zip(stamps, sea.pressure(depth, latitude_deg).tolist(), strict=True)
    path.write_text("time_utc,pressure_dbar\n" + "".join(f"{stamp}Z,{dbar:.2f}\n" for stamp, dbar in pairs))


def _position(schedule: Plan, profile: NDArray[np.intp], time_s: Floats, sphere_m: Floats) -> tuple[Floats, Floats]:
    """Compute depth in metres and its rate of change in m/s."""
    away = np.where(schedule.ascending, -1.0, 1.0)[profile]
    since = away * (time_s - schedule.top_s[profile])
    running = np.isnan(schedule.stuck_m)[profile]
    below = sphere_m + BUMPER_M + SPEED_M_S * np.maximum(since, 0.0)
    depth = np.where(running, np.minimum(below, schedule.bottom_m), schedule.stuck_m[profile])
    return depth, np.where(running & (since > 0) & (below < schedule.bottom_m), SPEED_M_S * away, 0.0)


def _swing(
    rng: np.random.Generator, flow: Complexes, time_s: Floats, profile: NDArray[np.intp], first: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Simulate the heading, oscillating about the upstream direction, degrees, and its rate of change, rad/s."""
    parts = np.unique(np.concatenate([first, np.arange(0, flow.size, 40)]))  # stretches whose mean current it follows
    middle = np.repeat(sea.direction(np.add.reduceat(flow, parts)), np.diff(np.append(parts, flow.size)))
    middle = middle + 180.0 + rng.normal(0.0, 15.0, first.size)[profile]
    angular = 2 * np.pi / rng.uniform(60.0, 100.0, first.size)
    amplitude, start = np.abs(rng.normal(4.0, 1.5, first.size)), rng.uniform(0.0, 2 * np.pi, first.size)
    phase = angular[profile] * (time_s - time_s[first][profile]) + start[profile]
    rate = np.deg2rad(amplitude * angular)[profile] * np.cos(phase)
    return middle + amplitude[profile] * np.sin(phase), rate


def _compass(
    rng: np.random.Generator, heading_deg: Floats, profile: NDArray[np.intp], field: tuple[Floats, Floats, Floats]
) -> tuple[Floats, ...]:
    """Simulate heading, tilts (degrees) and direction cosines of the field by the logger's levelling, z upwards."""
    steady = rng.normal(0.0, 0.35, profile[-1] + 1)[profile]
    heading = angles.wrap360(heading_deg + steady + rng.normal(0.0, 0.35, profile.size))
    tilts = [
        np.round(rng.normal(mean, 0.8, profile[-1] + 1)[profile] + rng.normal(0.0, 0.4, profile.size), 2)
        for mean in (1.6, -0.9)
    ]
    (sine, cosine), (sx, cx), (sy, cy) = (angles.sin_cos(angle) for angle in (heading, *tilts))
    flat = field[1] / field[2]
    hx, hy = (flat * cosine - sx) / cx, (flat * sine - sy) / cy
    length = np.sqrt(hx**2 + hy**2 + 1.0)
    return heading, tilts[0], tilts[1], hx / length, hy / length, -1.0 / length


def _paths(
    rng: np.random.Generator,
    flow: Complexes,
    heading_deg: Floats,
    *,
    sinking: Floats,
    turning: Floats,
    ascending: NDArray[np.bool_],
) -> tuple[Floats, ...]:
    """Compute the velocities along the paths VPAB, VPCD, VPEF, VPGH, cm/s, including the motion of the meter."""
    frame = clockwise(flow, 90.0 - heading_deg)
    noise = rng.normal(0.0, 0.6, (4, heading_deg.size))
    x, y = 100 * frame.real, 100 * (frame.imag + 0.43 * turning)  # the paths are 0.43 m away from the wire
    z = 100 * sinking  # relative to a sinking meter the water rises
    upper, lower = (x + z) / np.sqrt(2), (x - z) / np.sqrt(2)
    # One of the two inclined paths lies in the wake of the strut, the upper one on the way up.
    wake = rng.normal(0.0, 2.0, heading_deg.size)
    upper = np.where(ascending, 0.6 * upper + wake, upper)
    lower = np.where(ascending, lower, 0.6 * lower + wake)
    return (y - x) / np.sqrt(2) + noise[0], upper + noise[1], (-x - y) / np.sqrt(2) + noise[2], lower + noise[3]
