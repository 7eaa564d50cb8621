"""Judge a record once more with what the others of its compass tell beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib import deviation as deviations
from compasslib import earthfield
from compasslib.archive import netcdf
from compasslib.calibrations import at_mooring
from compasslib.deviation import assessment as assessments
from compasslib.deviation import exact
from compasslib.deviation.model import FEWEST_PAIRS, Fit
from compasslib.inference import covariates
from compasslib.inference.product import Product
from compasslib.joint import content
from compasslib.joint.content import Returned
from compasslib.preparation import several
from compasslib.records import EarthField, Pairs, Record
from compasslib.stages import diagnose


def run(
    mooring: str,
    *,
    joined: str,
    alone: Sequence[str],
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
    tilt: bool,
    say: Callable[[str], None],
) -> None:
    """Write the diagnosis and the fit that correct the record; those of the record alone where no other belongs to it.

    Args:
        joined: compass.json.
        alone: diagnosis.json, deviation.json and assessment.json as the record has them alone.
        wide: pairs that may stand further apart, from which the shear of the water is learnt.
        tilt: whether pitch and roll enter the fit.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    told, configured = content.returned(netcdf.read_json(joined), mooring), netcdf.read_json(fit)
    if told is None:
        netcdf.write_json(diagnosis, netcdf.read_json(alone[0]))
        netcdf.write_json(deviation, netcdf.read_json(alone[1]))
        netcdf.write_json(assessment, netcdf.read_json(alone[2]))
        say(f"{mooring}: no other record of its compass belongs to it; as it is alone")
        return
    near, along = several.together(netcdf.read_pairs(pairs)), earthfield.from_json(netcdf.read_json(field))
    before = deviations.from_json(configured)
    fitted, own = before, netcdf.read_record(record, velocities=False)
    if before.method != "von_appen":
        fitted = beside_others(told, near, along, own, tilt=tilt)
        configured = deviations.described(fitted, own)

    def with_effects(made: Product, searched: bool) -> Product:
        if searched or not (told.effects and options["enabled"] and options["apply"]):
            return made
        return content.with_effects(made, told, along, covariates.logged(netcdf.read_record(record), observatory))

    made = diagnose.judged(
        near,
        along,
        configured,
        fitted,
        record=record,
        references=references,
        observatory=observatory,
        wide=wide,
        options=options,
        shared=told.effects,
        with_effects=with_effects,
    )
    text = carried_by(told, before, fitted)
    netcdf.write_json(diagnosis, made.diagnosis.to_json())
    netcdf.write_json(deviation, configured | {"applied": made.product.to_json(), "shared": told.block(text)})
    netcdf.write_json(assessment, made.assessment)
    lines = text, made.diagnosis.log_line(mooring), assessments.log_line(mooring, made.assessment)
    say("\n".join([f"{mooring}: {lines[0]}", *lines[1:]]))


def beside_others(told: Returned, pairs: Pairs, field: EarthField, record: Record, *, tilt: bool) -> Fit:
    """Return the compass fitted to a record's pairs with what others tell; by theirs alone where there are too few."""
    if len(pairs) >= FEWEST_PAIRS and not told.prior.precision[0, 0]:
        dip_ratio = tilt * earthfield.dip_ratio(field)
        return deviations.fit("exact", pairs, exact.beside(told.prior, pairs), dip_ratio=dip_ratio)
    covariance = np.linalg.inv(told.prior.precision)
    warning = (
        f"corrected by the compass of {', '.join(told.others)}; iron that changed in between is in the uncertainty"
    )
    known = Fit(at_mooring.METHOD, len(pairs), told.prior.mean, covariance, warnings=(warning,))
    return replace(at_mooring.held_against(known, record, pairs), prior=told.prior)


def carried_by(told: Returned, alone: Fit, fitted: Fit) -> str:
    """Return in a sentence whose data carry the compass of a record."""
    others = ", ".join(told.others)
    if not alone.fitted:
        return f"the compass is carried by {others} of compass {told.compass}; this record alone determines none"
    if fitted.method == "von_appen":
        return f"{others} of compass {told.compass} tell of effects only; the published fit is this record's own"
    own, both = (float(np.sqrt(fit.covariance[1, 1] + fit.covariance[2, 2])) for fit in (alone, fitted))
    return f"B and C are known to {both:.3f} with {others} of compass {told.compass}, to {own:.3f} by this record alone"
