"""Tables as people have them, by name and drawn by seed: read right, refused by the key that settles it, or wrong.

Each is read as an instrument's currents, in the instrument's frame, as a series beside it and as a calibration.

Then genuine files by formats that are not theirs: is the right one named?

python benchmarks/tables.py [SEED] [N]
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import tables
from sea import SHARED

from compasslib import readers
from compasslib.errors import InputError
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
    counts: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for name, form in forms.items():
            found = {kind: tables.outcome(Path(folder, "table.csv"), form, kind) for kind in tables.KINDS}
            counts.update((kind, what.partition(":")[0] + _key(what)) for kind, what in found.items())
            alike = len(set(found.values())) == 1
            print(f"{name:36s} {found['table'][:150] if alike else found}")
    for kind in tables.KINDS:
        said = (f"{number} {what}" for (of, what), number in counts.items() if of == kind)
        print(f"{len(forms)} tables as {kind}: {', '.join(said)}")
    wrong_formats()


def _key(outcome: str) -> str:
    named = [key for key in TABLE_KEYS if f"{key}:" in outcome]
    return f" naming {' and '.join(named) or 'no key'}" if outcome.startswith("refused") else ""


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
