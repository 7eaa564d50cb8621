"""Read and validate a cruise's YAML files as immutable models; a mistake is reported in one line before any work.

``python -m compasslib.config.cruise FOLDER`` writes the JSON schemas of the files; ``make schema`` does so.
"""

import graphlib
import json
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from compasslib.config.calibrations import MODELS, CalibrationFile, KindKey
from compasslib.config.schema import CruiseOptions, Mooring
from compasslib.config.section import describe
from compasslib.config.values import DECIDE, NAME, NAME_WORDS, RawFolder, shown
from compasslib.errors import InputError
from compasslib.records import iso_time

CONFIG = "config/config.yaml"
CALIBRATIONS = "config/calibrations"
Model = TypeVar("Model", bound=BaseModel)
Stays = dict[str, list[tuple[str, float, float]]]  # where a compass was, from when to when, by the compass


@dataclass(frozen=True)
class Cruise:
    """Folder and validated configuration of a cruise, with defaults filled in."""

    root: Path  #: folder of the cruise
    options: CruiseOptions  #: content of config.yaml
    moorings: dict[str, Mooring]  #: by name, in the order of the files; NAME/ROLE if several instruments are affected
    mooring_files: dict[str, str]  #: path of the YAML file of each entry of ``moorings``, relative to ``root``
    calibrations: dict[str, CalibrationFile]  #: by name, the stem of the file name

    @cached_property
    def whole(self) -> dict[str, list[str]]:
        """Keys of ``moorings`` by name of the mooring, one for each affected instrument."""
        names: dict[str, list[str]] = {}
        for name in self.moorings:
            names.setdefault(name.partition("/")[0], []).append(name)
        return names

    @cached_property
    def compasses(self) -> dict[str, tuple[list[str], list[str]]]:
        """Moorings and calibrations by the name of the (affected) compass, which is never inferred."""
        members: dict[str, tuple[list[str], list[str]]] = {}
        for name, mooring in self.moorings.items():
            if compass := mooring.instruments[mooring.compromised].compass:
                members.setdefault(compass, ([], []))[0].append(name)
        for name, calibration in self.calibrations.items():
            if calibration.compass:
                members.setdefault(calibration.compass, ([], []))[1].append(name)
        return dict(sorted(members.items()))


def _raise(mistake: InputError) -> None:
    raise mistake


def load_cruise(cruise: Path, *, in_storage: bool = False, refuse: Callable[[InputError], None] = _raise) -> Cruise:
    """Load and validate the configuration of a cruise, with raw files located and globs expanded.

    Args:
        in_storage: whether raw files are fetched later by a storage plug-in of Snakemake, so that they need not exist.
        refuse: called with each mistake in the file of a mooring or calibration, which is then left out.

    Raises:
        InputError: at the first mistake, naming file, key, what is allowed and what was found.
    """
    options = validate(CruiseOptions, read(cruise, CONFIG, "moorings: config/moorings"), CONFIG)
    place = RawFolder(cruise, made_later=options.demonstration or in_storage)
    moorings: dict[str, Mooring] = {}
    files: dict[str, str] = {}
    for file in _mooring_files(cruise, options.moorings):
        try:
            raw = read(cruise, file, "name: EG4")
            mooring = validate(Mooring, _with_options(raw, options), file, place)
            for other in files:  # M1 and m1 are one folder on some file systems
                if mooring.name.lower() == other.partition("/")[0].lower():
                    alike = " in other letters" * (mooring.name != other)
                    taken = f"{shown(mooring.name)}, which {files[other]} has already{alike}"
                    raise InputError(f"{file}: name", "a name of its own", taken, "rename one of the two")
            moorings |= (split := mooring.split())
            files |= dict.fromkeys(split, file)
        except InputError as mistake:
            refuse(mistake)
    calibrations = _calibrations(cruise, place, refuse)
    stays: Stays = {}
    for name, entry in calibrations.items():
        if entry.compass is not None and entry.date_s is not None:
            stays.setdefault(entry.compass, []).append((f"calibration {name}", entry.date_s, entry.date_s))
    for file in dict.fromkeys(files.values()):
        names = [name for name in moorings if files[name] == file]
        try:
            for name in names:
                _check_calibrations(cruise, calibrations, moorings[name].fit.name, file)
            _check_compasses(names[0], moorings[names[0]], file, stays)
        except InputError as mistake:
            refuse(mistake)
            for name in names:
                del moorings[name], files[name]
    return Cruise(cruise, options, moorings, files, calibrations)


