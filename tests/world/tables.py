"""Tables as users have them: one data set in many formats, by name or drawn by seed, read as each kind of table."""

import gzip
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from compasslib import readers
from compasslib.calibrations.magnetometer import log
from compasslib.errors import InputError
from compasslib.readers import table

N, STEP_S, START = 60, 10800, datetime(2012, 3, 8, tzinfo=UTC)
MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
DATENUM_OF_1970, EXCEL_OF_1970, DAY_S = 719529.0, 25569.0, 86400.0


def _year(t: datetime) -> str:
    begin, end = (datetime(t.year + k, 1, 1, tzinfo=UTC) for k in (0, 1))
    return f"{t.year + (t - begin) / (end - begin):.9f}"


# Formats of a time; those that give two texts use two columns.
TIMES: dict[str, Callable[[datetime], str | tuple[str, str]]] = {
    "iso": lambda t: f"{t:%Y-%m-%d %H:%M:%S}",
    "iso_z": lambda t: f"{t:%Y-%m-%dT%H:%M:%SZ}",
    "offset": lambda t: f"{t + timedelta(hours=2):%Y-%m-%dT%H:%M:%S}+02:00",
    "slashes": lambda t: f"{t:%Y/%m/%d %H:%M}",
    "compact": lambda t: f"{t:%Y%m%dT%H%M%S}",
    "day_first": lambda t: f"{t:%d/%m/%Y %H:%M:%S}",
    "day_first_dots": lambda t: f"{t:%d.%m.%Y %H:%M}",
    "month_first": lambda t: f"{t:%m/%d/%Y %H:%M:%S}",
    "month_first_pm": lambda t: f"{t:%m/%d/%Y %I:%M:%S %p}",
    "month_name": lambda t: f"{t:%d}-{MONTHS[t.month - 1]}-{t:%Y %H:%M:%S}",
    "apart": lambda t: (f"{t:%Y-%m-%d}", f"{t:%H:%M:%S}"),
    "apart_day_first": lambda t: (f"{t:%d/%m/%Y}", f"{t:%H:%M}"),
    "datenum": lambda t: f"{t.timestamp() / DAY_S + DATENUM_OF_1970:.8f}",
    "excel": lambda t: f"{t.timestamp() / DAY_S + EXCEL_OF_1970:.8f}",
    "epoch": lambda t: f"{t.timestamp():.0f}",
    "epoch_ms": lambda t: f"{1000 * t.timestamp():.0f}",
    "decimal_year": _year,
}
DAY_OR_MONTH = ("day_first", "day_first_dots", "month_first", "month_first_pm", "apart_day_first")
SURE_S = 2.0  # tolerance of the times read; all true times are whole minutes


@dataclass(frozen=True)
class Form:
    """Format of a table."""

    time: str = "iso"
    delimiter: str = ","
    decimal: str = "."
    preamble: int = 0
    units: bool = False
    comments: bool = False
    fill: str = ""
    encoding: str = "utf-8"
    packed: bool = False
    ending: str = "\n"
    quoted: bool = False
    few_days: bool = False  # all days of the month are below 13
    keys: tuple[tuple[str, object], ...] = ()  # reader's settings in the YAML file


@dataclass(frozen=True)
class Truth:
    """True values of a table."""

    time_s: np.ndarray
    east: np.ndarray
    north: np.ndarray


VARIANTS: dict[str, Form] = {
    **{name: Form(time=name) for name in TIMES},
    "semicolon": Form(delimiter=";"),
    "tab": Form(delimiter="\t"),
    "semicolon, decimal comma": Form(delimiter=";", decimal=","),
    "tab, decimal comma, day first": Form(delimiter="\t", decimal=",", time="day_first_dots"),
    "preamble": Form(preamble=4),
    "unit row": Form(units=True),
    "preamble and unit row": Form(preamble=3, units=True, delimiter=";"),
    "comments": Form(comments=True),
    "gz": Form(packed=True),
    "UTF-16": Form(encoding="utf-16"),
    "Windows-1252": Form(encoding="cp1252", units=True),
    "byte order mark": Form(encoding="utf-8-sig"),
    "CRLF": Form(ending="\r\n"),
    "carriage returns alone": Form(ending="\r"),
    "another character": Form(delimiter="|", keys=(("delimiter", "|"),)),
    "quoted": Form(quoted=True),
    "quoted decimal comma": Form(quoted=True, decimal=",", delimiter=";"),
    "fill NaN": Form(fill="NaN"),
    "fill -999 named": Form(fill="-999", keys=(("missing", ("-999",)),)),
    "fill word named": Form(fill="bad", keys=(("missing", ("bad",)),)),
    "rows skipped": Form(preamble=5, keys=(("skip_rows", 5),)),
    "ambiguous day and month": Form(time="day_first", few_days=True),
    "excel, settled": Form(time="excel", keys=(("time_format", "excel"),)),
    "decimal comma beside comma": Form(decimal=","),
    "ambiguous, settled": Form(time="day_first", few_days=True, keys=(("time_format", "%d/%m/%Y %H:%M:%S"),)),
}


