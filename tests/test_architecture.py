"""The house: imports go down the list of rooms, scripts stay thin, angles are turned in one place."""

import ast
import re
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
LIBRARY = sorted((PROJECT / "compasslib").rglob("*.py"))
SCRIPTS = sorted((PROJECT / "workflow/scripts").glob("*.py"))
# From the ground up: a room imports only from its own floor or from floors before it.
FLOORS = [
    ["errors"],
    ["angles", "records"],
    ["readers", "igrf"],
    ["earthfield", "compass", "grid", "plausibility", "orientation", "deployment_clock", "deployment"],
    ["observatory"],
    ["physics"],
    ["overlap", "overlap_clock", "overlap_same", "overlap_words"],
    ["deviation"],
    ["branches"],
    ["correction"],
    ["calibration"],
    ["discrepancy"],
    ["assessment"],
    ["config_values", "config_paths", "config_schema", "config_calibrations", "config_yaml", "config"],
    [
        "archive_files",
        "archive_layout",
        "archive_attributes",
        "archive_product",
        "archive",
        "pictures",
        "archive_calibrations",
    ],
    ["oceansites"],
    [
        "provenance",
        "ledger",
        "stopped",
        "simulated",
        "guard",
        "job",
        "stages",
        "stages_calibrations",
        "stages_cruise",
        "running",
        "summary",
        "crate",
        "verification",
        "conventions",
    ],
    ["report", "pipeline"],
    ["command"],
]
FLOOR = {room: k for k, rooms in enumerate(FLOORS) for room in rooms}
FLOOR |= {path.stem: len(FLOORS) for path in LIBRARY if path.stem.startswith("plots")}


def room_of(path: Path) -> str:
    return path.relative_to(PROJECT / "compasslib").parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Return the rooms of the house that a file imports, type checking apart."""
    rooms: set[str] = set()
    tree = ast.parse(path.read_text())
    skipped = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.ImportFrom) and node.module == "compasslib":
            rooms |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("compasslib."):
            rooms.add(node.module.split(".")[1])
        elif isinstance(node, ast.Import):
            rooms |= {a.name.split(".")[1] for a in node.names if a.name.startswith("compasslib.")}
    return rooms


HOUSE = [path for path in LIBRARY if room_of(path) not in ("__init__", "nature")]


@pytest.mark.parametrize("path", HOUSE, ids=lambda p: str(p.relative_to(PROJECT)))
def test_imports_go_down(path):
    own = room_of(path)
    assert own in FLOOR, f"{own} has no floor yet: add it to FLOORS"
    upward = {room for room in imports(path) if room in FLOOR and FLOOR[room] > FLOOR[own]}
    assert not upward, f"{own} imports {upward} from a floor above"


def test_only_scripts_import_plots_and_nature_and_only_plots_knows_matplotlib():
    for path in LIBRARY:
        own = room_of(path)
        if not own.startswith("plots"):
            assert not any(room.startswith("plots") for room in imports(path)), path
            assert "matplotlib" not in path.read_text(), path
        if own != "nature":
            assert "nature" not in imports(path), path


def test_nature_imports_nothing_of_the_house():
    for path in LIBRARY:
        if room_of(path) == "nature":
            assert imports(path) <= {"nature"}, path


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.name)
def test_scripts_are_thin(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree)
    assert path.read_text().count("\n") <= 22
    assert not any(isinstance(node, ast.FunctionDef | ast.ClassDef | ast.If | ast.While) for node in ast.walk(tree))


def test_angles_are_turned_in_one_place():
    for path in HOUSE:
        if path.name not in ("angles.py", "compass.py"):
            assert not re.search(r"%\s*360|\bdeg2rad\(|\bradians\(|np\.mod\(", path.read_text()), path


def test_no_download_address_and_no_module_too_long():
    for path in HOUSE:
        assert path.read_text().count("\n") <= 500, path
    for path in (PROJECT / "requirements").glob("*.txt"):
        assert not re.search(r"https?://|--index|--find-links|@ ", path.read_text()), path
