"""The README's pictures, made by the code that it describes.

    python benchmarks/pictures.py            after make run

docs/eg4_deviation.png and docs/eg4_scatter.png are those of the demonstration cruise; docs/diagnosis.png is the
diagnosis of a simulated year with two effects, drawn by the workflow's own code.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

from compasslib.plots import diagnosis
from compasslib.simulation import draw
from compasslib.simulation.sealed import Wish
from compasslib.stages import pipeline

PROJECT = Path(__file__).resolve().parents[1]
OF_EG4 = {"deviation.png": "eg4_deviation.png", "scatter.png": "eg4_scatter.png"}
LEFT_OUT = {"temperature": 2.5, "sextantal": 2.0}  # visible degrees, rms


def main() -> None:
    """Copy the demonstration's figures, and draw a diagnosis."""
    for name, kept in OF_EG4.items():
        shutil.copyfile(PROJECT / "results/EG4/figures" / name, PROJECT / "docs" / kept)
    with tempfile.TemporaryDirectory() as folder:
        one = draw.Sealed("D1", "pair", LEFT_OUT, wish=Wish(wide=True), seed=4)
        cruise, _ = draw.write_alone(one, Path(folder))
        made = pipeline.process(cruise, "D1", Path(folder) / "results", print)
        found = json.loads((made / "diagnosis.json").read_text())
        diagnosis.of_mooring(PROJECT / "docs/diagnosis.png", found, "A simulated mooring")


if __name__ == "__main__":
    main()