def drawn(seed: int, n: int) -> dict[str, Form]:
    """Draw n formats by seed."""
    rng, forms = np.random.default_rng(seed), dict[str, Form]()
    for k in range(n):
        delimiter = str(rng.choice([",", ";", "\t"]))
        forms[f"drawn {k}"] = Form(
            time=str(rng.choice(list(TIMES))),
            delimiter=delimiter,
            decimal="." if delimiter == "," else str(rng.choice([".", ","])),
            preamble=int(rng.integers(0, 5)),
            units=bool(rng.random() < 0.4),
            comments=bool(rng.random() < 0.3),
            fill=str(rng.choice(["", "NaN", "NA", "null"])),
            encoding=str(rng.choice(["utf-8", "utf-16", "cp1252", "utf-8-sig"])),
            packed=bool(rng.random() < 0.2),
            ending=str(rng.choice(["\n", "\r\n"])),
            quoted=bool(rng.random() < 0.2),
            few_days=bool(rng.random() < 0.2),
        )
    return forms


def settled_by(form: Form) -> str:
    """Name the key without which a table is ambiguous: order of day and month, epoch or delimiter; empty if none."""
    if form.keys:
        return ""
    if form.time == "excel" or (form.few_days and form.time in DAY_OR_MONTH):
        return "time_format"
    return "correct delimiter" if form.decimal == form.delimiter else ""


# Kinds of tables: currents, currents in the instrument's frame, a covariate, a log of a magnetometer calibration.
KINDS: dict[str, dict[str, object]] = {
    "table": {"east": "U", "north": "V", "depth": "Tiefe", "scale": 0.01},
    "acm_table": {"x": "U", "y": "V", "heading": "Tiefe", "scale": 0.01},
    "covariate": {"value": "U"},
    "calibration": {"x": "U", "y": "V"},
}


def outcome(path: Path, form: Form, kind: str = "table") -> str:
    """Write a table and read it as one kind; get ``right``, ``WRONG``, or ``refused: `` and the reader's message."""
    truth, settings = write(path, form)
    columns = {**settings["columns"], **KINDS[kind]}  # type: ignore[dict-item]
    try:
        found = _read(path, kind, settings | {"columns": columns})
    except InputError as error:
        return f"refused: {str(error).removeprefix(str(path))}"
    known = _as(kind, truth)
    same = len(found.time_s) == len(known.time_s) and np.abs(found.time_s - known.time_s).max() < SURE_S
    pairs = ((found.east, known.east), (found.north, known.north))
    right = same and all(np.allclose(one, other, rtol=0.0, atol=1e-9, equal_nan=True) for one, other in pairs)
    return "right" if right else "WRONG"


def _read(path: Path, kind: str, settings: dict[str, object]) -> Truth:
    if kind == "covariate":
        time_s, value, _ = table.read_series({"files": [path], **settings})
        return Truth(time_s, value, value)
    if kind == "calibration":
        columns = dict(settings["columns"])  # type: ignore[call-overload]
        if "time" in columns:
            columns["time_utc"] = columns.pop("time")
        logged = log.read([path], settings | {"columns": columns})
        return Truth(logged.time_s, *logged.raw[:, :2].T)
    record = readers.read(kind, [path], settings)
    return Truth(record.time_s, record.east[:, 0], record.north[:, 0])


def _as(kind: str, truth: Truth) -> Truth:
    """Convert true values to those of a kind; x is forward along the heading of 12.5 degrees, y to port."""
    if kind == "table":
        return truth
    if kind == "acm_table":
        sin, cos = np.sin(np.deg2rad(12.5)), np.cos(np.deg2rad(12.5))
        x, y = truth.east, truth.north
        return Truth(truth.time_s, x * sin - y * cos, x * cos + y * sin)
    known = np.isfinite(truth.east)
    u, v = 100.0 * truth.east[known], 100.0 * truth.north[known]
    return Truth(truth.time_s[known], u, u if kind == "covariate" else v)


def write(path: Path, form: Form) -> tuple[Truth, dict[str, object]]:
    """Write the table; get its true values and the reader's settings, with only the time columns."""
    rng = np.random.default_rng(5)
    times = [START + timedelta(seconds=(1800 if form.few_days else STEP_S) * k) for k in range(N)]
    east, north = np.round(rng.normal(0.0, 20.0, (2, N)), 2)
    east[[7, 23]] = north[[7, 23]] = np.nan
    apart = isinstance(TIMES[form.time](times[0]), tuple)
    clock = {"date": "Datum", "clock": "Uhr"} if apart else {"time": "Zeit"}
    rows = [[*clock.values(), "U", "V", "Tiefe"]]
    rows += [[*["UTC"] * len(clock), "cm/s", "cm/s", "m"]] * form.units
    for t, *flow in zip(times, east, north, strict=True):
        cells = TIMES[form.time](t)
        texts = [cells] if isinstance(cells, str) else [*cells]
        if form.time in ("datenum", "excel", "decimal_year"):
            texts = [text.replace(".", form.decimal) for text in texts]
        numbers = [form.fill if np.isnan(x) else f"{x:.2f}".replace(".", form.decimal) for x in flow]
        rows.append([*texts, *numbers, f"12{form.decimal}5"])
    mark = '"' if form.quoted else ""
    lines = [form.delimiter.join(f"{mark}{cell}{mark}" for cell in row) for row in rows]
    above = [f"Current meter {k}: Gerät of the cruise" for k in range(form.preamble)]
    text = form.ending.join([*above, *["# exported by a program"] * form.comments, *lines, ""])
    data = text.encode(form.encoding)
    path.write_bytes(gzip.compress(data) if form.packed else data)
    time_s = np.array([t.timestamp() for t in times])
    return Truth(time_s, 0.01 * east, 0.01 * north), {"columns": clock, **dict(form.keys)}
