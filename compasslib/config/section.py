"""Base class of the YAML models, fields with their error messages, and the options of fit and product."""

import re
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from compasslib.config import values
from compasslib.config.values import SHOWN, nearest, problem, shown
from compasslib.errors import InputError
from compasslib.readers import TABLE_KEYS


def key(expected: str, example: str, default: Any = ..., advice: str | None = None, **limits: Any) -> Any:
    """Create a field with the texts of its error message.

    Args:
        expected: description of the allowed values, followed by their bounds in the message.
        example: a value as written in YAML, which is the ``advice`` unless another is given.
        default: value if the key is absent; without a default the key is required.
        **limits: bounds (``ge`` or ``gt``, with ``le``) and alias, passed to ``pydantic.Field``.
    """
    if "le" in limits:
        expected += f" from {limits['ge']:g}" if "ge" in limits else f" above {limits['gt']:g}"
        expected += f" to {limits['le']:.10g}"
    return Field(
        default,
        description=expected,
        examples=[example],
        json_schema_extra={"advice": advice},
        **limits,
    )


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


def describe(model: type[BaseModel], error: Any, file: str) -> InputError:
    """Describe an error of pydantic: the place in the file, and the texts of its field unless the error has its own."""
    kind, value = error["type"], error["input"]
    place, label, field, inner = _locate(model, error["loc"])
    if kind == "extra_forbidden":
        allowed, unknown = list(allowed_keys(inner or model)), str(error["loc"][-1])
        advice = nearest(unknown, allowed) or "delete it, or indent it below the key that it belongs to"
        expected, actual = f"a key out of {', '.join(allowed)}", f"the unknown {shown(unknown)}"
        return InputError(f"{file}: {place}", expected=expected, found=actual, advice=advice)
    example = f"for example {label}: {field.examples[0]}" if field else ""
    texts = {"expected": field.description if field else "", "found": shown(value)}
    texts["advice"] = (field and field.json_schema_extra["advice"]) or f"write {example}"
    if kind == "missing":
        texts |= {"found": "nothing", "advice": f"add {example}"}
    elif kind == "model_type" and inner:
        texts |= {"expected": "a mapping", "advice": f"write below it keys out of {', '.join(allowed_keys(inner))}"}
    elif kind == "literal_error":
        allowed = re.findall(r"'([^']*)'", error["ctx"]["expected"])
        texts["advice"] = nearest(str(value), allowed) or texts["advice"]
        if error["loc"][-1] == "[key]":
            texts["expected"] = f"a key out of {', '.join(allowed)}"
    elif kind == "float_type" and isinstance(value, str) and re.search(r"\d", value):
        texts["advice"] = "write a number with a point, without quotes, unit or leading zeros"
    elif kind == "string_type" and isinstance(value, int | float) and not isinstance(value, bool):
        texts["advice"] = f"write it in quotes: '{shown(value)}'"
    elif kind in ("too_long", "too_short"):
        texts["found"] = str(error["ctx"]["actual_length"])
    elif kind == "cruise":
        place = ".".join(part for part in (place, error["ctx"]["key"]) if part)
        texts |= {part: words for part in texts if (words := error["ctx"][part])}
    return InputError(f"{file}: {place}", **texts)


def _locate(model: type[BaseModel], loc: Sequence[str | int]) -> tuple[str, str, Any, type[BaseModel] | None]:
    """Follow a location to its place in the file, its field with its key, and the model below the field, if any."""
    place, label, field, named = "", "", None, False
    inner: type[BaseModel] | None = model
    for part in loc:
        if isinstance(part, int):
            place += f"[{part}]" * bool(inner)
        elif named:  # a name that the user gave
            named, place = False, f"{place}.{part[:SHOWN]}"
        elif inner and part not in allowed_keys(inner):
            return f"{place}.{part[:SHOWN]}".lstrip("."), "", None, inner
        elif inner:
            label, field, place = part, allowed_keys(inner)[part], f"{place}.{part}"
            inner, named = _model_in(field.annotation), get_origin(field.annotation) is dict
        else:  # "[key]", or the part of a union
            break
    return place.lstrip("."), label, field, inner


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((inner for part in get_args(annotation) if (inner := _model_in(part))), None)


def auto(expected: str, example: str, **limits: Any) -> Any:
    """Declare a key that may be ``auto``, which is None, or a value within limits."""
    return key(f"auto, or {expected}", example, None, **limits)


class Grid(Section):
    """Fixed depths and times of the gridded product; ``auto``: those of the affected instrument."""

    absent = (None, "auto")

    step_m: values.Number | None = auto("metres", "8", ge=0.1, le=1000)  # depths are known to 0.5 m at best
    from_m: values.Number | None = auto("metres", "20", ge=0, le=12000)
    to_m: values.Number | None = auto("metres", "500", ge=0, le=12000)
    minutes: values.Number | None = auto("minutes", "60", ge=1, le=1440)
    max_gap_m: values.Number | None = auto("metres", "16", ge=0, le=1000)
    max_gap_minutes: values.Number = key("minutes", "180", 180.0, ge=0, le=1440)

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
    flags: values.FlagValues = key("a list of flags out of 1, 2 and 3", "[1, 2]", (1, 2))
    daily: values.Switch = key("true or false", "true", False)


class PairColumns(Section):
    """Headers, or names of MATLAB variables, of ready-made pairs, and the factor that converts their speeds to m/s."""

    time: values.Text = key("the header of a column (UTC)", "time_utc")
    heading: values.Text = key("the header of a column (recorded heading, degrees)", "heading_deg")
    upper_east: values.Text = key("the header of a column (speed)", "u_top_cm_s")
    upper_north: values.Text = key("the header of a column (speed)", "v_top_cm_s")
    lower_east: values.Text = key("the header of a column (speed)", "u_deep_cm_s")
    lower_north: values.Text = key("the header of a column (speed)", "v_deep_cm_s")
    scale: values.Number = key("a factor to m/s", "0.01", 1.0, gt=0, le=1000)


class FitOptions(Section):
    """Model of the deviation and source of its coefficients or pairs."""

    method: Literal["exact", "von_appen", "calibration", "coefficients", "pairs"] = key(
        "exact, von_appen, calibration, coefficients or pairs", "exact", "exact"
    )
    name: values.Names = key("the NAME of config/calibrations/NAME.yaml, or [before, after]", "aqd2022", ())
    model: Literal["exact", "von_appen"] = key("exact or von_appen", "exact", "exact")
    coefficients: values.Coefficients | None = key(
        "the five numbers A to E", "{A: 0, B: 0.3, C: 0.1, D: 0, E: 0}", None
    )
    covariance: values.Covariance | None = key("five rows of five numbers, a covariance", "[[...], ...]", None)
    file: values.Files | None = key("a table or MATLAB file of pairs", "raw/EG4/pairs.csv", None)
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
