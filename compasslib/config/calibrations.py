"""Schema of config/calibrations/NAME.yaml: the keys common to all kinds, then those of each kind.

A new kind needs a class with its keys and an entry in ``MODELS``.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from compasslib.config import values
from compasslib.config.schema import CENTURY_S, FILES_WORDS, TIME_WORDS, TableKeys
from compasslib.config.section import Section, key
from compasslib.config.values import problem, shown
from compasslib.readers import TABLE_KEYS

BETWEEN = ("compare_with", "compass", "sphere")  # keys that relate a calibration to others, not settings of its kind
SINGLE_COMPASS_KINDS = ("platform", "swing", "magnetometer")  # kinds that determine the iron of one compass


TABLE_IS_CSV = BeforeValidator(lambda value: "csv" if value == "table" else value)
Angle = Annotated[values.Number, Field(ge=-360, le=360)]
Pair = Annotated[tuple[Angle, Angle], values.listed(float, 2)]
Direction = Literal["up", "down"]
Orientations = Annotated[tuple[Direction, Direction], values.listed(Direction, 2)]
# Headers of tables by role, needed only where they differ from the role; config/README.md has the units.
PlatformColumns = dict[Literal["reference_deg", "recorded_deg"], values.Column]
TiltColumns = dict[Literal["reference_tilt_deg", "recorded_pitch_deg", "recorded_roll_deg"], values.Column]
SwingColumns = dict[
    Literal["compass_deg", "cog_deg", "true_deg", "speed_kn", "time_utc", "date", "clock"], values.Column
]
MagnetometerColumns = dict[
    Literal["x", "y", "z", "pitch_deg", "roll_deg", "heading_deg", "time_utc", "date", "clock", "temperature_c"],
    values.Column,
]
# Contributions to the uncertainty budgets of platform and tilt, defined in ``calibrations.result.ROWS``.
Uncertainty = dict[
    Literal[
        "graduation_deg", "slope_deg", "ruggedness_deg", "protractor_deg", "field_deg", "declination_deg",
        "homogeneity_deg", "maker_accuracy_deg",
    ],
    Annotated[values.Number, Field(ge=0, le=180)],
]  # fmt: skip
_BUDGET = "a mapping of contributions to degrees from 0 to 180"
NearObject = dict[Literal["distance_m", "size_m"], Annotated[values.Number, Field(gt=0, le=100)]]


class KindKey(Section):
    """The key ``kind``, which determines the other keys."""

    kind: Literal["platform", "tilt", "swing", "magnetometer", "declination", "two_heads"] = key(
        "platform, tilt, swing, magnetometer, declination or two_heads", "platform"
    )


class CalibrationFile(KindKey):
    """config/calibrations/NAME.yaml: the keys common to all kinds."""

    files: values.Files = key(FILES_WORDS, "raw/cal/aqd.csv", alias="file")
    declination: values.Declination = key("auto, or degrees east from -180 to 180", "auto", "auto")
    latitude: values.Number | None = key("a number", "48.4", None, values.SWAPPED, ge=-90, le=90)
    longitude: values.Number | None = key("a number", "-4.5", None, values.SWAPPED, ge=-180, le=360)
    date_s: values.Time | None = key(TIME_WORDS, "2022-09-29", None, alias="date")
    withhold: tuple[values.Text, ...] = key("a list of column names", "[heading_deg]", ())
    table_step_deg: Literal[10, 15] = key("10 or 15", "10", 10)
    parts: tuple[values.Text, ...] = key("a list of parts near the compass", "[lithium pack, frame]", ())
    compare_with: values.Names = key("the NAME of another calibration, or a list of names", "before", ())
    compass: values.Name | None = key("a name that all records of one compass carry", "wh8104", None)
    sphere: values.Name | None = key("a name that all records in one sphere or frame carry", "sphere3", None)

    @property
    def raw_files(self) -> tuple[str, ...]:
        """All files that the calibration is made from."""
        return (*self.files, *getattr(self, "spun", ()))

    @property
    def placed(self) -> bool:
        """Whether place and date are given: the transfer to a mooring requires the earth's field at the calibration."""
        return None not in (self.latitude, self.longitude, self.date_s)

    @model_validator(mode="after")
    def _place_and_compass_go_together(self) -> Self:
        for name in ("compass", "sphere"):
            if getattr(self, name) is not None and self.kind not in SINGLE_COMPASS_KINDS:
                kinds = f"{', '.join(SINGLE_COMPASS_KINDS[:-1])} or {SINGLE_COMPASS_KINDS[-1]}"
                expected = f"this key only with kind {kinds}"
                raise problem(name, expected, f"it with kind {self.kind}", "delete it")
        if self.compass is not None and not self.placed:
            expected = f"latitude, longitude and date beside compass: {self.compass}, to carry its iron elsewhere"
            raise problem("compass", expected, "none", "add them")
        for first, other in (("latitude", "longitude"), ("longitude", "latitude")):
            if getattr(self, first) is None and getattr(self, other) is not None:
                raise problem(first, f"{first} beside {other}", "nothing", f"add {first} or delete {other}")
        return self


class TableFile(CalibrationFile, TableKeys):
    """A calibration whose readings may be given as a text table."""

    @model_validator(mode="after")
    def _keys_of_tables(self) -> Self:
        form = getattr(self, "format", "csv")
        if form != "csv" and (given := [key for key in TABLE_KEYS if key in self.model_fields_set]):
            raise problem(given[0], "this key only with format csv", f"it with format {form}", "delete it")
        return self


