"""Search for unmodelled effects, assess the correction, and judge the mooring as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from compasslib import deviation as deviations
from compasslib import earthfield
from compasslib.archive import netcdf
from compasslib.deviation import assessment as assessments
from compasslib.deviation import constant
from compasslib.deviation.model import Fit
from compasslib.inference import conclusion, covariates, verdict
from compasslib.inference.conclusion import Conclusion
from compasslib.inference.product import Product
from compasslib.preparation import several
from compasslib.records import EarthField, Pairs

if TYPE_CHECKING:  # only where it searches: half of what its job imports
    from compasslib.inference.case import Shared
    from compasslib.inference.verdict import Diagnosis

DISABLED = "the search was switched off (diagnose: {enabled: false})"


def run(
    mooring: str,
    *,
    record: str,
    references: Sequence[str],
    pairs: str,
    wide: str,
    fit: str,
    field: str,
    observatory: Sequence[str],
    diagnosis: str,
    deviation: str,
    assessment: str,
    options: Mapping[str, Any],
    say: Callable[[str], None],
    summary: str = "",
) -> None:
    """Write the diagnosis, the fit with what was found and is applied, and the agreement with the reference.

    Args:
        references: records of the reference instruments, perhaps none.
        wide: pairs that may stand further apart, from which the shear of the water is learnt.
        observatory: IAGA-2002 files of one observatory, perhaps none.
        options: of the mooring's diagnosis.
        summary: what other records of the compass may learn from this one, where there are others.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    near, along = several.together(netcdf.read_pairs(pairs)), earthfield.from_json(netcdf.read_json(field))
    configured = netcdf.read_json(fit)
    fitted = deviations.from_json(configured)
    told = {**options, "tell": bool(summary)}
    made = judged(
        near, along, configured, fitted, record=record, references=references, observatory=observatory, wide=wide,
        options=told,
    )  # fmt: skip
    netcdf.write_json(diagnosis, made.diagnosis.to_json())
    netcdf.write_json(deviation, configured | {"applied": made.product.to_json(), "shared": None})
    netcdf.write_json(assessment, made.assessment)
    if summary:
        netcdf.write_json(summary, _summary(mooring, near, fitted, along, made.diagnosis))
    say(f"{made.diagnosis.log_line(mooring)}\n{assessments.log_line(mooring, made.assessment)}")


def judged(
    near: Pairs,
    along: EarthField,
    configured: Mapping[str, Any],
    fitted: Fit,
    *,
    record: str,
    references: Sequence[str],
    observatory: Sequence[str],
    wide: str,
    options: Mapping[str, Any],
    shared: Shared | None = None,
    with_effects: Callable[[Product, bool], Product] = lambda made, searched: made,
) -> Conclusion:
    """Search the pairs of a mooring and judge it as a whole; other arguments as of ``run`` and ``conclude``.

    Args:
        configured: content of the fit's file.
        shared: what other records of the same compass tell of its effects.
    """
    series = covariates.logged(netcdf.read_record(record), observatory)
    own = netcdf.read_record(record, velocities=False)  # they are a third of the memory
    fixed = None
    if not options["constant_confirmed"]:
        biases = netcdf.taken_out((record, *references))
        fixed = constant.of_fit(fitted, near, float(np.mean(along.declination_deg)), biases)

    def search(some: Pairs) -> Diagnosis:
        if not options["enabled"]:
            return verdict.insufficient(DISABLED)
        from compasslib.inference.comparison import Options
        from compasslib.inference.kinds.mooring import diagnose

        apart = ("enabled", "constant_confirmed")
        chosen = Options(**{name: value for name, value in options.items() if name not in apart})
        at = np.searchsorted(own.time_s, some.time_s)
        logged = {name: column[at] for name, column in series.items()}
        far = several.together(netcdf.read_pairs(wide))
        return diagnose(some, logged, fitted, along, chosen, wide=far, units=dict(own.channel_units), shared=shared)

    return conclusion.conclude(
        search,
        near,
        own,
        along,
        series,
        fit=fitted,
        constant=fixed,
        calibration=(configured.get("calibration") or {}).get("name", ""),
        with_effects=with_effects,
    )


def _summary(mooring: str, near: Pairs, fitted: Fit, along: EarthField, found: Diagnosis) -> dict[str, Any]:
    from compasslib.inference import sharing
    from compasslib.joint import members

    told = found.told or sharing.of_fit(fitted)
    place = float(np.mean(along.horizontal_nT)), float(np.mean(along.vertical_nT))
    return members.summary(
        mooring, place, told, span_s=near.time_s[[0, -1]].tolist() if len(near) else [], why=fitted.why
    )
