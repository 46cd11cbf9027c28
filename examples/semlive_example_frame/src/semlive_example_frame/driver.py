"""The driver: everything that semlive asks of a load frame, over lines of JSON."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Mapping
from typing import Any

from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import ClockSource

_TIMEOUT_S = 0.5
_SETTINGS = {"host", "port"}


class ExampleLoadFrame:
    """The LoadFrame port. One thread owns it; every call blocks for at most one time-out.

    Raises:
        LinkRefused: if nobody answers.
    """

    def __init__(self, host: str, port: int, clock: ClockSource) -> None:
        self._where, self._clock = f"{host}:{port}", clock
        self._sequence = 0
        try:
            self._socket = socket.create_connection((host, port), _TIMEOUT_S)
        except OSError as error:
            raise LinkRefused(f"nobody answers at {self._where}; check that the frame is on and that host and port are right") from error
        self._stream = self._socket.makefile("rb")
        try:
            who = self._ask({"do": "who"})
        except LinkError:
            self.close()
            raise
        self._identity = DeviceIdentity(
            name=f"{who['name']} at {self._where}",
            simulated=bool(who["simulated"]),
            stop_on_link_loss=StopOnLinkLoss.ABSENT,  # say VERIFIED only after the cable was pulled and the machine stopped
            force_max_n=float(who["force_max_n"]),
        )

    @property
    def identity(self) -> DeviceIdentity:
        """Who answers."""
        return self._identity

    def read(self) -> LoadSample:
        """One fresh reading; what is no number is no reading."""
        said = self._ask({"do": "read"})
        force_n, extension_mm = float(said["force_n"]), float(said["extension_mm"])
        if not (math.isfinite(force_n) and math.isfinite(extension_mm)):
            raise LinkError(f"{self._where} says {force_n} N and {extension_mm} mm, which is no reading; check the sensors")
        sample = LoadSample(
            sequence=self._sequence,
            time_ns=self._clock.now_ns(),
            mono_ns=self._clock.mono_ns(),
            force_n=force_n,
            extension_mm=extension_mm,
            motion=MotionState(said["motion"]),
            target_n=float(said["target_n"]),
        )
        self._sequence += 1
        return sample

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Start; the machine says back what it took."""
        taken = self._ask({"do": "ramp", "force_n": force_n, "rate_n_s": rate_n_s})
        if taken.get("target_n") != force_n:
            raise LinkError(f"{self._where} took {taken} instead of {force_n:g} N; check the machine's limits")

    def stop(self) -> None:
        """Stop and hold."""
        self._ask({"do": "stop"})

    def close(self) -> None:
        """Close the socket; never raises."""
        self._stream.close()
        self._socket.close()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            line = self._stream.readline()
            answer = json.loads(line)
        except (OSError, ValueError) as error:
            # A late answer must never be taken for the next one: this link is done, semlive opens another.
            self.close()
            raise LinkError(f"{self._where} gave no answer within {_TIMEOUT_S:g} s; check cable and machine") from error
        if "error" in answer:
            raise LinkError(f"{self._where} refused: {answer['error']}")
        return answer


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> ExampleLoadFrame:
    """The factory that the entry point names.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody answers.
    """
    for key in settings:
        if key not in _SETTINGS:
            raise BadConfig(f"example_json load frame: no setting is called {key!r}; it has {', '.join(sorted(_SETTINGS))}")
    host, port = settings.get("host", "127.0.0.1"), settings.get("port")
    if not isinstance(host, str) or not isinstance(port, int):
        raise BadConfig("example_json load frame: port is missing or no number; give the machine's TCP port")
    return ExampleLoadFrame(host, port, clock)
