"""A person at the machine: moves it as the daemon requests on the terminal, and types what is requested."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from .device import Device

_REQUEST = re.compile(r"bring the load to (?P<target>\S+) N at (?P<rate>\S+) N/s|STOP the motion")
_REACTION_S = 0.3
"""From a request to load until the person begins."""
_STATIONARY_S = 0.5
"""From the end of a motion until the person reads and types the load."""


class Hand:
    """Follows the terminal. A stop counts from the instant at which its request is displayed; the machine adds the reaction time.

    Args:
        types: the person types the load, because no load file shows it.
    """

    def __init__(self, types: bool) -> None:
        self._types, self._requests_seen = types, 0
        self._begin: tuple[float, str] | None = None
        self._stationary_s: float | None = None

    def follow(self, text: str, device: Device, enter: Callable[[str], None]) -> None:
        """Act on what the terminal shows so far.

        Args:
            text: all output of the daemon, on one line.
            device: the machine.
            enter: enters a line at the terminal.
        """
        now_s = time.monotonic()
        requests = list(_REQUEST.finditer(text))
        for request in requests[self._requests_seen :]:
            if request["target"] is None:
                device.switch("handstop 0")
                self._begin = self._stationary_s = None
            else:
                self._begin = (now_s + _REACTION_S, f"hand {request['target']} {request['rate']}")
        self._requests_seen = len(requests)
        if self._begin is not None and now_s >= self._begin[0]:
            device.switch(self._begin[1])
            self._begin, self._stationary_s = None, now_s + _STATIONARY_S
        if self._types and self._stationary_s is not None:
            self._type(now_s, device, enter)

    def _type(self, now_s: float, device: Device, enter: Callable[[str], None]) -> None:
        state = device.state()
        if state is None or self._stationary_s is None:
            return
        if state.moving:
            self._stationary_s = now_s + _STATIONARY_S
        elif now_s >= self._stationary_s:
            enter(f"{state.force_n:.1f}")
            self._stationary_s = None
