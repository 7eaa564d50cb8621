"""Building blocks of the YAML models: types of values, fields with error messages, and shared sections."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from compasslib import readers
from compasslib.config import values
from compasslib.config.values import problem, shown
from compasslib.readers import TABLE_KEYS


def _form(value: Any) -> str:
    offered = readers.format_names()
    if value not in offered:
        expected = f"{', '.join(offered[:-1])} or {offered[-1]}"
        raise problem(expected=expected, advice=values.nearest(str(value), offered))
    return str(value)


Cell = str | int | float
Number = Annotated[float, BeforeValidator(values.number)]
Count = Annotated[int, BeforeValidator(values.count)]
Switch = Annotated[bool, BeforeValidator(values.switch)]
Text = Annotated[str, BeforeValidator(values.text)]
Column = Annotated[str | int, BeforeValidator(values.column)]
TimeColumns = Annotated[
    str | int | tuple[str | int, ...], BeforeValidator(values.time_columns, json_schema_input_type=Cell | list[Cell])
]
Comment = Annotated[str, BeforeValidator(values.text)]
Name = Annotated[str, BeforeValidator(values.name)]
Names = Annotated[tuple[Name, ...], BeforeValidator(values.names, json_schema_input_type=str | list[str])]
Sphere = Annotated[str | bool, BeforeValidator(values.sphere, json_schema_input_type=str | Literal[True])]
Time = Annotated[float, BeforeValidator(values.time_s, json_schema_input_type=str)]
Files = Annotated[tuple[str, ...], BeforeValidator(values.raw_files, json_schema_input_type=str | list[str])]
MooringPaths = Annotated[
    str | tuple[str, ...], BeforeValidator(values.mooring_paths, json_schema_input_type=str | list[str])
]
Attributes = Annotated[dict[str, str | int | float], BeforeValidator(values.attributes)]
Declination = Annotated[float | Literal["auto"], BeforeValidator(values.declination)]
TimeFormat = Annotated[str, BeforeValidator(values.time_format)]
Delimiter = Annotated[str, BeforeValidator(values.character(comma=",", semicolon=";", tab="\t", blank=" "))]
Decimal = Annotated[str, BeforeValidator(values.character(point=".", comma=","))]
Zone = Annotated[str, BeforeValidator(values.zone)]
Missing = Annotated[tuple[str, ...], BeforeValidator(values.missing, json_schema_input_type=Cell | list[Cell])]
DeclinationApplied = Annotated[float | dict[str, float], BeforeValidator(values.declination_applied)]
SoundSpeed = Annotated[Literal["auto", "keep"] | dict[str, float], BeforeValidator(values.sound_speed)]
Formats = Annotated[
    tuple[str, ...],
    BeforeValidator(values.figure_formats, json_schema_input_type=Literal["png", "pdf"] | list[Literal["png", "pdf"]]),
]
Coefficients = Annotated[dict[str, float], BeforeValidator(values.coefficients)]
Covariance = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(values.covariance)]
Span = Annotated[tuple[float, float], BeforeValidator(values.span, json_schema_input_type=float | list[float])]
Depths = Annotated[
    tuple[float, float],
    BeforeValidator(partial(values.span, from_zero=True), json_schema_input_type=float | list[float]),
]
Form = Annotated[str, BeforeValidator(_form, json_schema_input_type=Literal[*readers.FORMATS] | str)]
WRITTEN = Literal["magnetic", "true", True]  # an unquoted true is read as a truth value
TRUE = BeforeValidator(lambda value: "true" if value is True else value, json_schema_input_type=WRITTEN)
Reference = Annotated[Literal["magnetic", "true"], TRUE]


def key(expected: str, example: str, default: Any = ..., advice: str | None = None, **limits: Any) -> Any:
    """Create a field with the texts of its error message.

    Args:
        expected: description of the allowed values, shown after "expected".
        example: a value as written in YAML.
        default: value if the key is absent; without a default the key is required.
        advice: how to correct a wrong value; by default, to write the example.
        **limits: bounds and alias, passed to ``pydantic.Field``.
    """
    return Field(default, description=expected, examples=[example], json_schema_extra={"advice": advice}, **limits)


def allowed_keys(model: type[BaseModel]) -> dict[str, Any]:
    """Map the YAML keys of a model to its fields, with the keys of text tables last."""
    named = sorted(model.model_fields.items(), key=lambda item: item[0] in TABLE_KEYS)
    return {field.alias or name: field for name, field in named}


class Section(BaseModel):
    """Base class of a mapping that refuses unknown keys and treats an empty value as absent."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    absent: ClassVar[tuple[str | None, ...]] = (None,)  # values that stand for an absent key

    @model_validator(mode="before")
    @classmethod
    def _empty_is_absent(cls, data: Any) -> Any:
        known = allowed_keys(cls)
        given = isinstance(data, dict)
        return {k: v for k, v in data.items() if v not in cls.absent or k not in known} if given else data


