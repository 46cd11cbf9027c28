"""JSON schemas as they stand in the log: complete, and such that viewers of logs can read them.

Foxglove and Lichtblick draw what a schema's `properties` name, and show nothing of a topic whose properties they do not
understand: those that may be null, refer to a definition, hold rows of rows, or have any keys. So `properties` names what
can be drawn, with references resolved, and the whole schema stands beside it under `allOf`: for a validator both hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]
_SCALARS = ("number", "integer", "string", "boolean")


def non_nullable(whole: Schema, names: frozenset[str]) -> dict[str, Any]:
    """A schema in which the named properties, which are left out when they have no value, are never null."""
    properties = {name: _not_null(one) if name in names else one for name, one in whole.get("properties", {}).items()}
    return {**whole, "properties": properties} if properties else dict(whole)


def plottable_schema(whole: Schema) -> dict[str, Any]:
    """A schema whose `properties` are those that viewers draw; the whole one is its `allOf`."""
    definitions = whole.get("$defs", {})
    rest = {name: value for name, value in whole.items() if name != "$defs"}
    properties = _properties(whole, definitions)
    return {"$defs": definitions, "title": whole.get("title", ""), "type": "object", "properties": properties, "allOf": [rest]}


def _not_null(one: Schema) -> dict[str, Any]:
    choices = [choice for choice in one.get("anyOf", []) if choice != {"type": "null"}]
    kept = {name: value for name, value in one.items() if name not in ("anyOf", "default")}
    return {**kept, **choices[0]} if len(choices) == 1 else dict(one)


def _properties(schema: Schema, definitions: Mapping[str, Schema]) -> dict[str, Any]:
    drawn = {name: _drawn(one, definitions) for name, one in schema.get("properties", {}).items()}
    return {name: one for name, one in drawn.items() if one is not None}


def _drawn(one: Schema, definitions: Mapping[str, Schema]) -> dict[str, Any] | None:
    """What viewers understand of a property, None if nothing."""
    if "$ref" in one:
        one = definitions[one["$ref"].removeprefix("#/$defs/")]
    kind = one.get("type")
    if kind in _SCALARS:
        return {"type": kind}
    if kind == "object":
        properties = _properties(one, definitions)
        return {"type": "object", "properties": properties} if properties else None
    if kind == "array":
        kinds = [_drawn(item, definitions) for item in one.get("prefixItems", [one.get("items", {})])]
        first = kinds[0] if kinds else None
        if first is not None and first["type"] != "array" and all(other == first for other in kinds):
            return {"type": "array", "items": first}
    return None
