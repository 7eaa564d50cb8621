"""Tables as people have them, by name and drawn by seed: read right, refused by the key that settles it, or wrong.

python benchmarks/tables.py [SEED] [N]
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import tables

from compasslib import readers
from compasslib.core.errors import InputError
from compasslib.readers import TABLE_KEYS


def outcome(path: Path, form: tables.Form) -> str:
    """Return what becomes of one table, and the reader's own line where it is refused."""
    truth, settings = tables.write(path, form)
    try:
        record = readers.read("table", [path], settings)
    except InputError as error:
        line = str(error).removeprefix(str(path))
        named = any(f"{key}:" in line for key in TABLE_KEYS)
        return f"{'refused by its key' if named else 'refused without a key'}{line}"
    same = len(record.time_s) == len(truth.time_s) and np.abs(record.time_s - truth.time_s).max() < tables.SURE_S
    off = [np.abs(found[:, 0] - known) for found, known in ((record.east, truth.east), (record.north, truth.north))]
    right = same and all(np.nanmax(x) < 1e-9 and np.isnan(x).sum() == np.isnan(truth.east).sum() for x in off)
    return "right" if right else "WRONG"


def main(seed: int = 1, n: int = 40) -> None:
    """Print each table's outcome, and how many there are of each kind."""
    forms = {**tables.VARIANTS, **tables.drawn(seed, n)}
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for name, form in forms.items():
            found = outcome(Path(folder, "table.csv"), form)
            counts[found.split(":")[0].split(", ")[0].split(" line")[0]] += 1
            print(f"{name:32s} {found[:150]}")
    print(f"{len(forms)} tables: " + ", ".join(f"{k} {what}" for what, k in counts.items()))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
