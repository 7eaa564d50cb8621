"""A mapping of a cruise's YAML files as a frozen model, and the keys in it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from compasslib.config import values
from compasslib.readers import TABLE_KEYS

Number = Annotated[float, BeforeValidator(values.number)]
Count = Annotated[int, BeforeValidator(values.count)]
Switch = Annotated[bool, BeforeValidator(values.switch)]


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
