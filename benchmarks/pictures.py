"""Redraw the pictures of README and docs.

    python benchmarks/pictures.py                  all of them, about ten minutes
    python benchmarks/pictures.py sea papers    those of these makers
    python benchmarks/pictures.py --from CRUISE demonstration    from a cruise that has been run already

docs/pictures.json contains the SHA-256 of each picture and of the code that draws it; tests/test_docs.py compares both.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

PROJECT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PROJECT))

from benchmarks.proof.seal import statements  # noqa: E402

DOCS, RECORD = PROJECT / "docs", PROJECT / "docs/pictures.json"
CURRENTS = ("sticks", "progressive", "roses")
DRAWN = ("page",)  # modules of plots used by all figures of a mooring


@dataclass(frozen=True)
class Maker:
    """Function that draws some of the pictures, and what it depends on."""

    make: Callable[[Path], None]  # draws from the folder of a cruise that was run, or from an empty one
    pictures: Sequence[str]  # relative to docs
    code: Sequence[str]  # patterns of the files that draw them, relative to the project
    cruise: str = ""  # folder of the cruise to run first, relative to the project


def demonstration(cruise: Path) -> None:
    """EG4 of the demonstration cruise before and after, and the top of the report."""
    figures = cruise / "results/EG4/figures"
    beside(DOCS / "currents.png", [figures / f"{name}.png" for name in CURRENTS])
    for name in ("deviation", "scatter", "section"):
        shutil.copyfile(figures / f"{name}.png", DOCS / f"eg4_{name}.png")


def report(cruise: Path) -> None:
    """The top of the demonstration's report, as Chromium shows it."""
    sys.path.insert(0, str(PROJECT / "tests"))
    import browser

    with tempfile.TemporaryDirectory() as folder, browser.chromium(Path(folder)) as chromium:
        chromium.open(cruise / "results/report.html", 1200, 1500)
        chromium.picture(DOCS / "report.png", whole=False)


def tutorial(cruise: Path) -> None:
    """The mooring of the tutorial."""
    for name in ("sticks", "deviation", "scatter"):
        shutil.copyfile(cruise / f"results/EG4/figures/{name}.png", DOCS / f"tutorial/{name}.png")


def redeployed(cruise: Path) -> None:
    """One compass by all its records."""
    shutil.copyfile(cruise / "results/compasses/wh8104/figures/coefficients.png", DOCS / "redeployed.png")


def concealed(cruise: Path) -> None:
    """The diagnosis of C1 and its heading errors, with the page that explains them."""
    import walkthrough

    shutil.copyfile(cruise / "results/C1/figures/diagnosis.png", DOCS / "diagnosis.png")
    walkthrough.collect(cruise, DOCS / "concealed_errors.png")


def sea(folder: Path) -> None:
    """Water between bins."""
    import sea as measured

    measured.draw(measured.profiles(), DOCS / "sea.png")


def papers(folder: Path) -> None:
    """Figures 4 and 5 of von Appen 2015."""
    from compasslib.plots import moorings

    moorings.draw_angles(DOCS / "angles.png")
    moorings.draw_synthetic_curves(DOCS / "synthetic.png")


COMMAND = ".venv/bin/python benchmarks/pictures.py "
BY_HAND = {"tutorial": f"{COMMAND}--from CRUISE tutorial    # the cruise of the tutorial"}


def plots(*names: str) -> list[str]:
    """List the modules of plots that draw figures of a mooring."""
    return [f"compasslib/plots/{name}.py" for name in (*DRAWN, *names)]


MAKERS = {
    "demonstration": Maker(
        demonstration,
        ("currents.png", "eg4_deviation.png", "eg4_scatter.png", "eg4_section.png"),
        [*plots("timeseries", "deviation"), "compasslib/demo/demonstration.py"],
        cruise=".",
    ),
    "report": Maker(
        report, ("report.png",), ["compasslib/report/templates/*", "compasslib/report/chart.py"], cruise="."
    ),
    "tutorial": Maker(
        tutorial,
        [f"tutorial/{name}.png" for name in ("sticks", "deviation", "scatter")],
        plots("timeseries", "deviation"),
    ),
    "redeployed": Maker(
        redeployed,
        ("redeployed.png",),
        [*plots("deviation"), "tests/world/redeployed.py", "examples/redeployed/config/**/*.yaml"],
        cruise="examples/redeployed",
    ),
    "concealed": Maker(
        concealed,
        ("diagnosis.png", "concealed_errors.png"),
        [*plots("diagnosis", "truth"), "compasslib/demo/concealed.py"],
        cruise=".",
    ),
    "papers": Maker(
        papers, ("angles.png", "synthetic.png"), ["compasslib/plots/page.py", "compasslib/plots/moorings.py"]
    ),
    "sea": Maker(sea, ("sea.png",), ["compasslib/plots/page.py", "benchmarks/sea.py"]),
}


def code(patterns: Iterable[str]) -> str:
    """Compute one SHA-256 of files, regardless of comments, docstrings and formatting of Python files.

    Raises:
        FileNotFoundError: if a pattern matches no file.
    """
    whole = hashlib.sha256()
    for pattern in patterns:
        files = sorted(PROJECT.glob(pattern))
        if not files:
            raise FileNotFoundError(f"benchmarks/pictures.py: no file {pattern} in the project")
        for path in files:
            whole.update(statements(path.read_text()).encode() if path.suffix == ".py" else path.read_bytes())
    return whole.hexdigest()


def record(maker: Maker) -> dict[str, dict[str, str]]:
    """Compute the hashes of a maker's pictures and of the code that draws them."""
    drawn = code(maker.code)
    return {
        name: {"picture": hashlib.sha256((DOCS / name).read_bytes()).hexdigest(), "code": drawn}
        for name in maker.pictures
    }


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


def beside(path: Path, figures: Sequence[Path]) -> None:
    """Combine figures side by side into one."""
    images = [Image.open(figure) for figure in figures]
    whole = Image.new("RGB", (sum(one.width for one in images), max(one.height for one in images)), "white")
    for k, one in enumerate(images):
        whole.paste(one, (sum(earlier.width for earlier in images[:k]), 0))
    whole.save(path, compress_level=9)


def gallery() -> str:
    """Compose the page of all pictures, each with the command that draws it."""
    lines = ["# Gallery", "", "The pictures of these pages, each with the command of a checkout that draws it."]
    for name, maker in MAKERS.items():
        title, command = str(maker.make.__doc__).split(".")[0], BY_HAND.get(name, COMMAND + name)
        lines += ["", f"## {title}", "", f"    {command}"]
        lines += [line for picture in maker.pictures for line in ("", f"![{Path(picture).stem}]({picture})")]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Draw pictures and record their hashes."""
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
            known = json.loads(RECORD.read_text()) if RECORD.exists() else {}
            RECORD.write_text(json.dumps(known | record(maker), indent=1, sort_keys=True) + "\n")
            (DOCS / "gallery.md").write_text(gallery())
            print(f"{name}: {', '.join(maker.pictures)}")


if __name__ == "__main__":
    main()