def validate(model: type[Model], raw: dict[str, Any], file: str, place: RawFolder | None = None) -> Model:
    """Validate a mapping, with raw files searched in ``place``, or raise its first mistake, with ``others``.

    Raises:
        InputError: for keys still set to DECIDE, an unknown key or an invalid value; ``others`` has further mistakes.
    """
    undecided_keys, errors = undecided(raw), []
    try:
        checked = model.model_validate(decided(raw), context=place)
        if not undecided_keys:
            return checked
    except ValidationError as error:
        # A misspelt key is also reported as missing; the message about its spelling is more helpful and comes first.
        errors = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
        misspelt = {e["loc"][:-1] for e in errors if e["type"] == "extra_forbidden"}
        errors = [e for e in errors if e["type"] != "missing" or e["loc"][:-1] not in misspelt] or errors
    mistakes: dict[str, InputError] = {}
    if undecided_keys:
        actual = f"{len(undecided_keys)} {DECIDE} {'entries' if len(undecided_keys) > 1 else 'entry'}"
        advice = f"replace each {DECIDE} by a value: {', '.join(undecided_keys)}"
        mistakes[""] = InputError(file, expected="a value of every key", found=actual, advice=advice)
    for mistake in (describe(model, error, file) for error in errors):
        key = mistake.where.removeprefix(f"{file}: ")
        if not any(f"{each}.".startswith(f"{key}.") for each in undecided_keys):
            mistakes.setdefault(key, mistake)  # each part of a union refuses a value: the first describes it
    first, *others = mistakes.values()
    first.others = tuple(others)
    raise first


def undecided(raw: Any, place: str = "") -> list[str]:
    """List the keys whose value is DECIDE, in the order of the file."""
    if raw == DECIDE:
        return [place]
    below = raw.items() if isinstance(raw, dict) else ()
    return [key for name, value in below for key in undecided(value, f"{place}.{name}".lstrip("."))]


def decided(raw: Any) -> Any:
    """Remove the keys whose value is DECIDE."""
    if not isinstance(raw, dict):
        return raw
    return {key: decided(value) for key, value in raw.items() if value != DECIDE}


def _mooring_files(cruise: Path, moorings: str | Sequence[str]) -> list[str]:
    where, advice = f"{CONFIG}: moorings", "correct the path, relative to the cruise folder, or write moorings: []"
    files = sorted(set(moorings))
    if isinstance(moorings, str):
        listed = os.listdir(cruise / moorings) if os.path.isdir(cruise / moorings) else []
        files = sorted(f"{moorings}/{name}" for name in listed if name.endswith((".yaml", ".yml")) and name[0] != ".")
        if not files:
            raise InputError(where, "a folder with files NAME.yaml", f"none in {moorings}", advice)
    for file in files:
        if not file.isprintable():
            raise InputError(str(moorings), "names in UTF-8 without control characters", shown(file), "rename the file")
        if not os.path.isfile(cruise / file):
            raise InputError(where, expected="existing mooring files", found=f"no file {file}", advice=advice)
    return files


def _check_calibrations(cruise: Path, known: dict[str, CalibrationFile], names: Sequence[str], file: str) -> None:
    """Check that the calibrations of a mooring exist, with place and date, which their transfer requires."""
    for name in names:
        source, where = f"{CALIBRATIONS}/{name}.yaml", f"{file}: fit.name"
        if not os.path.isfile(cruise / source):
            raise InputError(where, f"the file {source}", "none", "write that file or correct the name")
        if name in known and not known[name].placed:
            expected = f"latitude, longitude and date in {source}, to carry its coefficients to the mooring"
            raise InputError(where, expected=expected, found="none", advice="add them there")


