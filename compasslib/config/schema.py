"""Schema of a cruise's YAML files: every key with its default, unit and bounds, as immutable models.

An error message shows the description of a field after the word "expected", and its example as advice.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, model_validator

from compasslib import readers
from compasslib.config import values
from compasslib.config.section import FitOptions, ProductOptions, Section, allowed_keys, auto, key
from compasslib.config.values import problem, shown
from compasslib.earthfield import parse_applied_declination
from compasslib.readers import TABLE_KEYS
from compasslib.readers.vocabulary import stated_north
from compasslib.records import iso_time

TABLES = ("table", "acm_table")
# Keys that would silently have no effect with formats whose reader does not take them.
OF_READERS = (
    *("columns", "pressure_files", "start_offset_seconds", "heading_alignment", "sound_speed", "flags"),
    *("bin_size", "first_bin", *TABLE_KEYS),
)
NEEDED = {"pd12": ("orientation", "bin_size", "first_bin")}  # not recorded in files of this format
# Names of the covariates built into the diagnosis; a series of the same name would replace them.
KNOWN_SERIES = (
    *("heading", "time", "pitch", "roll", "tilt", "depth", "separation", "speed", "temperature", "voltage"),
    *("supply_voltage", "hour", "hour_of_day", "tide", "turn_rate", "battery_number", "flow_direction"),
    *("reference_heading", "transmit_current", "heading_spread", "echo", "observatory", "declination_observatory"),
    *("horizontal_observatory", "storm_index", "field_strength", "magnetometer_x", "magnetometer_y", "magnetometer_z"),
)
# Other entries of results/, in lower case as some file systems ignore case.
RESERVED = (
    *("calibrations", "compasses", "sites", "proof", "logs", "benchmarks", "figures"),
    *("summary.csv", "report.html", "explore.html", "usable.json", "ro-crate-metadata.json"),
)
FOLDERS = ("work", "figures", "logs", "benchmarks")  # subfolders of results/NAME
COVARIATE_ADVICE = "add for example columns: {time: time_utc, value: current_mA}"
CENTURY_S = 3.2e9  # a clock that is further off was never set
DEPTH_SLACK = 1.05  # a charted water depth is rarely better than 5 %


def _known_format(value: Any) -> str:
    offered = readers.format_names()
    if value not in offered:
        expected = f"{', '.join(offered[:-1])} or {offered[-1]}"
        raise problem(expected=expected, advice=values.nearest(str(value), offered))
    return str(value)


Format = Annotated[str, BeforeValidator(_known_format, json_schema_input_type=Literal[*readers.FORMATS] | str)]
TIME_WORDS = "a date or UTC time from 1980 to 2100"
_SCALES = f"{', '.join(values.TIME_SCALES[:-1])} or {values.TIME_SCALES[-1]}"
FILES_WORDS = "a path, a list of paths or a glob, relative to the cruise folder"
_ATTRIBUTES_WORDS = "a mapping of names to texts or numbers"


def _seconds() -> Any:
    return key("seconds", "0", 0.0, ge=-CENTURY_S, le=CENTURY_S)


def _header(unit: str, example: str) -> Any:
    return key(f"the header of a column ({unit}), or its number", example, None)


TIME_HEADER = key("the header of a column (UTC), or a list of columns of its parts", "[Year, Month, Day, Hour]", None)
DATE_HEADER = key("the header of a column (the date, where the clock stands apart)", "Date", None)
CLOCK_HEADER = key("the header of a column (the time of day, where the date stands apart)", "Time", None)


class Overlap(Section):
    """Largest separations in time and depth of the measurements of a pair, and the common time grid."""

    max_minutes: values.Number = key("minutes", "20", 20.0, ge=0, le=1440)
    max_metres: values.Number = key("metres", "20", 20.0, ge=0, le=1000)
    bins: values.Count = key("a whole number", "2", 2, ge=1, le=255)
    predict: values.Switch = key("true or false", "true", True)
    grid_minutes: values.Number = key("minutes", "60", 60.0, gt=0, le=1440)
    grid_tolerance_minutes: values.Number = key("minutes", "30", 30.0, ge=0, le=1440)


class Diagnose(Section):
    """Options of the search for unmodelled effects and of their correction."""

    enabled: values.Switch = key("true or false", "true", True)
    apply: values.Switch = key("true or false", "true", True)
    min_effect_deg: values.Number = key("degrees", "0.5", 0.5, ge=0, le=180)
    prior_odds: values.Number = key("odds", "1", 1.0, gt=0, le=1000)
    surrogates: values.Count = key("a whole number", "199", 199, ge=0, le=9999)


class Quality(Section):
    """Thresholds of the quality tests of velocities; ``auto``: the maker's default for files of its format, if any."""

    absent = (None, "auto")

    percent_good: values.Number = key("percent", "25", 25.0, ge=0, le=100)
    correlation: values.Number | None = auto("counts", "64", ge=0, le=255)
    error_velocity: values.Number | None = auto("m/s", "0.2", gt=0, le=10)
    echo: values.Number | None = key("counts", "40", None, ge=0, le=255)
    echo_jump: values.Number | None = key("counts", "30", None, gt=0, le=255)
    spike: values.Number | None = key("robust standard deviations", "7", None, ge=3, le=100)
    tilt_deg: values.Number = key("degrees", "45", 45.0, gt=0, le=90)
    speed: values.Number = key("m/s", "5", 5.0, gt=0, le=20)
    side_lobe: values.Switch = key("true or false", "true", True)


