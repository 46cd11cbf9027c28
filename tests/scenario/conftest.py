"""A small bench and the real daemon as processes, for tests that look at both from outside."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from pymodbus.client import ModbusTcpClient

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.service.log.tail import LogTail

from ..waiting import RUN_END_S, wait_until

RATE = 20.0
WATCHDOG = 2
"""Reason of a fault in register 300 of the bench: its watchdog expired."""
SCENARIO = """
extends: paper_x200
scan: {width_px: 320, height_px: 276, frame_time_s: 9.4}
export: {databar_rows: 30}
detector: {read_noise: 3.0, shot_noise: 0.25} # half the paper's noise, for a frame a tenth as large
experiment:
  protocol:
    calibration_shifts_px: [[0, 0], [6, 0], [0, 6]]
    translation_shifts_px: []
    loads_n: [100, 600]
"""


@dataclass
class Instrument:
    """A running bench and the configuration of a daemon for it.

    Attributes:
        folder: of the run.
        bench: content of the bench's ready.json.
        config: of the daemon.
        end_bench: ends the bench, for a module of which no further test needs it: it scans and renders frames all the time.
    """

    folder: Path
    bench: dict[str, Any]
    config: dict[str, Any]
    end_bench: Callable[[], None] = lambda: None

    @property
    def log(self) -> Path:
        return self.folder / "log" / self.config["run"]["name"]

    def wait_for_slow_answers(self) -> None:
        """Allow for a simulator that a busy computer lets answer late: a lost link is a fault, but none that the test is about."""
        for device in ("load_frame", "stage"):
            self.config[device]["settings"]["timeout_s"] = 4.0
        self.config["load_frame"]["settings"]["watchdog_s"] = 10.0  # a daemon may be kept from feeding it for some seconds
        self.config["limits"] = {**self.config.get("limits", {}), "stale_after_s": 5.0, "lost_after_s": 30.0}

    def write_config(self) -> Path:
        path = self.folder / "run.yaml"
        path.write_text(yaml.safe_dump(self.config), encoding="utf-8")
        return path

    def start(self, *options: str) -> subprocess.Popen[str]:
        """The daemon, in a process of its own."""
        command = [sys.executable, "-m", "semlive", "run", str(self.write_config()), "--no-page", "--stop-on-fault", *options]
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def run(self) -> tuple[int, str]:
        """Run the daemon to its end; exit code and printed text."""
        process = self.start()
        out, err = process.communicate(timeout=RUN_END_S)
        return process.returncode, out + err

    def unload(self) -> None:
        """Take off what the run before left on the specimen, as a person does at the machine; semlive does not."""
        client = ModbusTcpClient(self.bench["host"], port=self.bench["port"], timeout=20, retries=0)
        assert client.connect()
        unit = self.bench["unit"]

        def force_n() -> float:
            high, low = client.read_input_registers(4, count=2, device_id=unit).registers
            return struct.unpack(">f", struct.pack(">HH", high, low))[0]

        try:
            if abs(force_n()) > 5.0:
                target_and_rate = struct.unpack(">4H", struct.pack(">ff", 0.0, 100.0))
                nonce = time.monotonic_ns() // 1_000_000 % 65_536
                client.write_registers(0, [*target_and_rate, 1, nonce], device_id=unit)
                wait_until(lambda: abs(force_n()) < 5.0)
                wait_until(lambda: client.read_input_registers(3, count=1, device_id=unit).registers[0] == 0)
        finally:
            client.close()

    def load_frame_status(self) -> int:
        """Motion status of the load frame: 0 stopped, 1 moving, 2 in fault."""
        return self._input_register(3)

    def load_frame_at_rest(self) -> bool:
        """Whether the load frame is stopped, if only by its watchdog, which expires 2 s after the last heartbeat of a run."""
        status = self.load_frame_status()
        return status == 0 or (status == 2 and self._input_register(300) == WATCHDOG)

    def _input_register(self, address: int) -> int:
        client = ModbusTcpClient(self.bench["host"], port=self.bench["port"], timeout=20, retries=0)
        assert client.connect()
        try:
            return client.read_input_registers(address, count=1, device_id=self.bench["unit"]).registers[0]
        finally:
            client.close()


@pytest.fixture(scope="module")
def instrument(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Instrument]]:
    """Makes an instrument for a test: one bench for the module, with its `BENCH_EFFECTS` if it has any; a run folder for each test."""
    root = tmp_path_factory.mktemp("instrument")
    scenario = root / "small.yaml"
    scenario.write_text(SCENARIO + getattr(request.module, "BENCH_EFFECTS", ""), encoding="utf-8")
    with ExitStack() as stack:
        bench = stack.enter_context(running_simulator(str(scenario), root / "bench", RATE))

        def make(name: str) -> Instrument:
            folder = root / name
            folder.mkdir()
            config = daemon_config(bench, RATE)
            config["run"]["name"] = name
            config["dic"] = {"subset_px": 31, "step_px": 8, "roi_px": None}
            config["estimate"] = {"accept_poor_calibration": True}  # three pairs on a small frame determine no distortion
            config["protocol"]["load_tolerance_n"] = 20.0
            item = Instrument(folder, bench, json.loads(json.dumps(config)), stack.close)
            item.unload()
            return item

        yield make


@dataclass
class Watched:
    """The log of a run while it grows, read message by message: on a busy computer the complete log takes seconds to read.

    Attributes:
        log: run folder.
        messages: what was read so far, by topic.
    """

    log: Path
    messages: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    _tail: LogTail = field(init=False)

    def __post_init__(self) -> None:
        self._tail = LogTail(self.log)

    def until(self, true: Callable[[dict[str, list[dict[str, Any]]]], bool], process: subprocess.Popen[str], timeout_s: float) -> None:
        """Wait until the messages fulfil a condition, which is tested after every message."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            for item in self._tail.poll() if self.log.is_dir() else ():
                if item.topic in ("/state", "/pair", "/sem/scan", "/motion"):
                    self.messages.setdefault(item.topic, []).append(json.loads(item.payload))
                    if true(self.messages):
                        return
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        raise AssertionError("it did not come to that in time")


@pytest.fixture(scope="session")
def watched() -> Callable[[Path], Watched]:
    """Follows the log of a run."""
    return Watched
