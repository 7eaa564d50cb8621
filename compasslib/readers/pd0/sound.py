"""Correct velocities and ranges for the difference between the water's speed of sound and EC, which the profiler used.

The instrument computes EC from temperature, depth and the salinity ES, or uses a constant. The velocity of slanted
pistons is proportional to the speed of sound at the transducer, and ranges to its mean along the path, for which that
at the transducer is taken: both are multiplied by true / EC (RDI, Principles of Operation: A Practical Primer, 1996).
A phased array sets the horizontal wavelength by the spacing of its elements, so that its horizontal velocity does not
depend on the speed of sound (TRDI, Ocean Surveyor Technical Manual).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from compasslib.readers.pd0.fields import FROM_CONDUCTIVITY, FROM_THERMOMETER, Ensembles, select
from compasslib.types import Bools, Floats

EC, ES = (1400.0, 1600.0), (0.0, 40.0)  # m/s and practical salinity that the commands EC and ES accept
ES_DEFAULT = 35.0  # of the command: also in files of other water
# Twice the accuracy of a WorkHorse 300 (0.5 % of the velocity). In the moored record eh2 the EC that the instrument
# computed differs from that by the mean temperature of the ensemble by up to 0.6 %.
TOLERANCE = 0.01
FEW = 0.01  # share of differing ensembles that calls for no correction, as on deck


@dataclass(frozen=True, eq=False)
class SoundCorrection:
    """Correction of n ensembles for the speed of sound."""

    factor: Floats  # (n,) of the velocities, 1 where they are kept
    range_factor: float  # of the distances of all bins
    doubtful: Bools  # (n,) whether velocities were kept although EC is not that of the water
    sentence: str = ""  # for the report; empty where EC agrees with the water

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of ensembles corrected and in doubt."""
        corrected, doubtful = int(np.sum(self.factor != 1.0)), int(self.doubtful.sum())
        return {"sound_speed_corrected": corrected, "sound_speed_doubtful": doubtful}


def correct_sound_speed(ensembles: Ensembles, choice: str | Mapping[str, float] | None) -> SoundCorrection:
    """Determine the correction from EC, ES, temperature and depth of each ensemble.

    Args:
        choice: auto (as None), keep or {salinity: S}. With auto nothing is corrected where EC agrees with ES; where it
            does not, ES is the salinity of the water only if it was measured or set to other than its default.
    """
    ec, es, declared = ensembles.sound_m_s, ensembles.salinity, isinstance(choice, Mapping)
    stated = (es > ES[0]) & (es != ES_DEFAULT)
    known = (stated | ((ensembles.measured & FROM_CONDUCTIVITY) > 0)) & (es <= ES[1])
    if isinstance(choice, Mapping):
        es, known = np.full_like(es, choice["salinity"]), np.full_like(known, True)
    true = _true_over_used(ensembles, es)
    differs = ~(np.abs(true - 1.0) <= TOLERANCE)  # also where it is unknown
    kept = SoundCorrection(np.ones_like(true), 1.0, np.zeros_like(differs))
    if not declared and differs.mean() <= FEW:
        return kept
    said = f"EC, the speed of sound that the instrument used, is {_span(ec, '.0f')} m/s"
    if choice == "keep" or ensembles.phased_array.all():
        why = "sound_speed: keep" if choice == "keep" else "those of a phased array do not depend on it"
        return replace(kept, sentence=f"{said}; horizontal velocities were kept as recorded ({why}).")
    corrected = known & np.isfinite(true)
    factor, doubtful = np.where(corrected, true, 1.0), differs & ~corrected
    range_factor = float(np.median(factor))
    if corrected.any():
        source = "by sound_speed" if declared else "by ES in the file"
        said += f"; velocities of {corrected.sum()} of {len(ec)} ensembles were multiplied by "
        said += f"{_span(factor[corrected], '.3f')} and ranges by {range_factor:.3f}, those of water of salinity "
        said += f"{_span(es[corrected], 'g')} ({source})"
    if doubtful.any():
        said += f"; velocities of {doubtful.sum()} of {len(ec)} ensembles were kept and flagged 2: "
        said += _describe_doubtful(select(ensembles, doubtful))
    return SoundCorrection(factor, range_factor, doubtful, f"{said}.")


def _true_over_used(ensembles: Ensembles, salinity: ArrayLike) -> Floats:
    """Divide the speed of sound in water of a practical salinity (TEOS-10) by EC, (n,).

    NaN without a measured temperature, and where EC is none that the command accepts.
    """
    import gsw  # takes 0.1 s

    temperature = np.where(ensembles.measured & FROM_THERMOMETER, ensembles.temperature_c, np.nan)
    pressure = np.where(np.isfinite(ensembles.pressure_dbar), ensembles.pressure_dbar, ensembles.depth_m)
    used = np.where((ensembles.sound_m_s >= EC[0]) & (ensembles.sound_m_s <= EC[1]), ensembles.sound_m_s, np.nan)
    absolute = gsw.SR_from_SP(salinity)
    with np.errstate(invalid="ignore"):
        return np.asarray(gsw.sound_speed(absolute, gsw.CT_from_t(absolute, temperature, pressure), pressure) / used)


def _describe_doubtful(ensembles: Ensembles) -> str:
    off = [100.0 * (1.0 / np.median(_true_over_used(ensembles, salinity)) - 1.0) for salinity in reversed(ES)]
    if not np.isfinite(off).all():
        return "EC cannot be compared with the water, as some have no measured temperature or no possible EC"
    shown = f"their speeds are {off[0]:+.1f} to {off[1]:+.1f} % off for salinities of {ES[1]:g} to {ES[0]:g}"
    return f"{shown} (the salinity alone: up to 3 %); sound_speed: {{salinity: S}} corrects them"


def _span(values: Floats, form: str) -> str:
    return " to ".join(dict.fromkeys(format(value, form) for value in (values.min(), values.max())))
