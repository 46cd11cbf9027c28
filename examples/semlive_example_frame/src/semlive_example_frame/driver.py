"""The driver: everything that semlive asks of a load frame, over lines of JSON."""

from __future__ import annotations

import contextlib
import json
import math
import socket
from collections.abc import Mapping
from typing import Any

from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import ClockSource

_TIMEOUT_S = 0.5
_CONNECT_S = 0.3
_SETTINGS = {"host", "port"}


class ExampleLoadFrame:
    """The LoadFrame port. One thread owns it; every call blocks for at most one time-out.

    Raises:
        LinkRefused: if nobody answers.
    """

    def __init__(self, host: str, port: int, clock: ClockSource) -> None:
        self._where, self._address, self._clock = f"{host}:{port}", (host, port), clock
        self._sequence = 0
        self._failed = False
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
            stop_on_link_loss=StopOnLinkLoss.NONE,  # say VERIFIED only after the cable was pulled and the machine stopped
            force_max_n=float(who["force_max_n"]),
            control=ControlMode.LOAD,
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

    def stop_blind(self) -> bool:
        """Write a stop on the old connection and on a fresh one, wait for no answer, never raise; semlive calls it when a link failed."""
        request, written = b'{"do": "stop"}\n', False
        self._failed = True  # an answer to this must never be taken for the next one
        with contextlib.suppress(OSError):
            self._socket.sendall(request)
            written = True
        with contextlib.suppress(OSError), socket.create_connection(self._address, _CONNECT_S) as fresh:
            fresh.sendall(request)
            written = True
        return written

    def order_problem(self, force_n: float, rate_n_s: float) -> str | None:
        """Why a ramp cannot be ordered as it is meant; JSON holds any number, so only what is no number."""
        return None if math.isfinite(force_n) and 0 < rate_n_s < math.inf else f"{force_n:g} N at {rate_n_s:g} N/s cannot be ordered"

    def close(self) -> None:
        """Close the socket; never raises."""
        self._stream.close()
        self._socket.close()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        if self._failed:
            raise LinkError(f"the link to {self._where} failed; it must be opened again")
        try:
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            line = self._stream.readline()
            answer = json.loads(line)
        except (OSError, ValueError) as error:
            # A late answer must never be taken for the next one: this link takes only a last stop, semlive opens another.
            self._failed = True
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
