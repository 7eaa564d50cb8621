"""Write raw files of demonstration moorings into a folder: ``python -m compasslib.demo exports EG4``.

The true headings are written into the folder truth next to it.
"""

import sys
from pathlib import Path

from compasslib.demo.demonstration import write_mooring

if __name__ == "__main__":
    folder, *names = sys.argv[1:]
    for name in names:
        write_mooring(name, folder, Path(folder).absolute().parent / f"truth/{name}.csv")
