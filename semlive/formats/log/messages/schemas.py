"""JSON schemas in the form that is written to the log: complete, and readable by viewers of logs.

Foxglove and Lichtblick plot the `properties` of a schema. They show nothing of a topic with properties that they do not
support: nullable values, references to definitions, nested arrays and free keys. Therefore `properties` lists what can be
plotted, with references resolved, and `allOf` holds the complete schema. A validator applies both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]
_SCALARS = ("number", "integer", "string", "boolean")


def non_nullable(schema: Schema, names: frozenset[str]) -> dict[str, Any]:
    """Return the schema with the listed properties never null; such a property is omitted when it has no value."""
    properties = {name: _not_null(item) if name in names else item for name, item in schema.get("properties", {}).items()}
    return {**schema, "properties": properties} if properties else dict(schema)


def plottable_schema(schema: Schema) -> dict[str, Any]:
    """Return a schema whose `properties` are those that viewers plot; `allOf` holds the complete schema."""
    definitions = schema.get("$defs", {})
    complete = {name: value for name, value in schema.items() if name != "$defs"}
    properties = _properties(schema, definitions)
    return {"$defs": definitions, "title": schema.get("title", ""), "type": "object", "properties": properties, "allOf": [complete]}


def _not_null(schema: Schema) -> dict[str, Any]:
    choices = [choice for choice in schema.get("anyOf", []) if choice != {"type": "null"}]
    keywords = {name: value for name, value in schema.items() if name not in ("anyOf", "default")}
    return {**keywords, **choices[0]} if len(choices) == 1 else dict(schema)


def _properties(schema: Schema, definitions: Mapping[str, Schema]) -> dict[str, Any]:
    plottable = {name: _plottable(item, definitions) for name, item in schema.get("properties", {}).items()}
    return {name: item for name, item in plottable.items() if item is not None}


def _plottable(schema: Schema, definitions: Mapping[str, Schema]) -> dict[str, Any] | None:
    """Return the part of a property that viewers can plot; None if they can plot nothing of it."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].removeprefix("#/$defs/")]
    kind = schema.get("type")
    if kind in _SCALARS:
        return {"type": kind}
    if kind == "object":
        properties = _properties(schema, definitions)
        return {"type": "object", "properties": properties} if properties else None
    if kind == "array":
        kinds = [_plottable(item, definitions) for item in schema.get("prefixItems", [schema.get("items", {})])]
        first = kinds[0] if kinds else None
        if first is not None and first["type"] != "array" and all(item == first for item in kinds):
            return {"type": "array", "items": first}
    return None
