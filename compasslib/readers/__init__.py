"""One file a raw format; this table says which. A reader is imported only by the job that needs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the Snakefile needs the table only
    from compasslib.core.records import Record

# format in the mooring file -> (module, the keys of the instrument that its read() takes)
FORMATS: dict[str, tuple[str, tuple[str, ...]]] = {
    "pd0": ("pd0.reader", ("orientation", "declination_applied", "heading_alignment", "serial_number")),
    "table": ("table", ("columns",)),
    "acm_table": ("table", ("columns",)),
    "mmp_acm": ("mmp.acm", ("pressure_files", "start_offset_seconds")),
}


def read(form: str, paths: Sequence[Path], settings: Mapping[str, Any]) -> Record:
    """Return what an instrument recorded, by its own clock, nothing left out.

    Args:
        form: a key of ``FORMATS``.
        paths: raw files in order.
        settings: the instrument's part of the mooring file.

    Raises:
        InputError: a file that cannot be read.
    """
    module, keys = FORMATS[form]
    reader = import_module(f"compasslib.readers.{module}")
    record: Record = reader.read(paths, **{key: settings.get(key) for key in keys})
    return record