class Confirmed(Section):
    """Differences that the owner of a mooring confirms to be real and not mistakes of the configuration."""

    constant: values.Switch = key("true or false", "true", False)


class Figures(Section):
    """File formats of the figures; PNG, which the report shows, is included unless the list is empty."""

    formats: values.Formats = key("a list of png and pdf", "[png, pdf]", ("png",))


class CruiseOptions(Section):
    """config/config.yaml: the options of a run."""

    moorings: values.MooringPaths = key("a folder of mooring files or a list", "config/moorings", "config/moorings")
    demonstration: values.Switch = key("true or false", "false", False)
    seed: values.Count = key("a whole number from 0 to 4294967295", "2007", 2007, ge=0, le=2**32 - 1)
    attributes: values.Attributes = key(_ATTRIBUTES_WORDS, "{institution: My Institute}", {})
    supersedes: values.Files = key("one ZIP, relative to the cruise folder", "deposits/v1.zip", (), max_length=1)
    overlap: Overlap = key("a mapping", "{max_minutes: 20}", Overlap())
    fit: FitOptions = key("a mapping", "{method: exact}", FitOptions())
    diagnose: Diagnose = key("a mapping", "{enabled: true}", Diagnose())
    product: ProductOptions = key("a mapping", "{daily: true}", ProductOptions())
    figures: Figures = key("a mapping", "{formats: [png, pdf]}", Figures())
    quality: Quality = key("a mapping", "{correlation: 64}", Quality())

    @model_validator(mode="after")
    def _calibrations_belong_to_moorings(self) -> Self:
        if self.fit.method not in ("exact", "von_appen"):
            advice = "write it in the mooring's own file"
            raise problem("fit.method", "exact or von_appen for a whole cruise", shown(self.fit.method), advice)
        return self


class Exclusion(Section):
    """A window of known-bad data."""

    from_s: values.Time = key(TIME_WORDS, "2007-10-01T00:00:00Z", alias="from")
    to_s: values.Time = key(TIME_WORDS, "2007-10-02T00:00:00Z", alias="to")
    why: values.Text = key("a text that gives the reason", "fouled rotor", "")

    @model_validator(mode="after")
    def _from_before_to(self) -> Self:
        if self.from_s >= self.to_s:
            expected = f"a time after from, {iso_time(self.from_s)}"
            raise problem("to", expected, iso_time(self.to_s), "correct one of the two")
        return self


class HandFlag(Exclusion):
    """A quality flag that a person gives to velocities of a window and of depths."""

    why: values.Text = key("a text that gives the reason", "fouled by a fishing line")
    who: values.Text = key("the name of the person", "A. Person")
    flag: values.Count = key("a flag", "3", ge=1, le=4)
    depths: values.Depths | None = key("a range [from, to] of depths, metres", "[20, 60]", None)

    def __str__(self) -> str:
        where = "all depths" if self.depths is None else f"{self.depths[0]:g} to {self.depths[1]:g} m"
        when = f"from {iso_time(self.from_s)} to {iso_time(self.to_s)}"
        return f"flag {self.flag} {when}, {where}, by {self.who}: {self.why}"


