"""Strict YAML: plain mappings, lists, texts and numbers; what is more likely a slip than meant is refused.

Dates stay texts, as do numbers with leading zeros, so that nothing is turned into something else on the way.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import yaml

from compasslib.errors import InputError

LARGEST_BYTES = 1_000_000
DEEPEST = 20  # levels of nesting; a mooring needs five

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
# What the parser says, what that mostly comes from, and what helps.
_SYNTAX = (
    ("mapping values are not allowed", "a colon where none can stand", "write a space after each colon"),
    ("could not find expected ':'", "a line without a colon", "write it as key: value"),
    ("<block end>", "a line that does not stand below its neighbours", "indent the keys of one mapping equally"),
    ("end of stream", "the end of the file within quotes", "close the quotes"),
    ("expected ',' or", "a bracket or brace that is not closed before this", "close it or add the comma"),
    (
        "<document start>",
        "something that does not stand below the lines above",
        "indent the keys of one mapping equally",
    ),
    ("entries are not allowed", "a list where none can stand", "write it as [a, b]"),
    ("keys are not allowed", "a question mark where none can stand", "put the value in quotes"),
    ("another document", "a second document", "delete the line ---"),
    ("cannot start any token", "a character that cannot begin a value", "put the value in quotes"),
)


class _Refused(Exception):
    """Something that YAML allows and a cruise file does not need."""

    def __init__(self, mark: Any, expected: str, found: str, advice: str):
        super().__init__(expected)
        self.mark, self.words = mark, {"expected": expected, "found": found, "advice": advice}


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader without dates, octal and sexagesimal numbers, anchors, tags and repeated keys."""

    # An own, empty table: only the four kinds below are told from texts.
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012
    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose one node, after a look at what it would be."""
        event = self.peek_event()
        _refuse_extras(event)
        self.depth += 1
        if self.depth > DEEPEST:
            mark, nested = event.start_mark, f"deeper nesting than {DEEPEST} levels"
            raise _Refused(mark, "mappings and lists a few levels deep", nested, "check the brackets and indentation")
        node = super().compose_node(parent, index)
        self.depth -= 1
        _refuse_control_characters(node)
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping whose keys are the texts that stand there, each of them once."""
        lines: dict[str, int] = {}
        for key, _ in node.value:
            _refuse_key(key, lines)
            lines[key.value] = key.start_mark.line + 1
        return {key.value: self.construct_object(value, deep=True) for key, value in node.value}


def _refuse_extras(event: Any) -> None:
    plain = "write the value out in full"
    if isinstance(event, yaml.AliasEvent):
        raise _Refused(event.start_mark, "plain values without aliases", f"*{event.anchor}", plain)
    if getattr(event, "anchor", None):
        raise _Refused(event.start_mark, "plain values without anchors", f"&{event.anchor}", plain)
    if getattr(event, "tag", None):
        raise _Refused(event.start_mark, "plain values without tags", f"the tag {event.tag}", "delete the tag")


def _refuse_control_characters(node: Any) -> None:
    # Double quotes can spell what the file itself may not hold.
    match = _CONTROL.search(node.value) if isinstance(node, yaml.ScalarNode) else None
    if match:
        found = f"the control character {ord(match[0]):#04x}"
        raise _Refused(node.start_mark, "printable text", found, "delete it")


def _refuse_key(key: Any, lines: dict[str, int]) -> None:
    if not isinstance(key, yaml.ScalarNode):
        raise _Refused(key.start_mark, "a word as key", "a list or mapping", "check braces and colons")
    if key.value in lines:
        found = f"{key.value!r} again, first in line {lines[key.value]}"
        raise _Refused(key.start_mark, "every key once", found, "delete one of the two")


def _number(loader: _Loader, node: Any) -> int | float | str:
    text = node.value
    if "." not in text:
        return int(text) if len(text) <= 18 else text  # longer ones are serial numbers and fit no number of a file
    return float(text) if math.isfinite(float(text)) else text


_DIGITS = list("-+.0123456789")
_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""])
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver(_INT, re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), _DIGITS)
_Loader.add_implicit_resolver(_FLOAT, re.compile(r"^[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?$"), _DIGITS)
_Loader.add_constructor(_INT, _number)
_Loader.add_constructor(_FLOAT, _number)


def read(root: Path, name: str, example: str) -> dict[str, Any]:
    """Return the mapping that a YAML file holds; dates in it are texts.

    Args:
        root: cruise folder.
        name: path of the file, relative to it; messages begin with it.
        example: a line that such a file may begin with.

    Raises:
        InputError: where the file is absent, too large, not UTF-8, not YAML, or no mapping.
    """
    content = _parsed(_text(root, name, example), name)
    if not isinstance(content, dict):
        found = "an empty file" if content is None else "a list" if isinstance(content, list) else "a single value"
        raise InputError(name, expected="keys with values", found=found, advice=f"write for example {example}")
    return content


def _text(root: Path, name: str, example: str) -> str:
    path = root / name
    if not path.is_file():
        advice = f"write one, for example with the line {example}"
        raise InputError(name, expected=f"this file in {root}", found="none", advice=advice)
    if (size := path.stat().st_size) > LARGEST_BYTES:
        expected, advice = f"at most {LARGEST_BYTES} bytes", "check that it is the YAML file and not data"
        raise InputError(name, expected=expected, found=f"{size}", advice=advice)
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        advice = "save the file as UTF-8"
        raise InputError(name, expected="UTF-8 text", found=f"other bytes at {error.start}", advice=advice) from None
    except OSError as error:
        advice = "check its permissions"
        raise InputError(name, expected="a readable file", found=f"{error.strerror}", advice=advice) from None


def _parsed(text: str, name: str) -> Any:
    try:
        return yaml.load(text, Loader=_Loader)
    except _Refused as error:
        raise InputError(_place(name, error.mark), **error.words) from None
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(text, name, error) from None
    except yaml.reader.ReaderError as error:
        where = f"{name}: line {text.count(chr(10), 0, error.position) + 1}"
        found, advice = f"the control character {error.character:#04x}", "delete it"
        raise InputError(where, expected="printable text", found=found, advice=advice) from None


def _syntax_error(text: str, name: str, error: yaml.MarkedYAMLError) -> InputError:
    mark: Any = error.problem_mark or error.context_mark
    if text[mark.index : mark.index + 1] == "\t":
        advice = "replace the tab by spaces"
        return InputError(_place(name, mark), expected="spaces", found="a tab", advice=advice)
    said = str(error.problem)
    found, advice = next((words for sign, *words in _SYNTAX if sign in said), (said, "check indentation and quotes"))
    return InputError(_place(name, mark), expected="YAML", found=found, advice=advice)


def _place(name: str, mark: Any) -> str:
    return f"{name}: line {mark.line + 1}, column {mark.column + 1}"
