"""Write raw files of demonstration moorings into a folder: ``python -m compasslib.demo exports EG4``."""

from __future__ import annotations

import sys
from pathlib import Path

from compasslib.demo.demonstration import write_mooring


def main(folder: str, *names: str) -> None:
    """Write raw files of moorings into a folder, and true headings into the folder truth next to it."""
    for name in names:
        write_mooring(name, folder, Path(folder).absolute().parent / f"truth/{name}.csv")


if __name__ == "__main__":
    main(*sys.argv[1:])
