"""A machine to try the driver with: a load that follows its target at a rate."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from typing import Any


class Machine:
    """Answers lines of JSON on a port of this computer until it is ended."""

    def __init__(self) -> None:
        self.deaf = False
        self._lock = threading.Lock()
        self._force_n = self._target_n = self._rate_n_s = 0.0
        self._since_s = time.monotonic()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def moving(self) -> bool:
        """Whether the load is on its way."""
        with self._lock:
            return self._advanced() != self._target_n

    def end(self) -> None:
        """Listen no more."""
        self._listening.close()

    def _advanced(self) -> float:
        now = time.monotonic()
        most = self._rate_n_s * (now - self._since_s)
        self._since_s = now
        self._force_n += max(-most, min(most, self._target_n - self._force_n))
        return self._force_n

    def _answer(self, request: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            force_n = self._advanced()
            if request["do"] == "who":
                return {"name": "example frame", "simulated": True, "force_max_n": 500.0}
            if request["do"] == "ramp":
                if abs(request["force_n"]) > 500.0:
                    return {"error": f"{request['force_n']} N is beyond 500 N"}
                self._target_n, self._rate_n_s = request["force_n"], request["rate_n_s"]
            elif request["do"] == "stop":
                self._target_n = force_n
            motion = "moving" if force_n != self._target_n else "stopped"
            return {"force_n": force_n, "extension_mm": force_n * 1e-4, "target_n": self._target_n, "motion": motion}

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        # A client may reset the connection: what it wrote last was a stop that nobody waited for.
        with contextlib.suppress(OSError), client, client.makefile("rb") as stream:
            for line in stream:
                if not self.deaf:
                    client.sendall(json.dumps(self._answer(json.loads(line))).encode() + b"\n")
