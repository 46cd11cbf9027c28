"""Starts of a run that were rejected after a device was opened: the log is retained until the next run of the same name replaces it."""

from __future__ import annotations

import shutil
from pathlib import Path

from semlive.data.faults import FaultCode
from semlive.engine import State
from semlive.errors import BadConfig, BadInput, BadLog, LinkError, LinkRefused, SemliveError
from semlive.formats.log.messages import FaultMessage, StateMessage, from_json
from semlive.service.log.files import SUFFIX, messages
from semlive.service.log.lock import held_itself

REFUSED_START = "start of the run"
"""`where` of the `/fault` message of a refused start."""
_TOPICS = frozenset({"/run", "/clock", "/clock/offset", "/state", "/fault", "/operator", "/log", "/load_frame/sample", "/stage/sample"})
"""Topics of a log that holds no order, no image and no result."""
_KINDS = (LinkRefused, LinkError, BadConfig, BadInput)


def refused_start(folder: Path) -> str | None:
    """The reason of a refused start, if the log of a run holds nothing else.

    A log with a state after `connecting`, an order, an image, a second segment or any damage is not such a log.

    Args:
        folder: run folder.

    Returns:
        The text of its `/fault` message, or None.
    """
    if [path.suffix for path in folder.iterdir()] != [SUFFIX]:
        return None
    reason: str | None = None
    damage = list[str]()
    try:
        for message in messages(folder, damage.append):
            if damage or message.topic not in _TOPICS:
                return None
            if message.topic not in ("/state", "/fault"):
                continue
            payload = from_json(message.topic, message.payload)
            if isinstance(payload, StateMessage) and payload.after != State.CONNECTING:
                return None
            if isinstance(payload, FaultMessage) and payload.where == REFUSED_START:
                reason = payload.what
    except (BadLog, OSError):
        return None
    return None if damage else reason


def remove_refused_start(folder: Path) -> str | None:
    """Remove a run folder whose log contains only a rejected start; the caller holds the lock of its path.

    Returns:
        The reason of that start, or None if there is no such folder or its log holds more.

    Raises:
        BadConfig: another process holds the folder.
        OSError: it cannot be removed.
    """
    if not folder.is_dir():
        return None
    with held_itself(folder):
        reason = refused_start(folder)
        if reason is not None:
            shutil.rmtree(folder)
    return reason


def refusal_code(error: SemliveError) -> FaultCode:
    """The code of the `/fault` message of a start that `error` refused."""
    return FaultCode.LINK_LOST if isinstance(error, LinkError) else FaultCode.ORDER_REFUSED


def named_in(error: SemliveError, folder: Path) -> SemliveError:
    """The error of a refused start, of the same kind, with the place of its log in the text."""
    kind = next((kind for kind in _KINDS if isinstance(error, kind)), SemliveError)
    return kind(f"{error}; recorded in {folder}, which the next run of this name replaces")
