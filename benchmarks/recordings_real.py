"""Diagnoses of real recordings with a known cause that is concealed by withholding a channel or log, one line each.

python benchmarks/recordings_real.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from runs import DATA

from compasslib.inference import kinds
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import Finding
from compasslib.inference.kinds import platform

ACM, SIGNATURE = "acm/mmp_global_A0000001.TXT", "magnetometer/signature500.csv"
MMP, NMEA = {"format": "mmp_acm"}, {"format": "nmea0183"}
# What is concealed, kind, file, settings.
CASES: tuple[tuple[str, str, str, dict[str, object]], ...] = (
    ("levelling", "magnetometer", ACM, MMP),
    ("levelling, from the binary file", "magnetometer", ACM.replace("TXT", "DAT"), MMP),
    ("tilts", "magnetometer", ACM, {**MMP, "withhold": ["TX", "TY"]}),
    ("one tilt", "magnetometer", ACM, {**MMP, "withhold": ["TX"]}),
    ("heading", "magnetometer", ACM, {**MMP, "withhold": ["HDNG"]}),
    ("hard iron", "magnetometer", SIGNATURE, {}),
    ("hard iron, heading", "magnetometer", SIGNATURE, {"withhold": ["heading_deg"]}),
    ("hard iron, z", "magnetometer", SIGNATURE, {"withhold": ["z"]}),
    ("hard iron, z, heading", "magnetometer", SIGNATURE, {"withhold": ["z", "heading_deg"]}),
    ("hard iron, pitch", "magnetometer", SIGNATURE, {"withhold": ["pitch_deg"]}),
    ("hard iron, tilts", "magnetometer", SIGNATURE, {"withhold": ["pitch_deg", "roll_deg"]}),
    ("hard iron, tilts, heading", "magnetometer", SIGNATURE, {"withhold": ["pitch_deg", "roll_deg", "heading_deg"]}),
    ("hard iron, all but x, y", "magnetometer", SIGNATURE, {"withhold": ["z", "pitch_deg", "roll_deg", "heading_deg"]}),
    ("iron", "magnetometer", "magnetometer/hmc5883l_sphere.csv", {}),
    ("the storm", "declination", "observatory/esk20031029dmin.min", {}),
    ("nothing: a quiet day", "declination", "observatory/esk20030610dmin.min", {}),
    ("water", "swing", "swing/2010-11-03.Taiohae.nmea", NMEA),
    ("water, ship's log", "swing", "swing/2010-11-03.Taiohae.nmea", {**NMEA, "withhold": ["water_speed_kn"]}),
)
EIGHT = np.array([-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123])  # Moncunill et al. 2023, 5.3


def table() -> str:
    """Compose the table: recording, what is concealed, verdict, findings, unexplained mismatch."""
    lines = ["| recording | concealed | verdict | findings | unexplained |", "|---|---|---|---|---|"]
    for concealed, kind, name, settings in CASES:
        if (DATA / name).exists():
            diagnosis = kinds.diagnose(kind, [DATA / name], settings, Options())
            lines.append(_line(Path(name).stem, concealed, diagnosis))
        else:
            lines.append(f"| {Path(name).stem} | {concealed} | no such file beside the repository | | |")
    true = np.arange(0.0, 360.0, 45.0)
    eight = platform.diagnose_readings(true, true - EIGHT, field=None, options=Options())
    return "\n".join([*lines, _line("Moncunill's eight headings", "third and fourth harmonics", eight)])


def _line(name: str, concealed: str, diagnosis: Diagnosis) -> str:
    findings = "; ".join(_described(finding) for finding in diagnosis.findings) or diagnosis.why
    left = diagnosis.unexplained
    unexplained = f"{left.rms_effect_deg:.2f}° along {' and '.join(left.covariates)}" if left else ""
    return f"| {name} | {concealed} | {diagnosis.verdict} | {findings} | {unexplained} |"


def _described(finding: Finding) -> str:
    numbers = ", ".join(f"{name} {p.value:.4g} ± {p.sigma:.2g} {p.unit}" for name, p in finding.parameters.items())
    others = f", or {', '.join(finding.alternatives)}" if finding.alternatives else ""
    left_out = f"held out {finding.held_out.rms_before_deg:.3g}° to {finding.held_out.rms_after_deg:.3g}°"
    when = f", {finding.where.text}" if finding.where.covariate == "time" else ""
    size = f"{finding.rms_effect_deg:.3g}°"
    return f"{finding.effect}{others} ({finding.side}; {size}; {numbers}; {left_out}{when})"


if __name__ == "__main__":
    print(table())
