"""What was observed, kept in a file, so that a campaign can be taken in pieces and judged again."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from .scenario import Fault, Observed


def keep(path: Path, name: str, observed: Observed) -> None:
    """Add what was observed in a scenario to a file, one JSON object a line."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"scenario": name, **asdict(observed)}) + "\n")


def read_stored(path: Path | None) -> dict[str, Observed]:
    """What a file holds, by scenario; the newest counts. Nothing without a file."""
    if path is None or not path.exists():
        return {}
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        values = json.loads(line)
        name = values.pop("scenario")
        values |= {key: tuple(values[key]) for key in ("states", "stops_s", "unloadings")}
        found[name] = Observed(**{**values, "faults": tuple(Fault(**item) for item in values["faults"])})
    return found