FlagValues = Annotated[tuple[int, ...], BeforeValidator(values.quality_flags, json_schema_input_type=int | list[int])]


def auto(expected: str, example: str, **limits: Any) -> Any:
    return key(f"auto, or {expected}", example, None, **limits)


class Grid(Section):
    """Fixed depths and times of the gridded product; ``auto``: those of the affected instrument."""

    absent = (None, "auto")

    step_m: Number | None = auto("metres from 0.1 to 1000", "8", ge=0.1, le=1000)  # depths are known to 0.5 m at best
    from_m: Number | None = auto("metres from 0 to 12000", "20", ge=0, le=12000)
    to_m: Number | None = auto("metres from 0 to 12000", "500", ge=0, le=12000)
    minutes: Number | None = auto("minutes from 1 to 1440", "60", ge=1, le=1440)
    max_gap_m: Number | None = auto("metres from 0 to 1000", "16", ge=0, le=1000)
    max_gap_minutes: Number = key("minutes from 0 to 1440", "180", 180.0, ge=0, le=1440)

    @model_validator(mode="after")
    def _from_above_to(self) -> Self:
        if self.from_m is not None and self.to_m is not None and self.from_m >= self.to_m:
            raise problem("to_m", f"metres below from_m, {self.from_m}", shown(self.to_m), "correct one of the two")
        return self


class ProductOptions(Section):
    """Products of the corrected velocities in addition to corrected.nc."""

    grid: Annotated[Grid | None, BeforeValidator(lambda value: None if value is False else value)] = key(
        "a mapping, or false", "{step_m: 8}", Grid()
    )
    flags: FlagValues = key("a list of flags out of 1, 2 and 3", "[1, 2]", (1, 2))
    daily: Switch = key("true or false", "true", False)


class PairColumns(Section):
    """Headers, or names of MATLAB variables, of ready-made pairs, and the factor that converts their speeds to m/s."""

    time: Text = key("the header of a column (UTC)", "time_utc")
    heading: Text = key("the header of a column (recorded heading, degrees)", "heading_deg")
    upper_east: Text = key("the header of a column (speed)", "u_top_cm_s")
    upper_north: Text = key("the header of a column (speed)", "v_top_cm_s")
    lower_east: Text = key("the header of a column (speed)", "u_deep_cm_s")
    lower_north: Text = key("the header of a column (speed)", "v_deep_cm_s")
    scale: Number = key("a factor to m/s above 0, at most 1000", "0.01", 1.0, gt=0, le=1000)


class FitOptions(Section):
    """Model of the deviation and source of its coefficients or pairs."""

    method: Literal["exact", "von_appen", "calibration", "coefficients", "pairs"] = key(
        "exact, von_appen, calibration, coefficients or pairs", "exact", "exact"
    )
    name: Names = key("the NAME of config/calibrations/NAME.yaml, or [before, after]", "aqd2022", ())
    model: Literal["exact", "von_appen"] = key("exact or von_appen", "exact", "exact")
    coefficients: Coefficients | None = key("the five numbers A to E", "{A: 0, B: 0.3, C: 0.1, D: 0, E: 0}", None)
    covariance: Covariance | None = key("five rows of five numbers, a covariance", "[[...], ...]", None)
    file: Files | None = key("a table or MATLAB file of pairs", "raw/EG4/pairs.csv", None)
    columns: PairColumns | None = key("a mapping", "{time: time_utc, heading: heading_deg, ...}", None)

    @property
    def fitted(self) -> str:
        """Model that is fitted to pairs, or the method if the coefficients are known beforehand."""
        return self.model if self.method == "pairs" else self.method

    @model_validator(mode="after")
    def _check_keys_of_method(self) -> Self:
        needed = {"coefficients": ("coefficients",), "pairs": ("file", "columns")}
        allowed = {"coefficients": ("coefficients", "covariance", "model"), "pairs": ("file", "columns", "model")}
        for name in sorted({*allowed["coefficients"], *allowed["pairs"]} & self.model_fields_set):
            if name not in allowed.get(self.method, ()):
                methods = " or ".join(method for method in allowed if name in allowed[method])
                raise problem(name, f"it only with method: {methods}", f"it with {self.method}", "delete it")
        if missing := [name for name in needed.get(self.method, ()) if getattr(self, name) is None]:
            raise problem(missing[0], f"it with method: {self.method}", "nothing", "add it, see config/README.md")
        if self.method == "calibration" and not self.name:
            advice = "write fit: {method: calibration, name: NAME}"
            raise problem("name", "the NAME of config/calibrations/NAME.yaml", "nothing", advice)
        if self.method != "calibration" and self.name:
            expected = f"no name beside method: {self.method}"
            raise problem("name", expected, shown(self.name[0]), "delete it or write method: calibration")
        if len(self.name) > 2 or len(set(self.name)) < len(self.name):
            expected, given = "one calibration, or two others, [before, after]", ", ".join(self.name)
            raise problem("name", expected, given, "write the one before and the one after the deployment")
        return self