class Columns(Section):
    """Headers of the columns of a table, by role, and the factor that converts its speeds to m/s."""

    time: values.TimeColumns | None = TIME_HEADER
    date: values.Column | None = DATE_HEADER
    clock: values.Column | None = CLOCK_HEADER
    depth: values.Column | None = _header("metres", "depth_m")
    pressure: values.Column | None = _header("dbar", "pressure_dbar")
    east: values.Column | None = _header("speed", "u_cm_s")
    north: values.Column | None = _header("speed", "v_cm_s")
    speed: values.Column | None = _header("speed", "speed_cm_s")
    direction: values.Column | None = _header("degrees, towards", "direction_deg")
    x: values.Column | None = _header("speed along the instrument's x axis", "vx_cm_s")
    y: values.Column | None = _header("speed along the instrument's y axis", "vy_cm_s")
    heading: values.Column | None = _header("degrees", "heading_deg")
    tilt_x: values.Column | None = _header("degrees", "tilt_x_deg")
    tilt_y: values.Column | None = _header("degrees", "tilt_y_deg")
    temperature: values.Column | None = _header("degrees Celsius", "temperature_c")
    flag: values.Column | None = _header("quality flags, tables only", "qc")
    range: values.Column | None = _header("metres from the transducer, netcdf only", "bindist")
    scale: values.Number | None = key("a factor to m/s", "0.01", None, gt=0, le=1000)

    def headers(self) -> dict[str, Any]:
        """Select the headers or numbers of columns that are given, by role."""
        return {role: header for role, header in self if header is not None and role != "scale"}

    @model_validator(mode="after")
    def _no_header_twice(self) -> Self:  # a component given twice would turn all currents, within their flags
        role_of: dict[str | int, str] = {}
        for role, given in self.headers().items():
            for header in given if isinstance(given, tuple) else (given,):
                if header in role_of:
                    actual = f"{shown(header)}, which {role_of[header]} has already"
                    raise problem(role, "a column of its own", actual, "correct one of the two")
                role_of[header] = role
        return self


class TableKeys(Section):
    """Format of a text table; whatever is unambiguous is detected automatically."""

    delimiter: values.Delimiter | None = key("comma, semicolon, tab or blank", "semicolon", None)
    decimal: values.Decimal | None = key("point or comma", "comma", None)
    time_format: values.TimeFormat | None = key(f"a strptime format, or {_SCALES}", "'%d/%m/%Y %H:%M'", None)
    timezone: values.Zone | None = key("UTC or an offset such as '+02:00'", "'+02:00'", None)
    missing: values.Missing = key("a list of numbers or texts that stand for nothing", "[-99.9, ----]", ())
    skip_rows: values.Count | None = key("a number of lines above the header", "3", None, ge=0, le=100000)
    header: values.Count | None = key("the line of the header (0 for none)", "0", None, ge=0, le=1000)
    comment: values.Text | None = key("the mark at the beginning of lines without data", "'#'", None)


