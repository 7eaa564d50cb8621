"""``compass correct``: one mooring in this process, without Snakemake."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from compasslib.cli import gathered
from compasslib.pipeline.process import process_mooring


def run(asked: Namespace) -> int:
    """Correct a mooring, saying on stderr what each stage found and the warnings last; print where the results are.

    Args:
        asked: ``cruise``, ``mooring`` and ``into``, the folder of the results or None.

    Raises:
        InputError: a mistake in the cruise, a raw file that cannot be read, or a folder that is there already.
    """
    folder = Path(asked.into or Path(asked.cruise) / "corrected" / asked.mooring)
    warnings: list[str] = []

    def say(text: str) -> None:
        lines, more = gathered.apart(text)
        warnings.extend(more)
        print(*lines, sep="\n", file=sys.stderr, flush=True)

    process_mooring(asked.cruise, asked.mooring, folder, say)
    gathered.tell(warnings)
    print(folder)
    return 0
