"""The messages of the daemon to a service manager, and the unit that enables them."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from semlive.cli.app import COMMANDS
from semlive.service.daemon.process_signals import SystemdNotifier

ROOT = Path(__file__).resolve().parents[3]
UNIT = ROOT / "deploy" / "semlive@.service"


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "notify"))
        one.setblocking(False)
        yield one


@pytest.fixture
def systemd_peer() -> str:
    found = shutil.which("systemd-analyze")
    if found is None:
        pytest.skip("no systemd-analyze")
    return found


def test_without_a_manager_nothing_is_reported() -> None:
    silent = SystemdNotifier({"WATCHDOG_USEC": "1000"})
    silent.ready("run a")
    assert silent.watchdog_s is None
    asyncio.run(silent.watchdog())


def test_ready_and_stopping_are_reported(manager: socket.socket) -> None:
    one = SystemdNotifier({"NOTIFY_SOCKET": manager.getsockname()})
    one.ready("run a")
    one.status("half way")
    one.stopping()
    assert [manager.recv(100) for _ in range(3)] == [b"READY=1\nSTATUS=run a", b"STATUS=half way", b"STOPPING=1"]


def test_abstract_names_are_understood() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind("\0semlive-test")
        SystemdNotifier({"NOTIFY_SOCKET": "@semlive-test"}).stopping()
        assert one.recv(100) == b"STOPPING=1"


def messages(manager: socket.socket) -> list[bytes]:
    """What has come since."""
    received = []
    while True:
        try:
            received.append(manager.recv(100))
        except BlockingIOError:
            return received


def test_the_watchdog_is_fed_by_a_running_loop_and_not_by_a_blocked_one(manager: socket.socket) -> None:
    beats, blocked = list[bytes](), list[bytes]()

    async def live(one: SystemdNotifier) -> float:
        began_s = time.monotonic()
        beating = asyncio.create_task(one.watchdog())
        while len(beats) < 4:
            await asyncio.sleep(0.005)
            beats.extend(messages(manager))
        took_s = time.monotonic() - began_s
        time.sleep(0.2)
        blocked.extend(messages(manager))
        beating.cancel()
        return took_s

    one = SystemdNotifier({"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "90000", "WATCHDOG_PID": "7"}, pid=7)
    assert one.watchdog_s == pytest.approx(0.09)
    took_s = asyncio.run(live(one))
    assert set(beats) == {b"WATCHDOG=1"}
    # The first at once, then one in each third of the time, not more often.
    assert took_s > 0.08
    assert blocked == []


def test_a_watchdog_of_another_process_is_not_ours(manager: socket.socket) -> None:
    assert SystemdNotifier({"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "9", "WATCHDOG_PID": "7"}, pid=8).watchdog_s is None


def test_a_missing_or_unresponsive_manager_stops_nothing(tmp_path: Path, manager: socket.socket) -> None:
    SystemdNotifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).stopping()
    unread = SystemdNotifier({"NOTIFY_SOCKET": manager.getsockname()})
    for _ in range(2000):
        unread.status("x" * 1000)


def test_the_daemon_reports_its_manager(tmp_path: Path, manager: socket.socket) -> None:
    (tmp_path / "export").mkdir()
    config = {
        "run": {"name": "waits", "folder": "log"},
        "sem": {"folder": "export", "pixel_size_um": 1.0},
        "stage": {"driver": "null"},
        "protocol": {"calibration_shifts_px": [[0, 0], [8, 0]]},
    }
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    command = [sys.executable, "-m", "semlive", "run", str(tmp_path / "run.yaml"), "--no-page", "--attended"]
    environ = {**os.environ, "NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "600000"}
    manager.settimeout(100.0)
    with subprocess.Popen(command, env=environ, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as daemon:
        received = []
        while not received or not received[-1].startswith(b"READY"):
            received.append(manager.recv(100))
        daemon.terminate()
        while received[-1] != b"STOPPING=1":
            received.append(manager.recv(100))
        daemon.wait(150)
    assert set(received) == {b"WATCHDOG=1", b"READY=1\nSTATUS=run waits", b"STOPPING=1"}


@pytest.mark.checkout
def test_the_unit_gives_away_little(systemd_peer: str, tmp_path: Path) -> None:
    unit = shutil.copy(UNIT, tmp_path / "semlive@trial.service")
    command = [systemd_peer, "security", "--offline=true", "--threshold=25", "--no-pager", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    assert (score := re.search(r"level for \S+: (\S+)", done.stdout)) is not None
    assert float(score[1]) <= 2.5


@pytest.mark.checkout
def test_the_unit_reports_what_the_daemon_keeps() -> None:
    text = UNIT.read_text(encoding="utf-8")
    required = (
        "Type=notify",
        "WatchdogSec=",
        "CacheDirectory=semlive",
        "NUMBA_CACHE_DIR=%C/semlive/jit",
        "MemoryDenyWriteExecute=no",
        "Restart=no",
    )
    assert not [one for one in required if one not in text]
    used = set(re.findall(r"/bin/semlive (\w+)", text))
    assert used <= {one.name for one in COMMANDS}
