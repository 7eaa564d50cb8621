"""The model of the deviation, and where its coefficients or pairs come from."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from compasslib.config.section import Coefficients, Covariance, Files, Names, Number, Section, Switch, Text, key
from compasslib.config.values import problem, shown


class PairColumns(Section):
    """The headers, or names of MATLAB variables, of ready-made pairs, and the factor that turns their speeds to m/s."""

    time: Text = key("the header of a column (UTC)", "time_utc")
    heading: Text = key("the header of a column (recorded heading, degrees)", "heading_deg")
    upper_east: Text = key("the header of a column (speed)", "u_top_cm_s")
    upper_north: Text = key("the header of a column (speed)", "v_top_cm_s")
    lower_east: Text = key("the header of a column (speed)", "u_deep_cm_s")
    lower_north: Text = key("the header of a column (speed)", "v_deep_cm_s")
    scale: Number = key("a factor to m/s above 0, at most 1000", "0.01", 1.0, gt=0, le=1000)


class FitOptions(Section):
    """The model of the deviation, and where its coefficients or pairs come from."""

    method: Literal["exact", "von_appen", "calibration", "coefficients", "pairs"] = key(
        "exact, von_appen, calibration, coefficients or pairs", "exact", "exact"
    )
    name: Names = key("the NAME of config/calibrations/NAME.yaml, or [before, after]", "aqd2022", ())
    tilt: Switch = key("true or false", "true", False)
    model: Literal["exact", "von_appen"] = key("exact or von_appen", "exact", "exact")
    coefficients: Coefficients | None = key("the five numbers A to E", "{A: 0, B: 0.3, C: 0.1, D: 0, E: 0}", None)
    covariance: Covariance | None = key("five rows of five numbers, a covariance", "[[...], ...]", None)
    file: Files | None = key("a table or MATLAB file of pairs", "raw/EG4/pairs.csv", None)
    columns: PairColumns | None = key("a mapping", "{time: time_utc, heading: heading_deg, ...}", None)

    @property
    def fitted(self) -> str:
        """The method by which a fit to pairs is made, or that of a compass known beforehand."""
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
        if self.tilt and self.fitted != "exact":
            raise problem("tilt", "it only with method: exact", f"it with {self.method}", "delete it")
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