class Platform(TableFile):
    """A compass on a bench with known directions."""

    format: Annotated[Literal["csv"], TABLE_IS_CSV] = key("csv", "csv", "csv")
    columns: PlatformColumns = key("a mapping of roles to headers", "{reference_deg: bench, recorded_deg: heading}", {})
    spun: values.Files = key(FILES_WORDS, "raw/cal/spun.csv", ())
    object: NearObject | None = key(
        "distance_m and size_m, metres from 0 to 100", "{distance_m: 0.6, size_m: 0.2}", None, min_length=2
    )
    budget: Literal["le_menn"] | None = key("le_menn", "le_menn", None)
    uncertainty: Uncertainty = key(_BUDGET, "{graduation_deg: 0.26}", {})

    @model_validator(mode="after")
    def _readings_are_apart(self) -> Self:
        if not {*self.files} - {*self.spun}:
            raise problem("file", "another file than spun", shown(self.files[0]), "correct one")
        return self


class TiltFile(TableFile):
    """A tilt sensor on a tilted platform."""

    format: Annotated[Literal["csv"], TABLE_IS_CSV] = key("csv", "csv", "csv")
    columns: TiltColumns = key("a mapping of roles to headers", "{reference_tilt_deg: protractor}", {})
    budget: Literal["le_menn"] | None = key("le_menn", "le_menn", None)
    uncertainty: Uncertainty = key(_BUDGET, "{protractor_deg: 0.12}", {})


class VisualMark(Section):
    """A compass heading towards a mark of known true bearing."""

    compass_deg: values.Number = key("degrees", "40", ge=0, le=360)
    true_deg: values.Number = key("degrees", "42", ge=0, le=360)


class SunMark(Section):
    """A compass heading towards the sun at a given time."""

    compass_deg: values.Number = key("degrees", "40", ge=0, le=360)
    time_utc: values.Time = key("a UTC time from 1980 to 2100", "2022-09-29T09:00:00Z")


class SwingFile(TableFile):
    """A swing: a vessel turned under way, with its course by satellite navigation."""

    format: Annotated[Literal["csv", "nmea0183"], TABLE_IS_CSV] = key("csv or nmea0183", "csv", "csv")
    columns: SwingColumns = key("a mapping of roles to headers", "{compass_deg: hdg, cog_deg: cog}", {})
    talker: values.Text | None = key("the talker of the log's headings", "HC", None)
    min_speed_kn: values.Number | None = key("knots", "2", None, ge=0, le=100)
    max_turn_deg_s: values.Number | None = key("degrees a second", "1", None, gt=0, le=90)
    max_lag_s: values.Number | None = key("seconds", "10", None, ge=0, le=600)
    max_drift_kn: values.Number | None = key("knots", "1", None, ge=0, le=20)
    drift_ratio: values.Number | None = key("a number", "0.14", None, ge=0, le=1)
    declination_sigma_deg: values.Number | None = key("degrees", "0.4", None, gt=0, le=180)
    visual: tuple[VisualMark, ...] = key("a list of headings for a mark", "[{compass_deg: 40, true_deg: 42}]", ())
    sun: tuple[SunMark, ...] = key("a list of headings", "[{compass_deg: 40, time_utc: 2022-09-29T09:00Z}]", ())
    visual_sigma_deg: values.Number | None = key("degrees", "1", None, gt=0, le=180)
    course_sigma_deg: values.Number | None = key("degrees", "1", None, gt=0, le=180)
    vessel_length_m: values.Number | None = key("metres", "40", None, gt=0, le=1000)

    @property
    def placed(self) -> bool:
        """Whether place and date are given; a log in NMEA 0183 contains both."""
        return self.format == "nmea0183" or super().placed


class MagnetometerFile(TableFile):
    """A magnetometer logged while the instrument is turned."""

    format: Annotated[Literal["csv", "mmp_acm"], TABLE_IS_CSV] = key("csv or mmp_acm", "csv", "csv")
    columns: MagnetometerColumns = key("a mapping of roles to headers", "{x: mx, y: my}", {})


class DeclinationSeries(CalibrationFile):
    """An observatory's declination series, compared with the model of the earth's field."""

    format: Literal["iaga2002"] = key("iaga2002", "iaga2002", "iaga2002")


class TwoHeads(CalibrationFile):
    """Two profilers on one frame."""

    format: Literal["pd0"] = key("pd0", "pd0", "pd0")
    files: values.Files = key("two files, of heads a and b", "[a.000, b.000]", alias="file", min_length=2, max_length=2)
    start_s: values.Time | None = key(TIME_WORDS, "2022-09-29T06:00:00Z", None, alias="start")
    end_s: values.Time | None = key(TIME_WORDS, "2022-09-29T18:00:00Z", None, alias="end")
    orientation: Orientations | None = key("up or down, or a list of two of these", "[up, down]", None)
    declination_applied: Pair | None = key("degrees, or a list of two", "[0, -18.1]", None)
    heading_alignment: Pair | None = key("degrees, or a list of two", "[0, 45]", None)
    max_clock_seconds: values.Number | None = key("seconds", "600", None, ge=0, le=86400)
    clock_offset_seconds: values.Number | None = key("seconds", "0", None, ge=-CENTURY_S, le=CENTURY_S)


MODELS: dict[str, type[CalibrationFile]] = {
    "platform": Platform,
    "tilt": TiltFile,
    "swing": SwingFile,
    "magnetometer": MagnetometerFile,
    "declination": DeclinationSeries,
    "two_heads": TwoHeads,
}


def settings(file: CalibrationFile) -> dict[str, Any]:
    """Collect the settings of a kind: all keys except files and links to others; those of tables only if given."""
    unset = {key for key in TABLE_KEYS if key not in file.model_fields_set}
    return file.model_dump(mode="json", exclude={"kind", "files", *BETWEEN} | unset)
