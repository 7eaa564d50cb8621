"""A mooring's diagnosis as the workflow asks for it, and what it says of it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np

from compasslib.deviation.model import Fit
from compasslib.discrepancy import diagnosis, verdict
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.verdict import Diagnosis
from compasslib.records import EarthField, Pairs, Record

SWITCHED_OFF = "the search was switched off (diagnose: {enabled: false})"


def diagnose(record: Record, pairs: Pairs, fit: Fit, field: EarthField, options: Mapping[str, Any]) -> Diagnosis:
    """Return what a mooring's overlap shows that its fitted compass does not hold.

    Args:
        record: the compromised instrument, for what it logged besides.
        pairs: overlapping measurements, at times of the record.
        fit: the configured fit.
        field: the earth's field along time.
        options: ``enabled``, and what may be chosen besides, see ``Options``.
    """
    chosen = dict(options)
    if not chosen.pop("enabled"):
        return verdict.insufficient(SWITCHED_OFF)
    at = np.searchsorted(record.time_s, pairs.time_s)
    logged = {"temperature": record.temperature_c[at], "supply_voltage": record.supply_voltage[at]}
    return diagnosis.diagnose(pairs, logged, fit, field, Options(**chosen))


def told(name: str, found: Diagnosis) -> str:
    """Return what the job says of its result.

    Args:
        name: the mooring or calibration.
        found: the diagnosis.
    """
    said = [finding.text for finding in found.findings]
    said += [found.unexplained.text] if found.unexplained else []
    said += [found.why] if found.why else []
    return "\n".join([f"{name}: {found.verdict}", *(textwrap.indent(text, "  ") for text in said)])
