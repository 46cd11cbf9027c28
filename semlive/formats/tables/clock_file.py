"""The clock file, by which a simulator passes experiment time to every process of a run."""

from __future__ import annotations

import json

from semlive.data.clock import Clock
from semlive.errors import BadInput

_FIELDS = {"utc0_ns": int, "mono0_ns": int, "rate": (int, float), "revision": int, "not_before_ns": int}


def encode_clock(clock: Clock) -> bytes:
    """Return a clock as one JSON object; write it under another name and rename it, so that no process reads a part of it."""
    fields = {
        "version": 1,
        "utc0_ns": clock.utc0_ns,
        "mono0_ns": clock.mono0_ns,
        "rate": clock.rate,
        "revision": clock.revision,
        "not_before_ns": clock.not_before_ns,
    }
    return (json.dumps(fields) + "\n").encode()


def decode_clock(data: bytes) -> Clock:
    """Return the clock of a clock file.

    Raises:
        BadInput: the bytes are not a clock file of version 1.
    """
    try:
        fields = json.loads(data)
    except ValueError as error:
        raise BadInput("the clock file is not JSON; let the simulator write it again") from error
    if not isinstance(fields, dict) or fields.get("version") != 1:
        raise BadInput("the clock file is not of version 1; simulator and semlive must be of one release")
    fields.setdefault("not_before_ns", 0)  # files of earlier releases do not have it
    for name, kind in _FIELDS.items():
        value = fields.get(name)
        if isinstance(value, bool) or not isinstance(value, kind):
            raise BadInput(f"the clock file has no usable {name} ({value!r}); let the simulator write it again")
    try:
        return Clock(fields["utc0_ns"], fields["mono0_ns"], float(fields["rate"]), fields["revision"], fields["not_before_ns"])
    except ValueError as error:
        raise BadInput(f"the clock file is wrong: {error}; let the simulator write it again") from error