def _check_compasses(name: str, mooring: Mooring, file: str, stays: Stays) -> None:
    """Check that no compass was in two places, by the ``stays`` so far, or calibrated under the mooring's name."""
    for role, compass in ((role, each.compass) for role, each in mooring.instruments.items() if each.compass):
        where = f"{file}: instruments.{role}.compass"
        for other, begin_s, end_s in stays.setdefault(compass, []):
            if other == f"calibration {mooring.name}":
                expected = "another name of the mooring than of the compass's calibration"
                actual, advice = f"{mooring.name} for both", "rename one of the two"
                raise InputError(where, expected=expected, found=actual, advice=advice)
            if begin_s < mooring.end_s and mooring.start_s < end_s:
                span = " to ".join(dict.fromkeys([iso_time(begin_s), iso_time(end_s)]))
                own = f"{iso_time(mooring.start_s)} to {iso_time(mooring.end_s)}"
                advice = "correct the dates, or give one of the two compasses another name"
                expected, actual = f"a compass that is in one place from {own}", f"{compass} at {other}, {span}"
                raise InputError(where, expected=expected, found=actual, advice=advice)
        stays[compass].append((f"{name} ({role})", mooring.start_s, mooring.end_s))


def _calibrations(cruise: Path, place: RawFolder, refuse: Callable[[InputError], None]) -> dict[str, CalibrationFile]:
    folder = cruise / CALIBRATIONS
    listed = sorted(os.listdir(folder)) if folder.is_dir() else []
    files = [f"{CALIBRATIONS}/{file}" for file in listed if file.endswith((".yaml", ".yml")) and file[0] != "."]
    calibrations: dict[str, CalibrationFile] = {}
    for file in files:
        try:
            raw = read(place.root, file, "kind: platform")
            kind = validate(KindKey, {key: raw[key] for key in ("kind",) if key in raw}, file).kind
            stem, ending = os.path.splitext(os.path.basename(file))
            if ending != ".yaml" or not re.fullmatch(NAME, stem):
                expected, actual = f"a file NAME.yaml, the name of {NAME_WORDS}", os.path.basename(file)
                raise InputError(file, expected=expected, found=actual, advice="rename the file")
            calibrations[stem] = validate(MODELS[kind], raw, file, place)
        except InputError as mistake:
            refuse(mistake)
    compared = {name: calibration.compare_with for name, calibration in calibrations.items()}
    wrong = next(((name, shown(x)) for name, others in compared.items() for x in others if x not in compared), None)
    try:
        graphlib.TopologicalSorter(compared).prepare()
    except graphlib.CycleError as error:
        cycle = error.args[1]
        wrong = wrong or (cycle[0], f"a circle of comparisons, {' - '.join(cycle)}")
    if wrong:
        where, expected = f"{CALIBRATIONS}/{wrong[0]}.yaml: compare_with", "the NAME of another, earlier calibration"
        advice = "correct the name; the earlier one stands alone"
        raise InputError(where, expected=expected, found=wrong[1], advice=advice)
    return calibrations


def _with_options(raw: dict[str, Any], options: CruiseOptions) -> dict[str, Any]:
    fit = raw.get("fit")
    # The keys of fit depend on each other, hence it is replaced as a whole; the others are merged key by key.
    filled = raw if fit is not None else raw | {"fit": options.fit.model_dump(exclude_unset=True)}
    for name, default in (("diagnose", options.diagnose), ("product", options.product)):
        given = raw.get(name)
        if isinstance(given, dict | None):
            stated = {key: value for key, value in (given or {}).items() if value is not None}
            defaults = {key: False if value is None else value for key, value in default.model_dump().items()}
            filled = filled | {name: defaults | stated}
    if isinstance(quality := raw.get("quality"), dict | None):
        filled = filled | {"quality": options.quality.model_dump() | (quality or {})}
    return filled


# YAML without aliases, repeated keys and conversions that are mostly mistakes: dates and leading zeros remain text.


class _Loader(yaml.SafeLoader):
    """Safe loading without dates, octal and sexagesimal numbers, aliases and repeated keys."""

    # Not the inherited table: only null, bool, int and float, added below, are resolved; all else is a string.
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose one node; refuse aliases, which may refer to what contains them."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.MarkedYAMLError(None, None, f"the alias *{event.anchor}; write the value out", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping with its keys as unconverted strings; refuse repeated keys."""
        content: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.value in content:
                what = f"{key.value!r} again" if isinstance(key, yaml.ScalarNode) else "a list or mapping as a key"
                raise yaml.MarkedYAMLError(None, None, what, key.start_mark)
            content[key.value] = self.construct_object(value, deep=True)
        return content


