"""Are the search's thresholds what they claim? How often the highest score of a record without any effect passes them.

    python benchmarks/alarms.py [MOORINGS] [SEED]

The moorings are those of compasslib/simulation/pairs.py, year-long and hourly, their compass fitted to the truth. Both
searches are drawn on: for names among the catalogue, and for what stays unexplained.
"""

from __future__ import annotations

import sys

import discrepancy
import numpy as np

from compasslib.deviation.model import Fit, Noise
from compasslib.search import baseline, columns, scan
from compasslib.search.case import mooring_case
from compasslib.simulation import pairs as sea

NOMINAL = (0.006, 0.02, 0.05, 0.1, 0.5)
NOISE = Noise(floor_deg=5.0, slow_deg_m_s=2.0, outliers=0.01, compass_deg=1.0)


def passed(index: int, seed: int) -> list[list[bool]]:
    """Return for names and for what is unexplained which thresholds the highest score of one mooring passes."""
    drawn, _ = discrepancy.draw("null", index, seed)
    _, coefficients = sea.five_term_residual(drawn.pairs.heading_deg, drawn.heading)
    fit = Fit("exact", len(drawn.pairs), coefficients, heading_density=np.full(120, 1 / 120), noise=NOISE)
    case = mooring_case(drawn.pairs, drawn.covariates, fit, discrepancy.field_of(drawn))
    state = baseline.examine(case, case.simulation, np.zeros(case.nuisance.shape[1]))
    result = []
    for groups, own in ((columns.of_terms(state, case.terms), 1), (columns.omnibus(state), 99)):
        tested = scan.test(state, groups, seed=own)
        result.append([bool(tested.score.max() > tested.threshold(alarm)) for alarm in NOMINAL])
    return result


def main(count: int, seed: int) -> None:
    shares = np.mean([passed(index, seed) for index in range(count)], axis=0)
    print(f"{count} moorings without any effect, seed {seed}\n\n| threshold for | names | unexplained |\n|---|---|---|")
    for alarm, name, left in zip(NOMINAL, *shares, strict=True):
        print(f"| {100 * alarm:.1f} % | {100 * name:.1f} % | {100 * left:.1f} % |")


if __name__ == "__main__":
    main(*(int(x) for x in (sys.argv[1:] + ["100", "1"][len(sys.argv) - 1 :])))
