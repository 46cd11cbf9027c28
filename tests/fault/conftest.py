"""The real daemon as a process, with drivers that fall ill on request."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from ..waiting import GrowingLog, logged, wait_until

ENTRY_POINTS = """
[semlive.load_frames]
sick = sick_driver:SickLoadFrame
[semlive.stages]
sick = sick_driver:SickStage
[semlive.triggers]
sick = sick_driver:Sick
"""


@dataclass
class Patient:
    """A daemon whose devices are sick, and what is known of it from outside."""

    folder: Path
    config: dict[str, Any]
    process: subprocess.Popen[str] | None = None
    started: list[subprocess.Popen[str]] = field(default_factory=list)
    growing: GrowingLog = field(init=False)

    def __post_init__(self) -> None:
        self.growing = GrowingLog(self.log)

    @property
    def log(self) -> Path:
        return self.folder / "log" / "run"

    @property
    def daemon(self) -> subprocess.Popen[str]:
        assert self.process is not None
        return self.process

    def start(self, *options: str, stderr: int = subprocess.PIPE, operator: int | None = None) -> Patient:
        """Start the daemon; with a terminal for the operator it waits at a fault, without one it ends."""
        packages = self.folder / "packages"
        (packages / "sick-1.0.dist-info").mkdir(parents=True, exist_ok=True)
        (packages / "sick-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: sick\nVersion: 1.0\n")
        (packages / "sick-1.0.dist-info" / "entry_points.txt").write_text(ENTRY_POINTS)
        path = self.folder / "run.yaml"
        path.write_text(yaml.safe_dump(self.config), encoding="utf-8")
        given = os.environ.get("PYTHONPATH", "")
        where = os.pathsep.join([str(packages), str(Path(__file__).with_name("sick")), *([given] if given else [])])
        command = [sys.executable, "-m", "semlive", "run", str(path), "--no-page", *([] if operator else ["--stop-on-fault"]), *options]
        environment = {**os.environ, "PYTHONPATH": where}
        self.process = subprocess.Popen(
            command, stdin=operator or subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=stderr, text=True, env=environment
        )
        self.started.append(self.process)
        return self

    def falls_ill(self, ill: str, times: int | None = None) -> None:
        """Permanently, or for this number of calls."""
        path = self.folder / "ills" / ill
        path.with_name("being written").write_text("" if times is None else str(times), encoding="utf-8")
        path.with_name("being written").replace(path)

    def gets_well(self, ill: str) -> None:
        (self.folder / "ills" / ill).unlink()

    def calls(self, name: str = "load frame") -> list[str]:
        """Calls of a device that are no readings, in order."""
        path = self.folder / "ills" / "calls"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [line.removeprefix(f"{name} ") for line in lines if line.startswith(name) and not line.endswith(" read")]

    def logged(self, topic: str) -> list[dict[str, Any]]:
        """Messages of a topic; of a daemon that has ended also those after the last complete chunk."""
        return self.growing.logged(topic) if self.daemon.poll() is None else logged(self.log, topic)

    def reach(self, state: str) -> Patient:
        wait_until(lambda: state in self.growing.states() or self.daemon.poll() is not None)
        assert self.daemon.poll() is None, self.daemon.communicate()
        return self

    def rest(self, state: str) -> Patient:
        """Wait for a state, then for a reading of the load frame at rest since: only then can an operator resume."""
        self.reach(state)
        since_ns = next(change["time_ns"] for change in reversed(self.logged("/state")) if change["after"] == state)
        samples = partial(self.logged, "/load_frame/sample")
        wait_until(lambda: any(item["time_ns"] > since_ns and item["motion"] == "stopped" for item in reversed(samples())))
        return self

    def child(self) -> int:
        """The analysis process."""
        tasks = Path(f"/proc/{self.daemon.pid}/task").iterdir()
        (item,) = (pid for task in tasks for pid in (task / "children").read_text().split())
        return int(item)

    def end(self, timeout_s: float = 45.0) -> tuple[int, str]:
        """Exit code and the last line on standard error."""
        _, err = self.daemon.communicate(timeout=timeout_s)
        assert "Traceback" not in err, err
        return self.daemon.returncode, " ".join(err.split())

    def is_in_order(self) -> None:
        """The last order to the machine was a stop, and the log is complete."""
        after_last_ramp = self.calls()[::-1]
        assert "stop" in after_last_ramp[: after_last_ramp.index("ramp_to")], self.calls()
        assert [item.name for item in self.log.iterdir()] == ["run.000.mcap"]


@pytest.fixture
def patient(tmp_path: Path) -> Any:
    for name in ("export", "ills"):
        (tmp_path / name).mkdir()
    ills = str(tmp_path / "ills")
    limits = dict(force_min_n=-50.0, force_max_n=900.0, extension_min_mm=-1.0, extension_max_mm=1.0, force_rate_max_n_s=50.0)
    item = Patient(
        tmp_path,
        {
            "run": {"name": "run", "folder": "log"},
            "sem": {"folder": "export", "pixel_size_um": 1.0, "poll_s": 0.05, "stable_for_s": 0.1},
            "load_frame": {"driver": "sick", "settings": {"ills": ills, "name": "load frame"}},
            "limits": {**limits, "force_step_max_n": 900.0, "stage_travel_um": 100.0},
            "dic": {"subset_px": 31, "step_px": 8, "roi_px": None},
            "protocol": {"loads_n": [800.0], "ramp_rate_n_s": 10.0, "settle_s": 0.1, "hold_s": 0.0},
        },
    )
    yield item
    for process in item.started:
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            process.communicate()


@pytest.fixture(scope="session")
def preloaded_peer(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Libraries that make the system fail for a process into which they are preloaded, compiled here from the folder `sick`."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("a C compiler is not installed")
    folder = tmp_path_factory.mktemp("preloaded")

    def compiled(name: str) -> Path:
        library = folder / f"{name}.so"
        if not library.exists():
            source = Path(__file__).with_name("sick") / f"{name}.c"
            subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source], check=True, timeout=120)
        return library

    return compiled


@pytest.fixture(scope="session")
def disk_peer(preloaded_peer: Callable[[str], Path]) -> Path:
    """A library that makes a disk fail."""
    return preloaded_peer("sick_disk")


@pytest.fixture(scope="session")
def clock_peer(preloaded_peer: Callable[[str], Path]) -> Path:
    """A library that steps the wall clock."""
    return preloaded_peer("sick_clock")
