"""Search one calibration for unmodelled effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from compasslib.archive.files import write_json
from compasslib.inference import kinds


def run(
    name: str,
    /,
    *,
    raw: Sequence[str],
    diagnosis: str,
    kind: str,
    settings: Mapping[str, Any],
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write what its recording shows that the simulation does not hold.

    Args:
        raw: files in the order of the YAML file.
        settings: keys of the YAML file that the kind takes.
        options: of the cruise's diagnoses.

    Raises:
        InputError: a raw file cannot be read.
    """
    found = kinds.diagnose(kind, raw, settings, kinds.chosen(options))
    write_json(diagnosis, found.to_json())
    say(found.log_line(name))