def _number(loader: Any, node: Any) -> int | float | str:
    text: str = node.value
    if "." not in text:
        return int(text) if len(text) <= 18 else text  # longer ones are serial numbers and may overflow 64 bits
    return float(text) if math.isfinite(float(text)) else text


for _kind, _pattern, _first in (
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    ("int", r"^[-+]?(?:0|[1-9][0-9]*)$", list("-+.0123456789")),
    ("float", r"^[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?$", list("-+.0123456789")),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_pattern), _first)
for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _number)


def read(root: Path, name: str, example: str = "key: value") -> dict[str, Any]:
    """Read a YAML file as a mapping; dates remain strings.

    Raises:
        InputError: if the file is absent, not UTF-8, not YAML, or not a mapping.
    """
    path = root / name
    if not path.is_file():
        raise InputError(name, f"this file in {root}", "none", f"write one, for example with the line {example}")
    try:
        return parse(path.read_bytes(), name, example)
    except OSError as error:
        raise InputError(name, "a readable file", f"{error.strerror}", "check its permissions") from None


def parse(data: bytes, name: str, example: str = "key: value") -> dict[str, Any]:
    """Parse the content of a YAML file as ``read`` does."""
    where, text = name, data.decode("utf-8-sig", "replace")
    try:
        data.decode("utf-8-sig")
        content = yaml.load(text, Loader=_Loader)
    except UnicodeDecodeError as error:
        actual = f"bytes that are not UTF-8 at {error.start}"
    except yaml.MarkedYAMLError as error:
        mark: Any = error.problem_mark or error.context_mark
        where, actual = (
            f"{name}: line {mark.line + 1}, column {mark.column + 1}",
            f"a mistake of form ({error.problem})",
        )
    except yaml.reader.ReaderError as error:
        where, actual = f"{name}: line {text.count(chr(10), 0, error.position) + 1}", "a control character"
    else:
        if isinstance(content, dict):
            return content
        actual = "an empty file" if content is None else f"{shown(content)} alone"
        raise InputError(name, expected="keys with values", found=actual, advice=f"write for example {example}")
    raise InputError(where, "YAML in UTF-8", actual, "check encoding, indentation, colons, quotes and brackets")


# JSON schemas, generated from the models, for completion and validation of the YAML files in editors.

SCHEMAS = "config/schema"  # their folder in a cruise
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schemas() -> dict[str, str]:
    """Generate the JSON schemas of config.yaml, of moorings and of calibrations, by name of the schema file."""
    models: list[type[BaseModel]] = [KindKey, *MODELS.values()]
    named: list[tuple[type[BaseModel], JsonSchemaMode]] = [(model, "validation") for model in models]
    _, kinds = models_json_schema(named)
    by_kind = [
        {"if": {"properties": {"kind": {"const": kind}}}, "then": {"$ref": f"#/$defs/{model.__name__}"}}
        for kind, model in MODELS.items()
    ]
    known = kinds["$defs"]["KindKey"]["properties"]
    calibration = {"type": "object", "required": ["kind"], "properties": known, "allOf": by_kind, **kinds}
    made = {"config": CruiseOptions.model_json_schema(), "mooring": Mooring.model_json_schema()}
    return {
        f"{name}.json": json.dumps({"$schema": DIALECT} | _simplify(schema), indent=1, ensure_ascii=False) + "\n"
        for name, schema in (made | {"calibration": calibration}).items()
    }


def _simplify(schema: Any) -> Any:
    """Remove advice and examples, which serve error messages only, and uninformative titles and null defaults."""
    if isinstance(schema, list):
        return [_simplify(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    idle = {"advice": schema.get("advice"), "title": schema.get("title"), "default": None, "examples": None}
    return {
        key: _simplify(value)
        for key, value in schema.items()
        if not (key in idle and (key == "examples" or (value == idle[key] and not isinstance(value, dict))))
    }


if __name__ == "__main__":
    for file, text in json_schemas().items():
        Path(sys.argv[1], file).write_text(text, encoding="utf-8")
