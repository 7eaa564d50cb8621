"""Read raw files to records: one module or package per format, listed in a registry that plug-ins can extend.

Readers are imported on demand. Samples with missing values are retained and flagged, timed by the instrument's clock.
Every function raises ``InputError`` for a file, column or key that it cannot use:

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
from dataclasses import dataclass, replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib import plugins
from compasslib.errors import InputError
from compasslib.readers import detect

if TYPE_CHECKING:  # keeps the import light for the Snakefile, which needs only the registry
    from compasslib.records import Record


@dataclass(frozen=True)
class Format:
    """A raw format: the module that reads it, and the settings of an instrument that its ``read`` accepts."""

    module: str  # relative to compasslib.readers; for a plug-in the full name
    keys: tuple[str, ...]  # keyword arguments of ``read``
    plugin: str = ""  # package and version of a plug-in, with a hash of its code

    @property
    def takes_declination(self) -> bool:
        """Whether the reader itself removes an applied declination, which the file may state too (heading bias)."""
        return "declination_applied" in self.keys


TABLE_KEYS = ("delimiter", "decimal", "time_format", "timezone", "missing", "skip_rows", "header", "comment")
COLUMN_KEYS = ("columns", "flags", "direction_reference")
STATED_KEYS = ("columns", "orientation", "declination_applied", "direction_reference")  # what a file may state
FORMATS = {
    "pd0": Format("pd0", ("orientation", "declination_applied", "heading_alignment", "serial_number", "sound_speed")),
    "table": Format("table", (*COLUMN_KEYS, *TABLE_KEYS)),
    "acm_table": Format("table", (*COLUMN_KEYS, *TABLE_KEYS)),
    "mmp_acm": Format("mmp", ("pressure_files", "start_offset_seconds", *TABLE_KEYS)),
    "netcdf": Format("netcdf", (*STATED_KEYS, "heading_alignment", "flags")),
    "rdi_text": Format("rdi_text", ("orientation",)),
    "pd12": Format("pd12", ("orientation", "bin_size", "first_bin")),
    "ocean_contour": Format("netcdf", STATED_KEYS),
    "mat": Format("matlab", (*STATED_KEYS, "time_format")),
    "odv": Format("odv", COLUMN_KEYS),
    "nortek": Format("nortek", ("orientation", "declination_applied", "serial_number")),
}


def format_names() -> tuple[str, ...]:
    """List the names of all formats, those of plug-ins last.

    Raises:
        InputError: a plug-in uses a name that is taken.
    """
    return (*FORMATS, *plugins.plugin_table(plugins.READERS, FORMATS))


def get_format(form: str) -> Format:
    """Look up a format; the keys of a plug-in are the keyword-only parameters of its reader function."""
    if form in FORMATS:
        return FORMATS[form]
    point = plugins.plugin_table(plugins.READERS, FORMATS)[form]
    with plugins.plugin_errors(point, "a function that reads files"):
        parameters = signature(plugins.load_plugin(point)).parameters.values()
    keys = tuple(each.name for each in parameters if each.kind is each.KEYWORD_ONLY)
    return Format(point.module, keys, plugins.code_identity(point))


def read(form: str, paths: Sequence[Path], settings: Mapping[str, Any]) -> Record:
    """Read the record of an instrument, with the times of its own clock.

    Args:
        settings: section of the instrument in the mooring file.

    Raises:
        InputError: a file cannot be read.
    """
    from compasslib.records import Record

    if not paths:
        raise InputError("files", expected="at least one file", found="none", advice="name the instrument's files")
    known = get_format(form)
    keys = {key: settings.get(key) for key in known.keys}
    if not known.plugin:
        with detect.format_hints(form, paths, offered=FORMATS, skipped=bool(keys.get("skip_rows"))):
            record: Record = import_module(f"compasslib.readers.{known.module}").read(paths, **keys)
        return record
    point = plugins.plugin_table(plugins.READERS, FORMATS)[form]
    with plugins.plugin_errors(point, "a Record"):
        given: Any = plugins.load_plugin(point)(paths, **keys)
    if not isinstance(given, Record):
        shown, advice = type(given).__name__, "mend the plug-in; docs/howto/plugins.md shows one"
        raise InputError(f"{known.plugin}: {point.value}", expected="a Record", found=shown, advice=advice)
    return replace(given, warnings=(f"Read by {known.plugin}.", *given.warnings))
