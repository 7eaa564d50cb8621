"""Raw files to records: one module or package a format, and a table that says which.

A reader is imported only by the job that needs it. Every sample is kept, by the instrument's own clock:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib import readers
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "meter.csv")
...     _ = path.write_text("t,u,v\\n2007-09-04T00:00:00Z,0.10,0.00\\n2007-09-04T01:00:00Z,,0.20\\n")
...     record = readers.read("table", [path], {"columns": {"time": "t", "east": "u", "north": "v"}})
>>> record.time_s[0], record.east.tolist(), record.quality.ravel().tolist()
(np.float64(1188864000.0), [[0.1], [nan]], [1, 9])
>>> readers.FORMATS["pd0"].takes_declination
True
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib.readers import recognition

if TYPE_CHECKING:  # the Snakefile needs the table only
    from compasslib.core.records import Record


@dataclass(frozen=True)
class Format:
    """A raw format: the module that reads it, and the keys of the instrument that its ``read`` takes."""

    module: str  # below compasslib.readers
    keys: tuple[str, ...]

    @property
    def takes_declination(self) -> bool:
        """Whether the reader itself takes an applied declination out, as the file may tell it too (heading bias)."""
        return "declination_applied" in self.keys


TABLE_KEYS = ("delimiter", "decimal", "time_format", "timezone", "missing", "skip_rows")  # of any text table
FORMATS = {
    "pd0": Format("pd0.reader", ("orientation", "declination_applied", "heading_alignment", "serial_number")),
    "table": Format("table", ("columns", *TABLE_KEYS)),
    "acm_table": Format("table", ("columns", *TABLE_KEYS)),
    "mmp_acm": Format("mmp.acm", ("pressure_files", "start_offset_seconds", *TABLE_KEYS)),
}


def read(form: str, paths: Sequence[Path], settings: Mapping[str, Any]) -> Record:
    """Return what an instrument recorded, by its own clock, nothing left out.

    Args:
        form: a key of ``FORMATS``.
        settings: the instrument's part of the mooring file.

    Raises:
        InputError: a file that cannot be read.
    """
    found = FORMATS[form]
    reader = import_module(f"compasslib.readers.{found.module}")
    with recognition.naming(form, paths, offered=FORMATS):
        record: Record = reader.read(paths, **{key: settings.get(key) for key in found.keys})
    return record
