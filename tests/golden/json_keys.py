"""The keys of every JSON object that commands print about the short demo: programs rely on them, so they are only ever extended.

Keys that are names of effects, of their parameters or of log topics depend on the data and are not recorded.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

RECORDED = Path(__file__).with_name("json_keys.json")


def commands(demo: Path) -> dict[str, list[str]]:
    """Arguments of each command, by its name, for a demo folder."""
    log, config = demo / "log" / "demo", demo / "run.yaml"
    first, second = sorted((demo / "instrument" / "export").glob("*.tif"))[:2]
    return {
        "replay": ["replay", str(log), "--from-disparity", "--max", "--json"],
        "replay sutton2007": ["replay", str(log), "--from-disparity", "--max", "--method", "sutton2007", "--json"],
        "diagnose": ["diagnose", str(log), "--json"],
        "plan": ["plan", str(config), "--test-frame", str(first), "--json"],
        "doctor": ["doctor", str(config), "--test-frame", str(first), "--json"],
        "inspect": ["inspect", str(first), "--json"],
        "recover": ["recover", str(log), "--json"],
        "prune": ["prune", str(log.parent), "--days", "36500", "--json"],
        "dic": ["dic", str(first), str(second), "--json"],
    }


def keys(value: object, path: str = "") -> Iterator[str]:
    """Paths of all keys; the items of a list share the path of the list."""
    if isinstance(value, dict):
        for name, item in value.items():
            if name.startswith("/"):
                continue
            yield f"{path}.{name}" if path else name
            yield from keys(item, f"{path}.{name}" if path else name)
    elif isinstance(value, list):
        for item in value:
            yield from keys(item, path)


def printed(output: str) -> list[str]:
    """The keys of the JSON object that a command printed."""
    return sorted(set(keys(json.loads(output))))
