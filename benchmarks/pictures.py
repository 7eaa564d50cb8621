"""Redraw the pictures of README and docs, which docs/gallery.md shows with the command of each.

python benchmarks/pictures.py                  all of them, about ten minutes
python benchmarks/pictures.py power papers    those of these makers
python benchmarks/pictures.py --from CRUISE demonstration    from a cruise that has been run already
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from PIL import Image
from runs import PROJECT, cost, snakemake

DOCS = PROJECT / "docs"


def copy(figures: Path, **pictures: str) -> None:
    """Copy figures of a folder by their names to pictures of the documentation."""
    for name, picture in pictures.items():
        shutil.copyfile(figures / f"{name}.png", DOCS / picture)


def demonstration(cruise: Path) -> None:
    """Copy figures of EG4, and combine those of its currents side by side into one."""
    figures = cruise / "results/EG4/figures"
    copy(figures, **{name: f"eg4_{name}.png" for name in ("deviation", "scatter", "section")})
    images = [Image.open(figures / f"{name}.png") for name in ("sticks", "progressive", "roses")]
    whole = Image.new("RGB", (sum(one.width for one in images), max(one.height for one in images)), "white")
    for k, one in enumerate(images):
        whole.paste(one, (sum(earlier.width for earlier in images[:k]), 0))
    whole.save(DOCS / "currents.png", compress_level=9)


def pages(cruise: Path) -> None:
    """Take the top of the report, and EG4 in the page of the series, as Chromium shows them; left if there is none."""
    from tests.world import browser

    if browser.program():
        with tempfile.TemporaryDirectory() as folder, browser.chromium(Path(folder)) as chromium:
            chromium.open(cruise / "results/report.html", 1200, 1500)
            chromium.picture(DOCS / "report.png", whole=False)
            chromium.open(cruise / "results/explore.html", 1200, 1130)
            chromium.ask("choose('EG4')")
            chromium.picture(DOCS / "explore.png", whole=False)


def tutorial(cruise: Path) -> None:
    names = ("sticks", "deviation", "scatter")
    copy(cruise / "results/EG4/figures", **{name: f"tutorial/{name}.png" for name in names})


def redeployed(cruise: Path) -> None:
    copy(cruise / "results/compasses/wh8104/figures", coefficients="redeployed.png")


def concealed(cruise: Path) -> None:
    """Take the diagnosis of C1 and draw its heading errors, on the axis that all concealed moorings share."""
    from compasslib.archive.files import read_json
    from compasslib.plots.diagnosis import draw_errors, error_reach
    from compasslib.stages.demonstration import heading_errors

    copy(cruise / "results/C1/figures", diagnosis="diagnosis.png")
    truths = {path.stem: read_json(path) for path in sorted((cruise / "concealed").glob("*.json"))}
    errors = {name: heading_errors(truth, cruise / "results" / name) for name, truth in truths.items()}
    reach = error_reach([error for each in errors.values() for error in (each.fit_deg, each.corrected_deg)])
    dates, c1 = [cause["date"] for cause in truths["C1"]["planted"]], errors["C1"]
    picture = DOCS / "concealed_errors.png"
    draw_errors(picture, c1.time_s, c1.fit_deg, c1.corrected_deg, c1.sigma_deg, dates, reach)


def papers(_: None) -> None:
    from benchmarks import papers

    papers.draw_angles(DOCS / "angles.png")
    papers.draw_synthetic_curves(DOCS / "synthetic.png")


def power(_: None) -> None:
    import power as measured

    measured.draw(json.loads(measured.KEPT.read_text()), DOCS / "power.png")


# With the cruise to run first, relative to the project; that of the tutorial is made by hand.
MAKERS: dict[str, tuple[Callable[..., None], str]] = {
    "demonstration": (demonstration, "."),
    "pages": (pages, "."),
    "tutorial": (tutorial, "given"),
    "redeployed": (redeployed, "examples/redeployed"),
    "concealed": (concealed, "."),
    "papers": (papers, ""),
    "power": (power, ""),
}


def run(cruise: str, folder: Path) -> Path:
    """Run a cruise of the project in a folder of its own."""
    source = PROJECT / cruise
    for name in ("config", "raw"):
        if (source / name).exists():
            shutil.copytree(source / name, folder / name)
    if (source / "make.py").exists():
        subprocess.run([sys.executable, source / "make.py", folder], check=True)
    profile = ("--workflow-profile", PROJECT / "workflow/profiles/default")
    cost(snakemake(folder, *profile, cores=os.cpu_count()), date=None)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("makers", nargs="*", help=f"of {', '.join(MAKERS)}; all where none is named")
    parser.add_argument("--from", dest="cruise", type=Path, help="a cruise that has been run already, of one maker")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ready: dict[str, Path | None] = {"": None}
        for name in asked.makers or MAKERS:
            make, cruise = MAKERS[name]
            if cruise == "given" and not asked.cruise:
                print(f"{name}: left as it is, its cruise is not given: --from CRUISE {name}")
                continue
            if cruise not in ready:
                ready[cruise] = asked.cruise or run(cruise, Path(tempfile.mkdtemp(dir=folder)))
            make(ready[cruise])
            print(f"{name}: drawn")


if __name__ == "__main__":
    main()
