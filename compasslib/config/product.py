"""The keys of the gridded product."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import BeforeValidator, model_validator

from compasslib.config import values
from compasslib.config.section import Number, Section, Switch, key
from compasslib.config.values import problem, shown

FlagValues = Annotated[tuple[int, ...], BeforeValidator(values.quality_flags)]


def _auto(expected: str, example: str, **limits: Any) -> Any:
    return key(f"auto, or {expected}", example, None, **limits)


class Grid(Section):
    """Fixed depths and times of the gridded product; ``auto``: as the affected instrument measures."""

    step_m: Number | None = _auto("metres above 0, at most 1000", "8", gt=0, le=1000)
    from_m: Number | None = _auto("metres from 0 to 12000", "20", ge=0, le=12000)
    to_m: Number | None = _auto("metres from 0 to 12000", "500", ge=0, le=12000)
    minutes: Number | None = _auto("minutes from 1 to 1440", "60", ge=1, le=1440)
    max_gap_m: Number | None = _auto("metres from 0 to 1000", "16", ge=0, le=1000)
    max_gap_minutes: Number = key("minutes from 0 to 1440", "180", 180.0, ge=0, le=1440)

    @model_validator(mode="before")
    @classmethod
    def _auto_is_absent(cls, data: Any) -> Any:
        return {k: v for k, v in data.items() if v != "auto"} if isinstance(data, dict) else data

    @model_validator(mode="after")
    def _from_above_to(self) -> Self:
        if self.from_m is not None and self.to_m is not None and self.from_m >= self.to_m:
            raise problem("to_m", f"metres below from_m, {self.from_m}", shown(self.to_m), "correct one of the two")
        return self


class ProductOptions(Section):
    """What is made of the corrected velocities beside corrected.nc."""

    grid: Annotated[Grid | None, BeforeValidator(lambda value: None if value is False else value)] = key(
        "a mapping, or false", "{step_m: 8}", Grid()
    )
    flags: FlagValues = key("a list of flags out of 1, 2 and 3", "[1, 2]", (1, 2))
    daily: Switch = key("true or false", "true", False)
