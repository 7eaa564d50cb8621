"""Settings as parameters of rules: each value is a text ``key=value``, which Snakemake compares and prints."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any
from urllib.parse import quote, unquote


def flatten(arguments: Mapping[str, Any]) -> dict[str, str]:
    """Convert arguments of a stage to texts ``key=value``, one for each number, text or switch, with values as JSON."""
    return {path: f"{path}={json.dumps(value, ensure_ascii=False)}" for path, value in _leaves(arguments)}


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values in mappings and lists, with their paths; other signs in a name than letters are escaped."""
    if isinstance(value, Mapping) and value:
        for name, each in value.items():
            escaped = quote(name, safe="/ ").replace(".", "%2E")
            yield from _leaves(each, f"{path}.{escaped}" if path else escaped)
    elif isinstance(value, list | tuple) and value:
        for k, each in enumerate(value):
            yield from _leaves(each, f"{path}[{k}]")
    elif path:
        yield path, value


def unflatten(texts: Iterable[str]) -> dict[str, Any]:
    """Return the arguments that ``flatten`` converted, with lists in place of tuples."""
    tree: dict[str, Any] = {}
    for text in texts:
        path, value = text.split("=", 1)
        *outer, last = path.replace("[", ".[").split(".")
        inner = tree
        for name in outer:
            inner = inner.setdefault(name, {})
        inner[last] = json.loads(value)
    return _with_lists(tree)


def _with_lists(tree: Any) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "[0]" in tree:
        return [_with_lists(tree[f"[{k}]"]) for k in range(len(tree))]
    return {unquote(name): _with_lists(value) for name, value in tree.items()}


def parameters(settings: Callable[..., dict[str, Any]], subjects: Iterable[tuple[str, ...]]) -> dict[str, Any]:
    """Compose the parameters of a rule, one function for each key; it returns None where a job does not have the key.

    Args:
        settings: returns the arguments of the stage for one of the ``subjects``, the values of the rule's wildcards;
            those of the subject () are for all jobs.
    """
    known = {subject: flatten(settings(*subject)) for subject in subjects}
    names = dict.fromkeys(name for texts in known.values() for name in texts)

    def of(name: str) -> Callable[[Any], str | None]:
        return lambda wildcards: known.get(tuple(wildcards), known.get((), {})).get(name)

    # Snakemake compares the sets of values: None is in all of them, so that a key of one job does not concern others.
    return {"none": None} | {f"key{k}": of(name) for k, name in enumerate(names)}
