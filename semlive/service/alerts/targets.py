"""Addresses of alerts, read from a file of their own: they contain passwords, so neither configuration nor log holds them."""

from __future__ import annotations

import importlib.util
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.service.config.sections import AlertEvent

if TYPE_CHECKING:
    from apprise import Apprise

_MAX_BYTES = 65_536
_MAX_TARGETS = 16
_TIMEOUTS = "cto=5&rto=10"
"""Longest time for a connection and for a reply, s, as parameters of an address."""

_LEVELS: dict[AlertEvent | None, str] = {AlertEvent.FAULT: "failure", AlertEvent.QUESTION: "warning"}
"""Types of messages of Apprise, which services show as a colour or sign; "info" for the other events."""


@dataclass(frozen=True, slots=True)
class AlertTarget:
    """One address.

    Attributes:
        label: line of the file and kind of address, without anything secret.
        url: the address, with time limits.
    """

    label: str
    url: str


def read_targets(path: Path) -> tuple[AlertTarget, ...]:
    """Read a file with one address on each line, as Apprise writes them (https://github.com/caronc/apprise/wiki); `#` begins a comment.

    Raises:
        BadConfig: the file cannot be read or holds no address, a line is no address, there are more than 16, or Apprise is not installed.
            No message contains an address.
    """
    if importlib.util.find_spec("apprise") is None:
        raise BadConfig("alerts: Apprise is not installed; install semlive[alerts], or remove the section alerts")
    try:
        text = read_regular(path, _MAX_BYTES).decode("utf-8")
    except OSError as error:
        raise BadConfig(f"alerts.file {path}: cannot be read ({error.strerror}); give a file with one address on each line") from error
    except UnicodeDecodeError as error:
        raise BadConfig(f"alerts.file {path}: is not UTF-8 text; save it as UTF-8") from error
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    targets = tuple(_target(path, number, line) for number, line in lines if line and not line.startswith("#"))
    if not 0 < len(targets) <= _MAX_TARGETS:
        raise BadConfig(f"alerts.file {path}: holds {len(targets)} addresses; give 1 to {_MAX_TARGETS}, one on each line")
    return targets


def send(target: AlertTarget, title: str, text: str, event: AlertEvent | None = None) -> bool:
    """Send one alert; blocks for at most about 15 s for each connection. Returns whether the address accepted it."""
    return bool(_apprise(target.url).notify(title=title, body=text, notify_type=_LEVELS.get(event, "info")))


def _target(path: Path, number: int, line: str) -> AlertTarget:
    scheme = line.partition("://")[0]
    if "://" not in line or not len(_apprise(line)):
        raise BadConfig(
            f"alerts.file {path}, line {number}: is no address that Apprise knows; write one like json://host/path or mailto://user:password@host"
        )
    return AlertTarget(f"line {number} ({scheme})", f"{line}{'&' if '?' in line else '?'}{_TIMEOUTS}")


def _apprise(url: str) -> Apprise:
    from apprise import Apprise  # noqa: PLC0415  (0.2 s, and only runs with alerts need it)

    # Its messages on the console would contain parts of the address.
    logging.getLogger("apprise").setLevel(logging.CRITICAL + 1)
    service = Apprise()
    service.add(url)
    return service
