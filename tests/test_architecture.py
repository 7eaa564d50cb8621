"""Would catch an import upwards or in a ring, angle arithmetic outside its modules, unequal pins, a long module."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
LIBRARY = sorted((PROJECT / "compasslib").rglob("*.py"))
# Subpackages from the lowest up: each may import from itself and from those before it.
# "ground" are the modules of the top level.
ROOMS = [
    "ground", "statistics", "readers", "preparation", "effects", "deviation", "calibrations", "inference", "product",
    "config", "archive", "plots", "report", "stages", "pipeline", "cli",
]  # fmt: skip
FLOOR = {room: k for k, room in enumerate(ROOMS)}
APART = "demo"  # the simulated world: shares angles and array types with the library, imported only by stages.read


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in LIBRARY}


def room_of(module: str) -> str:
    room = module.partition(".")[2].partition(".")[0]
    return room if room in FLOOR or room == APART or not room else "ground"


def imports(path: Path) -> Iterator[str]:
    """Yield the modules of the library that a file imports anywhere, except for type checking."""
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
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "compasslib":
            inner = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in MODULES else str(node.module) for name in inner)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)


@cache
def imported() -> dict[str, set[str]]:
    """Collect the modules that each module imports: at a test, since every process of the tests reads this file."""
    return {name: set(imports(path)) - {name} for name, path in MODULES.items()}


HOUSE = {name: path for name, path in MODULES.items() if room_of(name) not in ("", APART)}


@pytest.mark.parametrize("module", HOUSE)
def test_subpackages_import_only_from_lower_ones(module):
    own = room_of(module)
    assert own in FLOOR, f"{own} has no floor yet: add it to ROOMS"
    upward = {other for other in imported()[module] if room_of(other) and FLOOR.get(room_of(other), 99) > FLOOR[own]}
    upward -= {other for other in upward if room_of(other) == APART and module == "compasslib.stages.read"}
    assert not upward, f"{module} imports {upward} from a floor above"


def test_imports_have_no_cycles():
    left = {name: {other for other in others if other in MODULES} for name, others in imported().items()}
    while free := {name for name, others in left.items() if not others & left.keys()}:
        left = {name: others for name, others in left.items() if name not in free}
    assert not left, f"rings among {sorted(left)}"


def test_simulated_world_shares_only_angles_and_array_types_with_the_library():
    for module, others in imported().items():
        if room_of(module) == APART:
            shared = {other for other in others if room_of(other) != APART}
            assert shared <= {"compasslib.angles", "compasslib.types"}, module


def test_angles_matplotlib_and_addresses_stay_where_they_belong_and_modules_short():
    for module, path in HOUSE.items():
        text = path.read_text()
        assert text.count("\n") <= 500, path
        turns = re.search(r"%\s*360|\bdeg2rad\(|\bradians\(|np\.mod\(", text)
        assert path.name in ("angles.py", "compass.py") or not turns, path
        assert room_of(module) == "plots" or not re.search(r"(?m)^\s*(import|from) matplotlib", text), path
    for path in (PROJECT / "requirements").glob("*.txt"):
        assert not re.search(r"https?://|--index|--find-links|@ ", path.read_text()), path


def test_no_test_imports_another():
    for path in (PROJECT / "tests").rglob("test_*.py"):
        assert not re.search(r"^\s*(from|import) (tests\.(?!world)|test_)", path.read_text(), re.MULTILINE), path


def test_requirement_files_pin_equal_versions():
    run, test, docs = (
        dict(re.findall(r"^([\w.-]+)==(\S+)", (PROJECT / f"requirements/{kind}.txt").read_text(), re.MULTILINE))
        for kind in ("run", "test", "docs")
    )
    assert run.items() <= test.items() and run.items() <= docs.items()
    assert all(docs[name] == test[name] for name in docs.keys() & test.keys())