class Instrument(TableKeys):
    """One instrument of a mooring and its raw files."""

    format: Format = key("the name of a raw format", "pd0")
    files: values.Files = key(FILES_WORDS, "raw/EG4/top.000")
    depth: values.Number | None = key("metres", "100", None, ge=0, le=12000)
    orientation: Literal["up", "down"] | None = key("up or down", "up", None)
    declination_applied: values.DeclinationApplied | None = key(
        "degrees from -180 to 180, or these as {heading: ..., velocity: ...}", "0", None
    )
    heading_alignment: values.Number | None = key("degrees", "0", None, ge=-360, le=360)
    sound_speed: values.SoundSpeed = key("auto, keep, or {salinity: 0 to 42}", "{salinity: 35}", "auto")
    clock_offset_seconds: values.Number = _seconds()
    clock_drift_seconds: values.Number = _seconds()
    pressure_offset: values.Number = key("dbar", "0", 0.0, ge=-12000, le=12000)
    direction_reference: values.Reference = key("magnetic or true", "magnetic", "magnetic")
    exclude: tuple[Exclusion, ...] = key("a list of windows", "[{from: 2007-10-01, to: 2007-10-02, why: fouled}]", ())
    flags_by_hand: tuple[HandFlag, ...] = key(
        "a list of flags", "[{from: 2007-10-01, to: 2007-10-02, flag: 3, who: A. Person, why: fouled}]", ()
    )
    depth_from: values.Name | None = key("the name of another instrument of this mooring", "microcat", None)
    compass: values.Name | None = key("a name that all records of one compass carry", "wh8104", None)
    sphere: values.Sphere | None = key("true, or a name that all records in one sphere or frame carry", "sphere3", None)
    compass_sigma_deg: values.Number | None = key("degrees", "2", None, ge=0, le=180)
    compass_iron_nT: values.Number | None = key("nT", "525", None, ge=0, le=60000)
    kind: Literal["rotor"] | None = key("rotor", "rotor", None)
    parts: tuple[values.Text, ...] = key("a list of parts near the compass", "[lithium pack, frame]", ())
    sphere_distance_m: values.Span | None = key("a distance in metres, or [from, to]", "[0.4, 0.6]", None)
    fit: FitOptions | None = key("a mapping", "{method: exact}", None)
    attributes: values.Attributes = key(_ATTRIBUTES_WORDS, "{serial_number: 1234}", {})
    columns: Columns | None = key("a mapping", "{time: time_utc, east: u_m_s, north: v_m_s}", None)
    pressure_files: values.Files = key(FILES_WORDS, "raw/EG4/C*.TXT", ())
    start_offset_seconds: values.Number = _seconds()
    bin_size: values.Number | None = key("metres", "16", None, gt=0, le=100)
    first_bin: values.Number | None = key("metres", "24.7", None, gt=0, le=1000)
    # Meanings of the quality flags of a file that uses no known vocabulary.
    flags: dict[Literal["good", "bad", "unchecked"], values.Missing] | None = key(
        "a mapping to lists of meanings or values", "{good: [accepted], bad: [side_lobe, 4]}", None
    )

    @model_validator(mode="after")
    def _check_keys_of_format(self) -> Self:
        taken = {*readers.get_format(self.format).keys, *["columns"] * (self.format == "mmp_acm")}
        if given := [name for name in OF_READERS if name in self.model_fields_set and name not in taken]:
            formats = " or ".join(name for name, form in readers.FORMATS.items() if given[0] in form.keys)
            actual, advice = f"it with format {self.format}", "delete it or correct the format"
            raise problem(given[0], f"this key only with format {formats}", actual, advice)
        columns = self.columns or Columns()
        arrays = self.format in ("netcdf", "ocean_contour", "mat")
        for role in ("x", "y", "flag") if arrays else ("range",):
            if getattr(columns, role):
                expected = f"this role only with {'tables' if arrays else 'formats netcdf and mat'}"
                raise problem(f"columns.{role}", expected, f"it with format {self.format}", "delete it")
        inside = parse_applied_declination(self.declination_applied)
        if inside is not None and inside.differs and (self.format == "mmp_acm" or columns.x):
            expected = "one number, as these velocities are turned by the headings"
            raise problem("declination_applied", expected, f"{inside}", f"write {inside.heading:g}")
        if absent := [name for name in NEEDED.get(self.format, ()) if getattr(self, name) is None]:
            field = allowed_keys(type(self))[absent[0]]
            expected = f"{field.description}, which {self.format} does not tell"
            raise problem(absent[0], expected, "nothing", f"add for example {absent[0]}: {field.examples[0]}")
        if self.format in TABLES:
            headers = columns.headers()
            values.check_table(headers, self.depth)
            if "direction_reference" not in self.model_fields_set:  # what the headers say stands for the key
                north = stated_north({role: [str(header)] for role, header in headers.items()})
                object.__setattr__(self, "direction_reference", north or self.direction_reference)
        return self


