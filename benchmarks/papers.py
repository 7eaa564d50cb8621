"""Numbers of the three papers as this software computes them: the column *ours* of docs/background/papers.md.

    python benchmarks/papers.py      writes that column anew

A row in which *ours* differs from the printed number says why, as does one whose method is not implemented.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.calibrations import bench, budget
from compasslib.calibrations.swing import adjustment
from compasslib.deviation.model import MIN_HORIZONTAL_NT
from compasslib.deviation.series import series_deviation, series_folds

PAGE = Path(__file__).resolve().parents[1] / "docs/background/papers.md"
HEAD = "| place | what | where | held by | printed | ours |"
# The published readings.
DELTA = dict(zip(adjustment.POINTS, (-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123), strict=True))
PSI = dict(zip(adjustment.POINTS, (-1.312, 2.888, -7.512, -3.414, 2.485, 15.586, 4.489, 14.988), strict=True))
COURSES, DECLINATION = (0, 46, 91, 136, 179, 226, 269, 315), -0.135
BY_DELTA, BY_PSI = (adjustment.principal_coefficients(*x) for x in ((DELTA, 0.0), (PSI, DECLINATION)))
ROWS_OF = {kind: budget.sources({}, budget.LE_MENN, kind) for kind in (budget.PLATFORM, budget.TILT)}
B_OF_FIG_5 = (0.0, 20.0, 45.0, 57.3, 90.0, 135.0)


def letters(content: dict[str, float], names: str) -> str:
    """Format coefficients to four decimals, without zeros at their end."""
    return ", ".join(f"{name} {round(float(content[name]), 4):g}" for name in names.split())


def quadrants(content: dict[str, dict[str, float]]) -> str:
    return ", ".join(f"{value:.3f}" for value in content["D_from"].values())


def pseudo() -> str:
    """Compute the pseudo-deviations of MM Table 2 from courses and deviations."""
    recorded = angles.wrap360(45.0 * np.arange(8) - DECLINATION - np.array(list(DELTA.values())))
    return ", ".join(f"{x:.3f}" for x in adjustment.pseudo_deviations(COURSES, recorded).values())


def ours() -> dict[str, str]:
    """Compute all numbers, by the beginning of what their row says."""
    return {
        "expanded uncertainty of reference directions": f"{budget.expanded(ROWS_OF[budget.PLATFORM]):.2f}",
        "60 to 75 nT across 22,000 nT as angles":
            " to ".join(f"{x:.2f}" for x in budget.physical_field(ROWS_OF[budget.PLATFORM])["field_deg"]),
        "triangular distribution of a maker's accuracy": f"√{budget.TRIANGULAR[0] ** 2:.0f}",
        "expanded uncertainty of reference tilts": f"{budget.expanded(ROWS_OF[budget.TILT]):.2f}",
        "power by which an object's influence falls with distance": f"{bench.DIPOLE:.0f}",
        "no correction below this horizontal field": f"{MIN_HORIZONTAL_NT:.0f}",
        "largest error of D and E at S/d = 7": f"{float(adjustment.error_bound_deg(1 / 7)):.3f}",
        "coefficients from deviations": letters(BY_DELTA, "A B_bar C_bar E D"),
        "pseudo-deviations from N to NW": pseudo(),
        "coefficients from pseudo-deviations, degrees": letters(BY_PSI, "A_bar A B_bar C_bar D E"),
        "A, D and E by courses minus those by headings": ", ".join(f"{BY_PSI[k] - BY_DELTA[k]:.2f}" for k in "ADE"),
        "D by quadrant from deviations": quadrants(BY_DELTA),
        "the same from pseudo-deviations": quadrants(BY_PSI),
        "what the drift leaves there": f"up to {adjustment.drift_in_one_heading(1 / 7, 40.0)['largest_deg']:.1f}",
        "table every 10 or 15°; limit of 4°": f"{adjustment.LIMIT_DEG:g}",
        "least speed": f"{adjustment.MIN_SPEED_KN:g}",
        "recorded direction at a correct heading of 90°":
            ", ".join(f"{90.0 - float(series_deviation((0.0, b, 0.0, 0.0, 0.0), 90.0)):g}" for b in B_OF_FIG_5),
        "largest B without a fold":
            f"{next(b for b in np.arange(50.0, 70.0, 0.01) if series_folds((0.0, b, 0.0, 0.0, 0.0))):.1f}",
    }  # fmt: skip


def rows() -> list[list[str]]:
    """Read the cells of all rows of the page's tables."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| ") and line != HEAD]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def filled() -> str:
    """Return the page with its last column written anew."""
    made, lines = ours(), PAGE.read_text().splitlines(keepends=True)
    for what, number in made.items():
        (k,) = (k for k, line in enumerate(lines) if line.startswith("| ") and line.split(" | ")[1].startswith(what))
        lines[k] = f"{lines[k].rpartition(' | ')[0]} | {number} |\n"
    return "".join(lines)


if __name__ == "__main__":
    PAGE.write_text(filled())
