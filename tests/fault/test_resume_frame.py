"""After a kill in a ramp nothing moves before the operator resumes: seen at a load frame that shares no code with semlive."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.service.analysis.messages import READY_TEXT

from .by_hand import lives

PEERS = Path(__file__).parents[3] / "shared" / "peers"


@dataclass
class Frame:
    """The independent load frame, as seen from outside."""

    port: int
    log: Path

    def switch(self, words: str) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as item:
            item.sendto(words.encode("ascii"), ("127.0.0.1", self.port))

    def motions(self) -> int:
        """How many motions were ordered so far."""
        words = (line.split() for line in self.log.read_text(encoding="ascii", errors="replace").splitlines())
        return sum(not {"RAMP", "RAMP16", "MOVE"}.isdisjoint(line) for line in words)

    def says(self, word: str) -> bool:
        return word in self.log.read_text(encoding="ascii", errors="replace")


@pytest.fixture
def frame_peer(tmp_path: Path) -> Iterator[Frame]:
    """The independent load frame, compiled and started here."""
    compiler = shutil.which("cc")
    if compiler is None or not Path("/usr/include/modbus/modbus.h").exists() or not (PEERS / "frame.c").exists():
        pytest.skip("the independent load frame, libmodbus or a C compiler is not at hand")
    program, log = tmp_path / "frame", tmp_path / "frame.log"
    command = [compiler, "-O1", "-I/usr/include/modbus", "-o", program, PEERS / "frame.c", "-lmodbus", "-lm"]
    subprocess.run(command, check=True, timeout=120)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with subprocess.Popen([program, str(port), log, "8"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        yield Frame(port, log)
        process.kill()


def test_nothing_moves_after_a_kill_before_the_operator_resumes(
    patient: Any, frame_peer: Frame, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    settings = {"map": str(PEERS / "map_f32.yaml"), "host": "127.0.0.1", "port": frame_peer.port, "confirmed": True}
    patient.config["load_frame"] = {"driver": "modbus", "poll_s": 0.05, "settings": settings}
    patient.config["limits"]["force_rate_max_n_s"] = 200.0
    patient.config["protocol"].update(loads_n=[300.0], ramp_rate_n_s=10.0)
    terminal, operator = os.openpty()
    patient.start("--attended", operator=operator).reach("ramping")
    wait_until(lambda: frame_peer.motions() == 1)
    time.sleep(1.0)
    frame_peer.switch("wdog 2")
    patient.daemon.send_signal(signal.SIGKILL)
    patient.daemon.communicate()
    wait_until(lambda: frame_peer.says("OWN-WATCHDOG"))
    patient.start("--attended", "--resume", operator=operator).reach("recover")
    time.sleep(4.0)
    assert frame_peer.motions() == 1
    assert patient.logged("/state")[-1]["after"] == "recover"
    os.write(terminal, b"resume\n")
    wait_until(lambda: frame_peer.motions() == 2)
    patient.daemon.send_signal(signal.SIGINT)
    patient.end()
    os.close(terminal)
    os.close(operator)


def test_a_frame_that_was_restarted_after_a_kill_is_a_fault_and_yes_does_not_confirm_it(
    patient: Any, frame_peer: Frame, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    settings = {"map": str(PEERS / "map_f32.yaml"), "host": "127.0.0.1", "port": frame_peer.port, "confirmed": True}
    patient.config["load_frame"] = {"driver": "modbus", "poll_s": 0.05, "settings": settings}
    patient.config["limits"]["force_rate_max_n_s"] = 200.0
    patient.config["protocol"].update(loads_n=[300.0], ramp_rate_n_s=10.0)
    terminal, operator = os.openpty()
    patient.start("--attended", operator=operator).reach("ramping")
    wait_until(lambda: frame_peer.motions() == 1)
    wait_until(lambda: any(item["force_n"] > 15.0 for item in patient.logged("/load_frame/sample")))
    patient.daemon.send_signal(signal.SIGKILL)
    patient.daemon.communicate()
    frame_peer.switch("reboot 0")
    wait_until(lambda: frame_peer.says("CTL reboot"))
    patient.start("--attended", "--resume", "--yes", operator=operator).reach("fault")
    (fault,) = patient.logged("/fault")
    assert fault["code"] == "device_restarted"
    assert "target (holding register 0) holds 0 N, 300 N was written" in fault["what"]
    wait_until(lambda: sum(item["text"] == READY_TEXT for item in patient.logged("/log")) == 2)
    time.sleep(3.0)
    assert frame_peer.motions() == 1
    os.write(terminal, b"resume\n")
    patient.reach("recover")
    assert frame_peer.motions() == 1
    os.write(terminal, b"resume\n")
    wait_until(lambda: frame_peer.motions() == 2)
    patient.daemon.send_signal(signal.SIGINT)
    patient.end()
    os.close(terminal)
    os.close(operator)


def test_the_page_of_a_killed_run_and_its_analysis_end_with_it(
    patient: Any, frame_peer: Frame, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    """As in use: the command with its page, killed in a ramp."""
    settings = {"map": str(PEERS / "map_f32.yaml"), "host": "127.0.0.1", "port": frame_peer.port, "confirmed": True}
    patient.config["load_frame"] = {"driver": "modbus", "poll_s": 0.05, "settings": settings}
    patient.config["limits"]["force_rate_max_n_s"] = 200.0
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(patient.config), encoding="utf-8")
    command = [sys.executable, "-m", "semlive", "run", str(path), "--page-port", "0", "--attended"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    children: list[int] = []

    def both() -> bool:
        children[:] = _children(process.pid)
        return len(children) == 2 and frame_peer.motions() == 1

    try:
        wait_until(both)
    finally:
        process.kill()
        process.wait()
    wait_until(lambda: not any(lives(pid) for pid in children), 2.0)


def _children(pid: int) -> list[int]:
    """Analysis and page; not what looks at the system for a moment."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    found = [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return [child for child in found if b"semlive.service.runtime.child_process" in Path(f"/proc/{child}/cmdline").read_bytes()]
