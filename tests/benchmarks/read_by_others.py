"""A finished log as others read it: the mcap library, JSON Schema, protobuf, foxglove-sdk, @mcap/core, and viewers' own rules.

    python tests/benchmarks/read_by_others.py LOG.mcap [--node-modules FOLDER]

FOLDER is where ``npm install @mcap/core`` put its modules; by default the one that SEMLIVE_NODE_MODULES names.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import foxglove.messages
import numpy as np
from jsonschema import Draft202012Validator, ValidationError
from jsonschema.validators import extend
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import semlive.service

READER = Path(__file__).parents[1] / "contract" / "log_reader.mjs"
LAYOUT = Path(semlive.service.__file__).with_name("foxglove-layout.json")
SCALARS = ("boolean", "string", "number", "integer")
PYTHON_KINDS: dict[str, set[type]] = {"boolean": {bool}, "number": {int, float}, "integer": {int}}


def viewers_understand(schema: dict[str, Any], where: str) -> None:
    """The rules by which Foxglove Studio and Lichtblick read a JSON schema; what they refuse is an error here.

    Raises:
        AssertionError: such a viewer would show nothing of the topic.
    """
    assert schema.get("type") == "object", where
    for name, entry in schema["properties"].items():
        kind = entry.get("type")
        if kind == "object":
            viewers_understand(entry, f"{where}.{name}")
        elif kind == "array":
            item = entry["items"]
            if item.get("type") == "object":
                viewers_understand(item, f"{where}.{name}")
            else:
                assert item.get("type") in SCALARS, f"{where}.{name}: {item}"
        else:
            assert kind in SCALARS, f"{where}.{name}: {entry}"
        assert "oneOf" not in entry, f"{where}.{name}"


def _items(validator: Any, items: Any, instance: Any, schema: Any) -> Iterator[ValidationError]:
    """The keyword `items`, but arrays of one scalar kind at once: a short run has a million such items, which took 6 of 8 s."""
    kinds = PYTHON_KINDS.get(items.get("type"), set()) if len(items) == 1 else set()
    if not isinstance(instance, list) or {type(item) for item in instance} - kinds:
        yield from Draft202012Validator.VALIDATORS["items"](validator, items, instance, schema)


Validator = extend(Draft202012Validator, {"items": _items})


def check_messages(path: Path) -> dict[str, dict[str, Any]]:
    """Every JSON payload against its schema, every picture decoded; the newest JSON payload of each topic.

    Raises:
        AssertionError: a schema or picture is not what it must be.
        jsonschema.ValidationError: a payload does not fit its schema.
    """
    newest: dict[str, dict[str, Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        validators = {}
        for schema in summary.schemas.values():
            if schema.encoding == "jsonschema":
                reported = json.loads(schema.data)
                Draft202012Validator.check_schema(reported)
                viewers_understand(reported, schema.name)
                validators[schema.id] = Validator(reported)
        for _, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                payload = json.loads(message.data)
                # One in ten of the many samples: the validator takes a millisecond for each.
                if message.sequence % 10 == 0 or not channel.topic.endswith("/sample"):
                    validators[channel.schema_id].validate(payload)
                newest[channel.topic] = newest.get(channel.topic, {}) | payload
        pictures = [entry.topic for entry in summary.channels.values() if entry.message_encoding == "protobuf"]
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=pictures):
            assert schema is not None
            own = getattr(foxglove.messages, schema.name.removeprefix("foxglove."))
            assert own.get_schema().data == schema.data
            check_picture(channel.topic, schema.name, message.data, decoded)
    return newest


def check_picture(topic: str, schema: str, payload: bytes, decoded: Any) -> None:
    """One picture: what protobuf decodes, encoded again by foxglove-sdk, is the payload, and its pixels are there.

    Raises:
        AssertionError: it is not.
    """
    time = foxglove.messages.Timestamp(sec=decoded.timestamp.seconds, nsec=decoded.timestamp.nanos)
    if schema == "foxglove.CompressedImage":
        again = foxglove.messages.CompressedImage(timestamp=time, frame_id=decoded.frame_id, data=decoded.data, format=decoded.format)
        image = cv2.imdecode(np.frombuffer(decoded.data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image is not None, topic
        assert decoded.format == "png"
    else:
        sizes = dict(width=decoded.width, height=decoded.height, step=decoded.step)
        again = foxglove.messages.RawImage(timestamp=time, frame_id=decoded.frame_id, encoding=decoded.encoding, data=decoded.data, **sizes)
        assert decoded.encoding == "32FC1"
        assert len(decoded.data) == decoded.step * decoded.height == 4 * decoded.width * decoded.height
    assert again.encode() == payload, topic


def check_layout(newest: dict[str, dict[str, Any]], topics: set[str]) -> int:
    """Every topic that the layout shows is in the log, and every path that it plots leads to a number; how many there are.

    Raises:
        AssertionError: a panel would stay empty.
    """
    layout, found = json.loads(LAYOUT.read_text("utf-8")), 0
    for panel, config in layout["configById"].items():
        for path in config.get("paths", []):
            topic, _, names = path["value"].partition(".")
            value: Any = newest[topic]
            for name in names.split("."):
                value = value[name]
            assert isinstance(value, int | float if panel.startswith("Plot!") else str), path
            found += 1
        for topic in (config.get("imageMode", {}).get("imageTopic"), config.get("topicToRender")):
            assert topic is None or topic in topics, f"{panel}: {topic}"
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))) == layout["configById"].keys()
    return found


def node_modules() -> Path | None:
    """Where @mcap/core is installed, None if not given, or there is no node."""
    named = os.environ.get("SEMLIVE_NODE_MODULES")
    return Path(named) if named and shutil.which("node") else None


def by_node(path: Path, modules: Path) -> dict[str, Any]:
    """What @mcap/core's indexed reader finds in a log."""
    done = subprocess.run(["node", str(READER), str(modules), str(path)], capture_output=True, text=True, timeout=120, check=True)
    return json.loads(done.stdout)


def counts(path: Path) -> dict[str, int]:
    """Messages of each topic, by the mcap library."""
    with path.open("rb") as stream:
        return dict(Counter(channel.topic for _, channel, _ in make_reader(stream).iter_messages()))


def main() -> None:
    """All of it as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--node-modules", type=Path, default=node_modules())
    arguments = parser.parse_args()
    newest, counted = check_messages(arguments.log), counts(arguments.log)
    sys.stdout.write(f"{sum(counted.values())} messages of {len(counted)} topics: schemas, payloads and pictures agree\n")
    sys.stdout.write(f"{check_layout(newest, set(counted))} paths of the layout lead to values\n")
    if arguments.node_modules is not None:
        read = by_node(arguments.log, arguments.node_modules)
        same = read["counts"] == counted
        sys.stdout.write(f"@mcap/core reads {read['messages']} messages: {'the same' if same else 'NOT the same'}\n")


if __name__ == "__main__":
    main()