class CovariateColumns(Section):
    """Headers of the table of a covariate."""

    time: values.TimeColumns | None = TIME_HEADER
    date: values.Column | None = DATE_HEADER
    clock: values.Column | None = CLOCK_HEADER
    value: values.Column = key("the header of the column that holds the series", "current_mA")


class Covariate(TableKeys):
    """Covariate for the search for unmodelled effects: an observatory's series, or any column of a table."""

    format: Literal["iaga2002", "table"] = key("iaga2002 or table", "iaga2002")
    files: values.Files = key(FILES_WORDS, "raw/obs/*.min")
    columns: CovariateColumns | None = key("a mapping", "{time: time_utc, value: current_mA}", None)
    unit: values.Text | None = key("a text", "mA", None)
    depth: values.Number | None = key("metres", "250", None, ge=0, le=12000)

    @model_validator(mode="after")
    def _keys_of_this_format(self) -> Self:
        if self.format == "table":
            headers = self.columns.model_dump(exclude_none=True) if self.columns else {}
            if not self.columns:
                raise problem("columns", "the headers of time and value", "nothing", COVARIATE_ADVICE)
            values.check_clock(headers)
        elif given := sorted({*TABLE_KEYS, "columns", "unit"} & self.model_fields_set):
            actual = f"it with format {self.format}"
            raise problem(given[0], "this key only with format table", actual, "delete it or correct the format")
        return self


