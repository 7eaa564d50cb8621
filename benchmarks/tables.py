"""Tables as people have them, by name and drawn by seed: read right, refused by the key that settles it, or wrong.

Then genuine files by formats that are not theirs: is the right one named?

python benchmarks/tables.py [SEED] [N]
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import tables
from sea import SHARED

from compasslib import readers
from compasslib.core.errors import InputError
from compasslib.readers import TABLE_KEYS

GENUINE = {
    "pd0/adp_12.000": "pd0",
    "moored/aqd9330.aqd": "nortek",
    "moored/papa_node59p1.dat": "pd12",
    "acm/mmp_global_A0000001.DAT": "mmp_acm",
    "acm/mmp_global_A0000001.TXT": "mmp_acm",
    "cruise_eh2/raw/E0/deep.csv": "table",
    "vectors.json": "",  # none reads it
}
FORMATS = ("pd0", "nortek", "pd12", "mmp_acm", "table", "netcdf", "rdi_text")


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


def wrong_formats() -> None:
    """Print what is said of genuine files that are read by a format which is not theirs."""
    lines = []
    for name, right in GENUINE.items():
        for form in FORMATS:
            if form == right or not (path := SHARED / name).is_file():
                continue
            settings = {"columns": {"time": "t", "east": "u", "north": "v"}, "orientation": "up"}
            settings |= {"bin_size": 1.0, "first_bin": 1.0, "direction_reference": "magnetic"}
            try:
                readers.read(form, [path], settings)
                lines.append((False, f"{name} as {form}: READ"))
            except InputError as error:
                lines.append((f"write format: {right}" in str(error) or right == "", str(error)))
    for told, line in lines:
        print(" " if told else "!", line.removeprefix(str(SHARED))[:170])
    print(f"{len(lines)} wrong formats: {sum(told for told, _ in lines)} name the right one")


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
        wrong_formats()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
