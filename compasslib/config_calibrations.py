"""What may stand in config/calibrations/NAME.yaml: the keys of every kind, and below them those of each.

A key of one kind is one line in that kind's class; a new kind is a class and a line in ``MODELS``.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, model_validator

from compasslib import config_values as values
from compasslib.config_schema import Declination, Files, Name, Number, Section, Text, Time, key
from compasslib.config_values import problem, shown


def _csv(value: Any) -> Any:
    """Return the one word for comma-separated files; in a mooring file they are called table."""
    return "csv" if value == "table" else value


def _header(unit: str) -> Any:
    return key(f"the header of a column ({unit})", "heading", None)


def _row(what: str) -> Any:
    return key(f"{what}, degrees from 0 to 180", "0.26", None, ge=0, le=180)


class Kind(Section):
    """The key that says which others there are."""

    kind: Literal["platform", "swing", "magnetometer", "declination", "two_heads"] = key(
        "platform, swing, magnetometer, declination or two_heads", "platform"
    )


class CalibrationFile(Kind):
    """config/calibrations/NAME.yaml: the keys of every kind."""

    files: Files = key(
        "a path, a list of paths or a glob, relative to the cruise folder", "raw/cal/aqd.csv", alias="file"
    )
    declination: Declination = key("auto, or degrees east from -180 to 180", "auto", "auto")
    latitude: Number | None = key("a number from -90 to 90", "48.4", None, values.SWAPPED, ge=-90, le=90)
    longitude: Number | None = key("a number from -180 to 360", "-4.5", None, values.SWAPPED, ge=-180, le=360)
    date_s: Time | None = key("a date or UTC time from 1980 to 2100", "2022-09-29", None, alias="date")
    withhold: tuple[Text, ...] = key("a list of column names", "[heading_deg]", ())
    table_step_deg: Literal[10, 15] = key("10 or 15", "10", 10)
    compare_with: Name | None = key("the NAME of another file in config/calibrations", "before", None)

    @property
    def placed(self) -> bool:
        """Whether the earth's field at the calibration is known, which carries it to a mooring."""
        return None not in (self.latitude, self.longitude, self.date_s)

    @model_validator(mode="after")
    def _position_is_whole(self) -> Self:
        for one, other in (("latitude", "longitude"), ("longitude", "latitude")):
            if getattr(self, one) is None and getattr(self, other) is not None:
                raise problem(one, f"{one} beside {other}", "nothing", f"add {one} or delete {other}")
        return self


class PlatformColumns(Section):
    """Headers of a platform's table where they differ from the roles."""

    reference_deg: Text | None = _header("degrees, magnetic")
    recorded_deg: Text | None = _header("degrees, magnetic")


class Uncertainty(Section):
    """Rows of a platform's budget; what each number is stands in ``calibration.budget.ROWS``."""

    graduation_deg: Number | None = _row("a standard uncertainty")
    slope_deg: Number | None = _row("a largest error")
    ruggedness_deg: Number | None = _row("a standard uncertainty")
    protractor_deg: Number | None = _row("an expanded uncertainty")
    field_deg: Number | None = _row("a largest error")
    declination_deg: Number | None = _row("a largest error")
    homogeneity_deg: Number | None = _row("a largest error")
    maker_accuracy_deg: Number | None = _row("a maker's accuracy")


class Platform(CalibrationFile):
    """A compass on a bench whose directions are known."""

    format: Annotated[Literal["csv"], BeforeValidator(_csv)] = key("csv", "csv", "csv")
    columns: PlatformColumns = key("a mapping", "{reference_deg: bench, recorded_deg: heading}", PlatformColumns())
    budget: Literal["le_menn"] | None = key("le_menn", "le_menn", None)
    uncertainty: Uncertainty = key("a mapping", "{graduation_deg: 0.26}", Uncertainty())


class SwingColumns(Section):
    """Headers of a swing's table where they differ from the roles."""

    compass_deg: Text | None = _header("degrees, magnetic")
    cog_deg: Text | None = _header("degrees, true")
    true_deg: Text | None = _header("degrees, true")
    speed_kn: Text | None = _header("knots")
    time_utc: Text | None = _header("UTC")


class Swing(CalibrationFile):
    """A vessel turned under way, its course by satellites."""

    format: Annotated[Literal["csv", "nmea0183"], BeforeValidator(_csv)] = key("csv or nmea0183", "csv", "csv")
    columns: SwingColumns = key("a mapping", "{compass_deg: hdg, cog_deg: cog}", SwingColumns())

    @property
    def placed(self) -> bool:
        """Whether the earth's field at the calibration is known; a log of NMEA 0183 holds place and time itself."""
        return self.format == "nmea0183" or super().placed


class MagnetometerColumns(Section):
    """Headers of a magnetometer's table where they differ from the roles."""

    x: Text | None = _header("any unit, forward")
    y: Text | None = _header("any unit, starboard")
    z: Text | None = _header("any unit, down")
    pitch_deg: Text | None = _header("degrees")
    roll_deg: Text | None = _header("degrees")
    heading_deg: Text | None = _header("degrees, magnetic")
    time_utc: Text | None = _header("UTC")


class Magnetometer(CalibrationFile):
    """A magnetometer turned about."""

    format: Annotated[Literal["csv", "mmp_acm"], BeforeValidator(_csv)] = key("csv or mmp_acm", "csv", "csv")
    columns: MagnetometerColumns = key("a mapping", "{x: mx, y: my}", MagnetometerColumns())


class DeclinationSeries(CalibrationFile):
    """An observatory's series against the model of the earth's field."""

    format: Literal["iaga2002"] = key("iaga2002", "iaga2002", "iaga2002")


class TwoHeads(CalibrationFile):
    """Two profilers on one frame."""

    format: Literal["pd0"] = key("pd0", "pd0", "pd0")


MODELS: dict[str, type[CalibrationFile]] = {
    "platform": Platform,
    "swing": Swing,
    "magnetometer": Magnetometer,
    "declination": DeclinationSeries,
    "two_heads": TwoHeads,
}


def settings(file: CalibrationFile) -> dict[str, Any]:
    """Return what a kind is given: every key but those of the files, columns by role as far as they are named.

    Args:
        file: a calibration's file.
    """
    plain = file.model_dump(mode="json", exclude={"kind", "files", "compare_with"})
    columns = {role: header for role, header in plain.get("columns", {}).items() if header is not None}
    return {**plain, "columns": columns}


def check_comparisons(files: dict[str, CalibrationFile]) -> tuple[str, str] | None:
    """Return the first calibration whose comparison leads nowhere or in a circle, and what was found.

    Args:
        files: all calibrations by name.
    """
    for name, file in files.items():
        seen, other = [name], file.compare_with
        while other is not None:
            if other not in files:
                return name, shown(other)
            if other in seen:
                return name, f"a circle of comparisons, {' - '.join([*seen, other])}"
            seen.append(other)
            other = files[other].compare_with
    return None