class Mooring(Section):
    """config/moorings/NAME.yaml: one mooring."""

    name: values.Name = key(values.NAME_WORDS, "EG4")
    latitude: values.Number = key("a number", "65.3333", ..., values.SWAPPED, ge=-90, le=90)
    longitude: values.Number = key("a number", "-32.9550", ..., values.SWAPPED, ge=-180, le=360)
    water_depth: values.Number = key("metres", "894", gt=0, le=12000)
    start_s: values.Time = key(TIME_WORDS, "2007-09-04T00:00:00Z", alias="start")
    end_s: values.Time = key(TIME_WORDS, "2008-10-04T00:00:00Z", alias="end")
    declination: values.Declination = key("auto, or degrees east from -180 to 180", "auto", "auto")
    affected: values.Names = key("the name of the affected instrument, or a list", "top", alias="compromised")
    reference: values.Names = key("the name of the reference instrument, or a list of names", "deep", ())
    instruments: dict[values.Name, Instrument] = key("a mapping of names to instruments", "{top: {format: pd0, ...}}")
    attributes: values.Attributes = key(_ATTRIBUTES_WORDS, "{project: My Project}", {})
    site: values.Name | None = key("a name that all deployments of one site carry", "denmark_strait", None)
    fit: FitOptions = key("a mapping", "{method: exact}", FitOptions())
    diagnose: Diagnose = key("a mapping", "{apply: true}", Diagnose())
    confirmed: Confirmed = key("a mapping", "{constant: true}", Confirmed())
    product: ProductOptions = key("a mapping", "{daily: true}", ProductOptions())
    quality: Quality = key("a mapping", "{correlation: 64}", Quality())
    covariates: dict[values.Name, Covariate] = key("a mapping of names to series", "{obs: {format: iaga2002, ...}}", {})

    @property
    def compromised(self) -> str:
        """Name of the affected instrument, the first if there are several."""
        return self.affected[0]

    def split(self) -> dict[str, Mooring]:
        """Split into one mooring per affected instrument: by NAME if there is only one, else by NAME/ROLE."""
        if len(self.affected) == 1:
            return {self.name: self}
        fits = {role: self.instruments[role].fit or self.fit for role in self.affected}
        each = {role: self.model_copy(update={"affected": (role,), "fit": fit}) for role, fit in fits.items()}
        return {f"{self.name}/{role}": mooring for role, mooring in each.items()}

    @property
    def start(self) -> datetime:
        return datetime.fromtimestamp(self.start_s, UTC)

    @property
    def end(self) -> datetime:
        return datetime.fromtimestamp(self.end_s, UTC)

    @model_validator(mode="after")
    def _check_names_and_times(self) -> Self:
        if self.name.lower() in RESERVED:
            expected = f"a name other than {', '.join(RESERVED)}, which results/ holds for other things"
            raise problem("name", expected, shown(self.name), "rename the mooring")
        if self.start_s >= self.end_s:
            expected = f"a time after start, {iso_time(self.start_s)}"
            raise problem("end", expected, iso_time(self.end_s), "correct one of the two")
        grid = self.product.grid
        if self.site and not (self.product.daily and grid and grid.step_m and grid.from_m is not None):
            expected = "product: {daily: true, grid: {step_m: ..., from_m: ...}}, as deployments are joined on one axis"
            advice = "add them to config.yaml, for all deployments alike"
            raise problem("site", expected, "other keys of product", advice)
        for name, series in self.covariates.items():
            if name in KNOWN_SERIES and series.format == "table":
                expected = "for a table a name that the search does not use itself"
                raise problem(f"covariates.{name}", expected, shown(name), f"for example {name}_logged")
        return self

    @model_validator(mode="after")
    def _check_roles(self) -> Self:
        for role, names in (("compromised", self.affected), ("reference", self.reference)):
            if absent := [name for name in names if name not in self.instruments]:
                expected = f"an instrument of this mooring ({', '.join(self.instruments) or 'none'})"
                raise problem(role, expected, shown(absent[0]), "write one of these names")
            if twice := [name for name in names if names.count(name) > 1]:
                raise problem(role, "each name once", f"{shown(twice[0])} twice", "delete one of the two")
        if not self.affected:
            raise problem("compromised", "at least one name", "none", "name the affected instrument")
        if both := [name for name in self.affected if name in self.reference]:
            advice = "name the reference instrument, or delete reference where there is none"
            raise problem("reference", "another instrument than compromised", shown(both[0]), advice)
        several = self.affected if len(self.affected) > 1 else ()
        if reserved := [name for name in several if name.lower() in FOLDERS]:
            expected = f"a name other than {', '.join(FOLDERS)}, which results/{self.name} holds for other things"
            raise problem("compromised", expected, shown(reserved[0]), "rename the instrument")
        if useless := [name for name, each in self.instruments.items() if each.fit and name not in several]:
            expected, advice = "this key only where several instruments are compromised", "write fit at the top"
            raise problem(f"instruments.{useless[0]}.fit", expected, "it here", advice)
        for mooring in self.split().values():
            compass, method = mooring.instruments[mooring.compromised].compass, mooring.fit.method
            if compass is not None and method in ("calibration", "coefficients"):
                advice = f"delete fit here, and write compass: {compass} in the calibration's file"
                expected = f"another method beside compass: {compass}, by which calibrations of it come in already"
                raise problem("fit.method", expected, shown(method), advice)
        return self

    @model_validator(mode="after")
    def _check_windows_and_depths(self) -> Self:
        for name, instrument in self.instruments.items():
            place = f"instruments.{name}"
            windows = {f"exclude[{k}]": window for k, window in enumerate(instrument.exclude)}
            windows |= {f"flags_by_hand[{k}]": window for k, window in enumerate(instrument.flags_by_hand)}
            for key_, window in windows.items():
                if window.to_s < self.start_s or window.from_s > self.end_s:
                    expected = f"a window within the deployment, {iso_time(self.start_s)} to {iso_time(self.end_s)}"
                    dates, advice = f"{iso_time(window.from_s)} to {iso_time(window.to_s)}", "correct or delete it"
                    raise problem(f"{place}.{key_}", expected, dates, advice)
            if instrument.depth is not None and instrument.depth > self.water_depth * DEPTH_SLACK:
                expected = f"metres from 0 to the water depth, {self.water_depth:g}"
                raise problem(f"{place}.depth", expected, shown(instrument.depth), "correct one of the two")
            if (other := instrument.depth_from) is not None:
                others = self.instruments | self.covariates
                if other == name or other not in others or others[other].format == "iaga2002":
                    expected = "another instrument, or a table of covariates, of this mooring"
                    raise problem(f"{place}.depth_from", expected, shown(other), "correct the name")
                if unknown := [each for each in (name, other) if others[each].depth is None]:
                    expected = f"depth of {unknown[0]}, as the distance along the wire is needed"
                    raise problem(f"{place}.depth_from", expected, "none", "add it")
        return self
