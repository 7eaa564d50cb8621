"""The pictures of the README and of docs, made by the code that they describe.

    python benchmarks/pictures.py            after make run
    python benchmarks/pictures.py CRUISE     those of the tutorial, of its cruise once run

docs/currents.png shows the currents of EG4 of the demonstration cruise before and after, docs/eg4_deviation.png and
docs/eg4_scatter.png are other figures of it; docs/diagnosis.png is the diagnosis of a simulated year with two effects,
drawn by the workflow's own code. The picture of the page is made by benchmarks/report.py --picture docs/report.png.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from compasslib.plots import diagnosis
from compasslib.simulation import draw
from compasslib.simulation.sealed import Wish
from compasslib.stages import pipeline

PROJECT = Path(__file__).resolve().parents[1]
CURRENTS = ("sticks", "progressive", "roses")
OF_EG4 = {"deviation.png": "eg4_deviation.png", "scatter.png": "eg4_scatter.png"}
OF_TUTORIAL = ("sticks", "progressive", "deviation", "scatter")
LEFT_OUT = {"temperature": 2.5, "sextantal": 2.0}  # visible degrees, rms


def of_tutorial(cruise: Path) -> None:
    """Copy the figures of the tutorial's mooring."""
    for name in OF_TUTORIAL:
        shutil.copyfile(cruise / f"results/E1/figures/{name}.png", PROJECT / f"docs/tutorial/{name}.png")


def main() -> None:
    """Copy the demonstration's figures, and draw a diagnosis."""
    for name, kept in OF_EG4.items():
        shutil.copyfile(PROJECT / "results/EG4/figures" / name, PROJECT / "docs" / kept)
    beside(PROJECT / "docs/currents.png", [PROJECT / f"results/EG4/figures/{name}.png" for name in CURRENTS])
    with tempfile.TemporaryDirectory() as folder:
        one = draw.Sealed("D1", LEFT_OUT, wish=Wish(wide=True), seed=4)
        cruise, _ = draw.write_alone(one, Path(folder))
        made = pipeline.process(cruise, "D1", Path(folder) / "results", print)
        found = json.loads((made / "diagnosis.json").read_text())
        diagnosis.of_mooring(PROJECT / "docs/diagnosis.png", found)


def beside(path: Path, figures: Sequence[Path]) -> None:
    """Put figures side by side into one."""
    images = [Image.open(figure) for figure in figures]
    whole = Image.new("RGB", (sum(one.width for one in images), max(one.height for one in images)), "white")
    for k, one in enumerate(images):
        whole.paste(one, (sum(earlier.width for earlier in images[:k]), 0))
    whole.save(path, compress_level=9)


if __name__ == "__main__":
    of_tutorial(Path(sys.argv[1])) if len(sys.argv) > 1 else main()
