"""Random netCDF layouts: forms, vocabularies and dimensions of flags, units and offsets of times, packing, order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import readers
from compasslib.errors import InputError
from compasslib.records import Record

Values = NDArray[Any]
Generator = np.random.Generator
Kinds = Mapping[str, str]  # the option drawn of each choice

# Value, word and OceanSITES flag of each vocabulary, by hand from their documents; 3 if the meaning is unknown.
MANUAL_14 = "0 unknown 0,1 good_data 1,2 probably_good_data 2,3 potentially_correctable_bad_data 3,4 bad_data 4"
IODE = (
    "0 No_QC_performed 0,1 Good_data 1,2 Probably_good_data 2,3 Bad_data_that_are_potentially_correctable 3,"
    "4 Bad_data 4"
)
MANUAL_12 = IODE.lower()
L20 = (
    "0 no_quality_control 0,1 good_value 1,2 probably_good_value 2,3 probably_bad_value 3,4 bad_value 4,"
    "5 changed_value 2,6 value_below_detection 3,7 value_in_excess 3,8 interpolated_value 2,"
    "A value_phenomenon_uncertain 3"
)
VOCABULARIES = {
    "OceanSITES 1.4": f"{MANUAL_14},7 nominal_value 2,8 interpolated_value 2",
    "OceanSITES 1.2": f"{MANUAL_12},5 value_changed 2,7 nominal_value 2,8 interpolated_value 2",
    "IMOS": f"{IODE},5 Value_changed 2,8 Interpolated_values 2",
    "Argo": f"{IODE},5 Value_changed 2,8 Estimated_value 2",
    "SeaDataNet": L20,
    "QARTOD": "1 PASS 1,2 NOT_EVALUATED 0,3 SUSPECT 3,4 FAIL 4",
    "QARTOD long": "1 pass 1,2 not_evaluated 0,3 suspect_or_of_high_interest 3,4 fail 4",
    "WOCE": "1 not_calibrated 0,2 acceptable_measurement 1,3 questionable_measurement 3,4 bad_measurement 4",
    "own words": "0 raw 3,1 good 1,2 low_percent_good 3,3 side_lobe 3,4 compass_error 3,5 not_bad 3",
    "own words and key": "0 raw 0,1 accepted 1,2 low_percent_good 4,3 side_lobe 4,4 bad 4",
}
OWN_KEY = {"good": ["accepted"], "bad": ["low_percent_good", "Side-Lobe"], "unchecked": ["raw"]}
ORDER = [1, 2, 0, 3, 4, 9]  # from best to worst
FORMS = ("values", "values in text", "characters", "codes of characters", "masks", "masks and values", "unstated")
SHARED = "one of both"
PLACES = ("time, bin", "bin, time", "time", "bin", "none", "time, beam", "time, bin, station", SHARED)
PACKINGS = ("float32", "float64", "int16", "int16 and valid range", "int32")
DATES = ((1992, 10, 8, "1992-10-8"), (1950, 1, 1, "1950-01-01"), (1970, 1, 1, "1970-1-1"), (2000, 2, 29, "20000229"))
CLOCKS = (
    *((0.0, ""), (45000.0, " 12:30"), (21600.0, "T06:00:00")),
    *((54942.5, " 15:15:42.5"), (0.0, " 0:0:0"), (7200.0, " 2")),
)
ZONES = (
    *((0, ""), (0, "Z"), (0, " UTC"), (0, " +00:00"), (-360, " -6:00"), (330, " +5:30"), (330, " +0530")),
    *((-180, "-03"), (0, " 0:00"), (-360, " -600"), (60, " 1:00"), (0, " gmt")),
)
UNITS = {"days": 86400.0, "d": 86400.0, "hours": 3600.0, "hrs": 3600.0, "minutes": 60.0, "Seconds": 1.0, "ms": 1e-3}
NAMES = (("UCUR", "VCUR"), ("EWCT", "NSCT"), ("u_1205", "v_1206"), ("u", "v"), ("along", "across"))


@dataclass(frozen=True)
class Drawn:
    """Content of a file as drawn."""

    kinds: Kinds
    settings: Mapping[str, Any]  # for the reader
    time_s: Values
    range_m: Values  # nearest first
    east: Values  # (n, m), NaN where missing
    north: Values
    flags: Values  # (n, m) OceanSITES
    unknown: frozenset[str]  # meanings that the reader must report as unknown


def draw(path: Path, rng: Generator) -> Drawn:
    """Draw one layout, write it, and return its content."""
    n, m = int(rng.integers(8, 40)), int(rng.integers(2, 9))
    one_of = {"form": FORMS, "vocabulary": list(VOCABULARIES), "flags along": PLACES, "packing": PACKINGS}
    kinds = {name: str(rng.choice(choices)) for name, choices in one_of.items()}
    kinds |= {"order": str(rng.choice(["time, bin", "bin, time"])), "bins": str(rng.choice(["outwards", "inwards"]))}
    if kinds["form"] == "unstated" and kinds["vocabulary"].startswith("own"):
        kinds["form"] = "values"
    if kinds["form"] == "codes of characters":
        kinds["vocabulary"] = "SeaDataNet"
    if kinds["vocabulary"] == "SeaDataNet" and kinds["form"] in ("values", "values in text"):
        kinds["form"] = "characters"
    names = NAMES[rng.integers(len(NAMES))]
    turned = slice(None) if kinds["bins"] == "outwards" else slice(None, None, -1)
    range_m = 4.0 + 3.0 * np.arange(m)
    with netCDF4.Dataset(path, "w") as nc:
        for name, size in (("time", n), ("bin", m), ("station", 1), ("beam", 4)):
            nc.createDimension(name, size)
        time_s, kinds["time"] = _write_time(nc, rng, n)
        nc.createVariable("bindist", "f8", ("bin",))[:] = range_m[turned]
        nc["bindist"].units = "m"
        flows, flags, unknown = [], [], set[str]()
        for name, word in zip(names, ("eastward", "northward"), strict=True):
            flows.append(_write_flow(nc, rng, name, kinds, (n, m)))
            nc[name].setncatts({"units": "m s-1", "standard_name": f"{word}_sea_water_velocity"})
            nc[name].ancillary_variables = quality = f"{name}_QC" if kinds["flags along"] != SHARED else "both_flag"
            if quality not in nc.variables:
                codes, words = _write_flags(nc, rng, quality, kinds, (n, m))
                flags.append(codes)
                unknown |= words
    settings = {"columns": None, "orientation": "up", "declination_applied": None, "direction_reference": "true"}
    settings |= {"flags": OWN_KEY if kinds["vocabulary"] == "own words and key" else None}
    east, north = (flow[:, turned] for flow in flows)
    worst = np.where(np.isnan(flows[0] + flows[1]), 9, _worst(flags))[:, turned]
    return Drawn(kinds, settings, time_s, range_m, east, north, worst, frozenset(unknown))


def _worst(flags: Sequence[Values]) -> Values:
    return np.array(ORDER)[np.max([np.argsort(np.array([*ORDER, 5, 6, 7, 8]))[one] for one in flags], axis=0)]


def _write_time(nc: netCDF4.Dataset, rng: Generator, n: int) -> tuple[Values, str]:
    year, month, day, date = DATES[rng.integers(len(DATES))]
    clock_s, clock = CLOCKS[rng.integers(len(CLOCKS))]
    minutes, zone = ZONES[rng.integers(len(ZONES))] if clock else (0, "")
    if clock == " 2" and zone[:2] in (" 0", " 1"):
        minutes, zone = 0, ""  # an hour and an offset without a sign do not occur in practice
    unit = str(rng.choice(list(UNITS)))
    time_s = 1.25e9 + 600.0 * np.cumsum(rng.integers(1, 5, n))
    time = nc.createVariable("time", "f8", ("time",))
    time.standard_name = "time"
    if rng.uniform() < 0.1:
        time.setncatts({"units": "days since -4713-01-01T00:00:00Z", "calendar": "julian"})
        time[:] = time_s / 86400.0 + 2440588.0
        return time_s, "Julian, SeaDataNet"
    origin = datetime(year, month, day, tzinfo=timezone(timedelta(minutes=minutes))) + timedelta(seconds=clock_s)
    origin_s = (origin.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()
    time.units = f"{unit} since {date}{clock}{zone}"
    time[:] = (time_s - origin_s) / UNITS[unit]
    return time_s, f"offset {zone.strip()}" if minutes else "UTC"


def _write_flow(nc: netCDF4.Dataset, rng: Generator, name: str, kinds: Kinds, shape: tuple[int, int]) -> Values:
    flow = np.round(rng.normal(0.0, 0.3, shape), 3)
    flow[rng.uniform(size=shape) < 0.05] = np.nan
    form, by_time = kinds["packing"], kinds["order"] == "time, bin"
    dtype = {"float32": "f4", "float64": "f8", "int32": "i4"}.get(form, "i2")
    fill = 1e35 if dtype[0] == "f" else -9999
    along = ("time", "bin", "station") if by_time else ("bin", "station", "time")
    variable = nc.createVariable(name, dtype, along, fill_value=fill)
    variable.set_auto_maskandscale(False)
    raw = flow if dtype[0] == "f" else np.rint((flow - 0.1) / 0.001)
    if dtype[0] == "i":
        variable.setncatts({"scale_factor": 0.001, "add_offset": 0.1})
    if form == "int16 and valid range":
        variable.setncatts({"valid_range": np.array([-2000, 2000], "i2")})
        raw[0, 0] = np.nan
    beyond = 3000 if form == "int16 and valid range" else fill
    raw = np.where(np.isnan(raw), beyond, raw)
    variable[...] = (raw if by_time else raw.T).reshape(variable.shape).astype(dtype)
    flow = np.where(raw == beyond, np.nan, flow)
    return flow.astype("f4").astype("f8") if form == "float32" else flow


def _entries(kinds: Kinds) -> list[tuple[str, ...]]:
    """List value, word and OceanSITES flag of the vocabulary."""
    return [tuple(entry.split()) for entry in VOCABULARIES[kinds["vocabulary"]].split(",")]


def _write_flags(
    nc: netCDF4.Dataset, rng: Generator, quality: str, kinds: Kinds, shape: tuple[int, int]
) -> tuple[Values, set[str]]:
    """Write one variable of flags; return them by time and bin, and the words of unknown meaning."""
    named = {"none": "", SHARED: "time, bin"}.get(kinds["flags along"], kinds["flags along"])
    along, entries = tuple(filter(None, named.split(", "))), _entries(kinds)
    sizes = [nc.dimensions[dimension].size for dimension in along]
    states = rng.integers(0, len(entries), sizes)
    conditions = np.array([int(flag) for *_, flag in entries])
    if kinds["form"] in ("masks", "masks and values"):
        codes, used = _write_masks(nc, rng, quality, along, kinds)
    else:
        _write_states(nc, quality, along, states, kinds)
        codes, used = conditions[states], {entries[k][1] for k in np.unique(states)}
    known = {"good", "bad"} if kinds["vocabulary"].startswith("own") else {word for _, word, _ in entries}
    unknown = set[str]() if kinds["vocabulary"] == "own words and key" else used - known
    return _by_time_and_bin(codes, along, shape), unknown


def _by_time_and_bin(codes: Values, along: tuple[str, ...], shape: tuple[int, int]) -> Values:
    if "beam" in along:
        codes, along = _worst(list(np.moveaxis(codes, -1, 0))), ("time",)
    if "station" in along:
        codes, along = codes[..., 0], ("time", "bin")
    codes = codes.T if along == ("bin", "time") else codes[:, None] if along == ("time",) else codes
    return np.broadcast_to(codes, shape)


def _write_states(nc: netCDF4.Dataset, quality: str, along: tuple[str, ...], states: Values, kinds: Kinds) -> None:
    entries = _entries(kinds)
    labels, words = [entry[0] for entry in entries], " ".join(entry[1] for entry in entries)
    form = kinds["form"]
    if form == "characters" or (form == "unstated" and kinds["vocabulary"] == "SeaDataNet"):
        variable = nc.createVariable(quality, "S1", along)
        variable[...] = np.array(labels, dtype="S1")[states]
        listed: Any = " ".join(labels)
    else:
        numbers = np.array([ord(one) if form == "codes of characters" else int(one) for one in labels], dtype="i1")
        variable = nc.createVariable(quality, "i1", along, fill_value=numbers[-1] if form == "values" else None)
        variable.set_auto_maskandscale(False)
        variable[...] = numbers[states]
        listed = ", ".join(f"{one}b" for one in numbers) if form == "values in text" else numbers
    if form == "unstated":
        variable.conventions = f"{kinds['vocabulary'].split()[0]} reference table of flags"
    else:
        variable.setncatts({"flag_values": listed, "flag_meanings": words})


def _write_masks(
    nc: netCDF4.Dataset, rng: Generator, quality: str, along: tuple[str, ...], kinds: Kinds
) -> tuple[Values, set[str]]:
    """Write one bit per word, or two fields of three bits with one state each."""
    sizes, entries = [nc.dimensions[dimension].size for dimension in along], _entries(kinds)
    if kinds["form"] == "masks":
        masks = values = [1 << k for k in range(len(entries))]
        raw = np.bitwise_or.reduce(rng.choice(np.array(masks), (2, *sizes)))
    else:
        kept = entries[-7:]
        entries = [*kept, *kept]
        fields = rng.integers(1, len(kept) + 1, (2, *sizes))
        raw = fields[0] + 8 * fields[1]
        masks = [7 * base for base in (1, 8) for _ in kept]
        values = [base * (k + 1) for base in (1, 8) for k in range(len(kept))]
    codes, used = np.zeros(sizes, "i8"), set[str]()
    for place in np.ndindex(*sizes):
        listed = zip(masks, values, entries, strict=True)
        holding = [entry for mask, value, entry in listed if raw[place] & mask == value]
        codes[place] = max((int(flag) for *_, flag in holding), key=ORDER.index)
        used |= {word for _, word, _ in holding}
    variable = nc.createVariable(quality, "i2", along)
    variable[...] = raw.astype("i2")
    stated = {"flag_masks": np.array(masks, "i2")} | (
        {} if values is masks else {"flag_values": np.array(values, "i2")}
    )
    variable.setncatts(stated | {"flag_meanings": " ".join(entry[1] for entry in entries)})
    return codes, used


def differences(drawn: Drawn, record: Record) -> list[str]:
    """List the differences between the drawn content and that of the reader."""
    read = {"time_s": record.time_s, "east": record.east, "north": record.north, "flags": record.quality}
    read |= {"range_m": record.bin_range_m[0]}
    found = []
    for name, values in read.items():
        expected, tolerance = getattr(drawn, name), {"time_s": 1e-3, "flags": 0.0}.get(name, 1e-6)
        if values.shape != expected.shape:
            found.append(f"{name}: shape {values.shape} is not {expected.shape}")
        elif wrong := int(np.sum(~np.isclose(values, expected, rtol=0.0, atol=tolerance, equal_nan=True))):
            found.append(f"{name}: {wrong} of {values.size} values differ")
    said = " ".join(record.warnings)
    found += [f"meaning {word!r} is not named" for word in sorted(drawn.unknown) if f"{word} (" not in said]
    if not drawn.unknown and "is not known" in said:
        found.append("a meaning that is known is asked about")
    return found


def layouts(seed: int, count: int, folder: Path) -> Iterator[list[str]]:
    """Yield the differences between content and reading of each drawn layout, beginning with what was drawn."""
    for k in range(count):
        path = folder / f"{k}.nc"
        drawn = draw(path, np.random.default_rng([seed, k]))
        try:
            found = differences(drawn, readers.read("netcdf", [path], drawn.settings))
        except InputError as error:
            found = [f"refused: {error}"]
        yield [", ".join(drawn.kinds.values()), *found] if found else []
