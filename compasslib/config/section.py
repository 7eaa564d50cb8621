"""What every model of a YAML file stands on: types of values, fields with the words of their message, and a section."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from compasslib import readers
from compasslib.config import values
from compasslib.config.values import problem
from compasslib.readers import TABLE_KEYS


def _form(value: Any) -> str:
    offered = readers.format_names()
    if value not in offered:
        raise problem(
            expected=f"{', '.join(offered[:-1])} or {offered[-1]}", advice=values.nearest(str(value), offered)
        )
    return str(value)


Number = Annotated[float, BeforeValidator(values.number)]
Count = Annotated[int, BeforeValidator(values.count)]
Switch = Annotated[bool, BeforeValidator(values.switch)]
Text = Annotated[str, BeforeValidator(values.text)]
Name = Annotated[str, BeforeValidator(values.name)]
Names = Annotated[tuple[Name, ...], BeforeValidator(values.names)]
Time = Annotated[float, BeforeValidator(values.time_s)]
Files = Annotated[tuple[str, ...], BeforeValidator(values.raw_files)]
MooringPaths = Annotated[str | tuple[str, ...], BeforeValidator(values.mooring_paths)]
Attributes = Annotated[dict[str, str | int | float], BeforeValidator(values.attributes)]
Declination = Annotated[float | Literal["auto"], BeforeValidator(values.declination)]
TimeFormat = Annotated[str, BeforeValidator(values.time_format)]
Delimiter = Annotated[str, BeforeValidator(values.delimiter)]
Decimal = Annotated[str, BeforeValidator(values.decimal)]
Zone = Annotated[str, BeforeValidator(values.zone)]
Missing = Annotated[tuple[str, ...], BeforeValidator(values.missing)]
DeclinationApplied = Annotated[float | dict[str, float], BeforeValidator(values.declination_applied)]
Formats = Annotated[tuple[str, ...], BeforeValidator(values.figure_formats)]
Coefficients = Annotated[dict[str, float], BeforeValidator(values.coefficients)]
Covariance = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(values.covariance)]
Span = Annotated[tuple[float, float], BeforeValidator(values.span)]
Form = Annotated[str, BeforeValidator(_form)]
Reference = Annotated[Literal["magnetic", "true"], BeforeValidator(values.unquoted_true)]


def key(expected: str, example: str, default: Any = ..., advice: str | None = None, **limits: Any) -> Any:
    """Make a field with the words that its error message needs.

    Args:
        expected: what may stand there, to be read after "expected".
        example: a value as it is written in YAML.
        default: its value where the key is absent; required without one.
        advice: what to do where the value is wrong; write the example where absent.
        **limits: bounds and alias, as pydantic names them.
    """
    return Field(default, description=expected, examples=[example], json_schema_extra={"advice": advice}, **limits)


def allowed_keys(model: type[BaseModel]) -> dict[str, Any]:
    """List the fields of a model by the key that stands in the YAML file, those of any table last."""
    named = sorted(model.model_fields.items(), key=lambda item: item[0] in TABLE_KEYS)
    return {field.alias or name: field for name, field in named}


class Section(BaseModel):
    """A mapping that refuses unknown keys and takes an empty value for an absent one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _empty_is_absent(cls, data: Any) -> Any:
        known = allowed_keys(cls)
        return {k: v for k, v in data.items() if v is not None or k not in known} if isinstance(data, dict) else data
