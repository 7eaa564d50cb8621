"""``compass check``: the checks that the workflow makes before any work, and what each mooring has."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from compasslib.config import cruise as config
from compasslib.config.cruise import Cruise
from compasslib.config.schema import Instrument, Mooring
from compasslib.run import plan


def run(asked: Namespace) -> int:
    """Print what is ready.

    Raises:
        InputError: the first mistake, as the workflow would say it.
    """
    cruise = config.load(Path(asked.cruise))
    plan.plan(cruise, Path())
    print("\n".join(_lines(cruise)))
    return 0


def _lines(cruise: Cruise) -> list[str]:
    moorings = [f"  {name}: {_has(mooring)}" for name, mooring in cruise.moorings.items()]
    others = [f"  {name}: {one.kind}, {_files(one.files)}" for name, one in cruise.calibrations.items()]
    lines = [f"{_counted(len(moorings), 'mooring')} ready", *moorings]
    lines += [f"{_counted(len(others), 'calibration')} ready", *others] if others else []
    return lines + ["the demonstration's raw files are made by the run"] * cruise.options.demonstration


def _has(mooring: Mooring) -> str:
    parts = [f"{mooring.start:%Y-%m-%d} to {mooring.end:%Y-%m-%d}"]
    parts.append(_instrument("corrected is", mooring.compromised, mooring))
    parts += [_instrument("trusted is", name, mooring) for name in mooring.reference] or [_without(mooring)]
    by = f"calibration {mooring.fit.name}" if mooring.fit.name else mooring.fit.method
    parts.append(f"by {by}{' with tilt' * mooring.fit.tilt}")
    parts += [f"{name} ({_files(series.files)})" for name, series in mooring.covariates.items()]
    return "; ".join(parts)


def _without(mooring: Mooring) -> str:
    return "no trusted instrument" + (", so nothing is corrected" if mooring.fit.name is None else "")


def _instrument(role: str, name: str, mooring: Mooring) -> str:
    one: Instrument = mooring.instruments[name]
    depth = "" if one.depth is None else f", {one.depth:g} m"
    return f"{role} {name} ({one.format}, {_files((*one.files, *one.pressure_files))}{depth})"


def _files(files: tuple[str, ...]) -> str:
    return _counted(len(files), "file")


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'s' * (n != 1)}"
