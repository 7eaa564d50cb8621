"""Redraw the pictures of README and docs.

python benchmarks/pictures.py                  all of them, about ten minutes
python benchmarks/pictures.py power papers    those of these makers
python benchmarks/pictures.py --from CRUISE demonstration    from a cruise that has been run already
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

PROJECT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PROJECT))

DOCS = PROJECT / "docs"


@dataclass(frozen=True)
class Maker:
    """Some of the pictures, and how they are drawn."""

    title: str
    copied: Mapping[str, str] = field(default_factory=dict)  # pictures, relative to docs, of results of a cruise
    drawn: Sequence[str] = ()  # pictures drawn by ``draw`` from the folder of a cruise that was run, or an empty one
    draw: Callable[[Path], None] | None = None
    cruise: str = ""  # folder of the cruise to run first, relative to the project

    @property
    def pictures(self) -> list[str]:
        return [*self.drawn, *self.copied]

    def make(self, cruise: Path) -> None:
        """Make the pictures from a cruise that was run."""
        for picture, result in self.copied.items():
            shutil.copyfile(cruise / "results" / result, DOCS / picture)
        if self.draw is not None:
            self.draw(cruise)


def beside(cruise: Path) -> None:
    """Combine figures of the currents of EG4 side by side into one."""
    images = [Image.open(cruise / f"results/EG4/figures/{name}.png") for name in ("sticks", "progressive", "roses")]
    whole = Image.new("RGB", (sum(one.width for one in images), max(one.height for one in images)), "white")
    for k, one in enumerate(images):
        whole.paste(one, (sum(earlier.width for earlier in images[:k]), 0))
    whole.save(DOCS / "currents.png", compress_level=9)


def report(cruise: Path) -> None:
    from tests.world import browser

    with tempfile.TemporaryDirectory() as folder, browser.chromium(Path(folder)) as chromium:
        chromium.open(cruise / "results/report.html", 1200, 1500)
        chromium.picture(DOCS / "report.png", whole=False)


def concealed(cruise: Path) -> None:
    """Take the diagnosis of C1 and draw its heading errors, on the axis that all concealed moorings share."""
    from compasslib.archive.files import read_json
    from compasslib.plots.diagnosis import draw_errors, error_reach
    from compasslib.stages.demonstration import heading_errors, read_headings

    shutil.copyfile(cruise / "results/C1/figures/diagnosis.png", DOCS / "diagnosis.png")
    truths = {path.stem: read_json(path) for path in sorted((cruise / "concealed").glob("*.json"))}
    errors = {name: heading_errors(truth, read_headings(cruise / "results" / name)) for name, truth in truths.items()}
    reach = error_reach([error for each in errors.values() for error in (each.fit_deg, each.corrected_deg)])
    dates, c1 = [cause["date"] for cause in truths["C1"]["planted"]], errors["C1"]
    picture = DOCS / "concealed_errors.png"
    draw_errors(picture, c1.time_s, c1.fit_deg, c1.corrected_deg, c1.sigma_deg, dates, reach)


def power(folder: Path) -> None:
    import power as measured

    measured.draw(json.loads(measured.KEPT.read_text()), DOCS / "power.png")


def papers(folder: Path) -> None:
    from benchmarks import papers

    papers.draw_angles(DOCS / "angles.png")
    papers.draw_synthetic_curves(DOCS / "synthetic.png")


COMMAND = ".venv/bin/python benchmarks/pictures.py "
BY_HAND = {"tutorial": f"{COMMAND}--from CRUISE tutorial    # the cruise of the tutorial"}
MAKERS = {
    "demonstration": Maker(
        "EG4 of the demonstration cruise before and after",
        {f"eg4_{name}.png": f"EG4/figures/{name}.png" for name in ("deviation", "scatter", "section")},
        ("currents.png",), beside, cruise=".",
    ),
    "report": Maker(
        "The top of the demonstration's report, as Chromium shows it", drawn=("report.png",), draw=report, cruise="."
    ),
    "tutorial": Maker(
        "The mooring of the tutorial",
        {f"tutorial/{name}.png": f"EG4/figures/{name}.png" for name in ("sticks", "deviation", "scatter")},
    ),
    "redeployed": Maker(
        "One compass by all its records",
        {"redeployed.png": "compasses/wh8104/figures/coefficients.png"}, cruise="examples/redeployed",
    ),
    "concealed": Maker(
        "The diagnosis of C1 and its heading errors",
        drawn=("diagnosis.png", "concealed_errors.png"), draw=concealed, cruise=".",
    ),
    "papers": Maker("Figures 4 and 5 of von Appen 2015", drawn=("angles.png", "synthetic.png"), draw=papers),
    "power": Maker("Power of the search", drawn=("power.png",), draw=power),
}  # fmt: skip


def run(cruise: str, folder: Path) -> Path:
    """Run a cruise of the project in a folder of its own."""
    source = PROJECT / cruise
    for name in ("config", "raw"):
        if (source / name).exists():
            shutil.copytree(source / name, folder / name)
    if (source / "make.py").exists():
        subprocess.run([sys.executable, source / "make.py", folder], check=True)
    snakemake = [sys.executable, "-P", "-m", "snakemake", "--workflow-profile", PROJECT / "workflow/profiles/default"]
    snakemake += ["--snakefile", PROJECT / "Snakefile", "--directory", folder, "--cores", "all"]
    subprocess.run(snakemake, check=True, env=os.environ | {"PYTHONPATH": str(PROJECT), "OMP_NUM_THREADS": "1"})
    return folder


def gallery() -> str:
    """Compose the page of all pictures, each with the command that draws it."""
    lines = ["# Gallery", "", "The pictures of these pages, each with the command of a checkout that draws it."]
    for name, maker in MAKERS.items():
        lines += ["", f"## {maker.title}", "", f"    {BY_HAND.get(name, COMMAND + name)}"]
        lines += [line for picture in maker.pictures for line in ("", f"![{Path(picture).stem}]({picture})")]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Draw pictures, and write the gallery."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("makers", nargs="*", help=f"of {', '.join(MAKERS)}; all where none is named")
    parser.add_argument("--from", dest="cruise", type=Path, help="a cruise that has been run already, of one maker")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ready: dict[str, Path] = {}
        for name in asked.makers or MAKERS:
            maker, own = MAKERS[name], Path(folder) / name
            own.mkdir()
            if name == "report" and not shutil.which("chromium"):
                print("report: left as it is, there is no Chromium")
                continue
            if name == "tutorial" and not asked.cruise:
                print("tutorial: left as it is, its cruise is not given: --from CRUISE tutorial")
                continue
            if asked.cruise or not maker.cruise:
                ready[maker.cruise] = asked.cruise or own
            maker.make(ready.get(maker.cruise) or ready.setdefault(maker.cruise, run(maker.cruise, own)))
            (DOCS / "gallery.md").write_text(gallery())
            print(f"{name}: {', '.join(maker.pictures)}")


if __name__ == "__main__":
    main()
