"""JSON schemas of a cruise's YAML files, generated from the models, for completion and validation in editors.

``python -m compasslib.config.json_schema FOLDER`` writes them; ``make schema`` does so for config/schema.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from compasslib.config.calibrations import MODELS, KindKey
from compasslib.config.schema import CruiseOptions, Mooring

FOLDER = "config/schema"  # relative to the folder of a cruise
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
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
    for file, text in schemas().items():
        Path(sys.argv[1], file).write_text(text, encoding="utf-8")
