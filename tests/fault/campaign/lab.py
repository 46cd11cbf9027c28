"""The daemon as a process, with a stand and an export folder, into which the rows of the campaign inject faults."""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml
from stand import RtuPort, Stand, TcpPort

from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.microscope.scan import Scan

sys.path.insert(0, str(Path(__file__).parents[2]))
from waiting import PATIENCE_S, GrowingLog, logged

LIMITS = dict(force_min_n=-50.0, force_max_n=900.0, extension_min_mm=-1.0, extension_max_mm=1.0, force_rate_max_n_s=50.0)
HELPERS = """
import os, signal, time
def _block(*_):
    time.sleep(float(os.environ.get("SEMLIVE_TEST_BLOCK_S", "5")))
def _jump(*_):
    for name, step in (("time", 3600.0), ("time_ns", 3600 * 10**9)):
        real = getattr(time, name)
        setattr(time, name, lambda real=real, step=step: real() + step)
if "SEMLIVE_TEST_SIGNALS" in os.environ:
    signal.signal(signal.SIGUSR1, _block)
    signal.signal(signal.SIGUSR2, _jump)
"""


def until(condition: Callable[[], object], what: str, within_s: float = PATIENCE_S) -> float:
    """Wait for a condition; returns the time at which it was observed (monotonic s)."""
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s, f"within {within_s:g} s this did not happen: {what}"
        time.sleep(0.01)
    return time.monotonic()


@dataclass
class Run:
    """A daemon, its configuration, and its observable state."""

    folder: Path
    stand: Stand = field(default_factory=Stand)
    config: dict[str, Any] = field(default_factory=dict)
    started: list[subprocess.Popen[str]] = field(default_factory=list)
    operator: int | None = None
    frames: int = 0

    def __post_init__(self) -> None:
        self.export = self.folder / "export"
        self.export.mkdir(parents=True)
        self.growing = GrowingLog(self.log)
        self.config = {
            "run": {"name": "run", "folder": "log"},
            "sem": {"folder": "export", "pixel_size_um": 1.0, "poll_s": 0.05, "stable_for_s": 0.15, "profile": {"start_sigma_s": 0.01}},
            "dic": {"subset_px": 31, "step_px": 8, "roi_px": None},
            "protocol": {"loads_n": [400.0], "ramp_rate_n_s": 40.0, "settle_s": 0.2, "hold_s": 0.5, "load_tolerance_n": 20.0},
        }

    # ---- the daemon

    @property
    def log(self) -> Path:
        return self.folder / "log" / "run"

    @property
    def daemon(self) -> subprocess.Popen[str]:
        return self.started[-1]

    def start(self, *options: str, attended: bool = False) -> Self:
        """Start the daemon; with an operator at its terminal, or to end at a fault."""
        path = self.folder / "run.yaml"
        path.write_text(yaml.safe_dump(self.config), encoding="utf-8")
        helpers = self.folder / "helpers"
        helpers.mkdir(exist_ok=True)
        (helpers / "sitecustomize.py").write_text(HELPERS, encoding="utf-8")
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(helpers), *filter(None, [os.environ.get("PYTHONPATH")])]),
            "SEMLIVE_TEST_SIGNALS": "1",
        }
        terminal: int = subprocess.DEVNULL
        if attended:
            self.operator, terminal = pty.openpty()
        command = [sys.executable, "-m", "semlive", "run", str(path), *([] if attended else ["--stop-on-fault"]), *options]
        process = subprocess.Popen(command, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        if attended:
            os.close(terminal)
        self.started.append(process)
        return self

    def enter(self, line: str) -> None:
        """Enter a line as the operator."""
        assert self.operator is not None
        os.write(self.operator, f"{line}\n".encode())

    def logged(self, topic: str) -> list[dict[str, Any]]:
        """Messages of a topic; of a daemon that has ended also those after the last complete chunk."""
        lives = bool(self.started) and self.daemon.poll() is None
        return self.growing.logged(topic) if lives else logged(self.log, topic)

    def states(self) -> list[str]:
        return [change["after"] for change in self.logged("/state")]

    def causes(self) -> list[str]:
        return [change["cause"] for change in self.logged("/state")]

    def reach(self, state: str, times: int = 1) -> Self:
        until(lambda: self.growing.states().count(state) >= times or self.daemon.poll() is not None, f"the daemon is in {state}")
        if self.states().count(state) < times:
            raise AssertionError(f"the daemon ended before {state}: {self.end()}")
        return self

    def end(self, within_s: float = PATIENCE_S) -> tuple[int, str]:
        """Exit code, and the output on one line."""
        out, err = self.daemon.communicate(timeout=within_s)
        assert "Traceback" not in err, err
        return self.daemon.returncode, " ".join((out + err).split())

    def reported(self) -> str:
        """All faults and log lines so far."""
        return " | ".join([*(fault["what"] for fault in self.logged("/fault")), *(line["text"] for line in self.logged("/log"))])


@dataclass
class Lab(Run):
    """The environment of one row: the run, its devices and its microscope."""

    # ---- devices

    def over_tcp(self, **limits: float) -> TcpPort:
        """The stand as the load frame, over Modbus TCP."""
        port = TcpPort(self.stand)
        self._frame({"port": port.port}, limits)
        return port

    def over_rtu(self, **limits: float) -> RtuPort:
        """The stand as the load frame, over Modbus RTU."""
        port = RtuPort(self.stand)
        self._frame({"serial": {"port": port.path, "slowest_s": 0.6}}, limits)
        return port

    def _frame(self, settings: dict[str, Any], limits: dict[str, float]) -> None:
        self.config["load_frame"] = {"driver": "modbus", "settings": {"map": "bench", **settings}}
        further = {"force_step_max_n": 900.0, "stage_travel_um": 100.0, "stop_timeout_s": 4.0}
        self.config["limits"] = {**LIMITS, **further, **limits}

    def no_frame(self, shifts: list[list[float]] | None = None) -> None:
        """Configure a run without a load frame."""
        protocol = {"calibration_shifts_px": shifts or [[0, 0]], "settle_s": 0.2, "hold_s": 0.5, "frame_timeout_s": 600.0}
        self.config["protocol"] = protocol

    # ---- requirements after every fault

    def require_complete_log(self) -> None:
        """The log is closed, its samples are numbered without a gap, and the last state is final."""
        assert [path.name for path in self.log.glob("*.part")] == []
        numbers: list[int] = [sample["sequence"] for sample in self.logged("/load_frame/sample")]
        gaps = [(a, b) for a, b in itertools.pairwise(numbers) if b not in (a + 1, 0)]
        assert not gaps, gaps
        assert self.states()[-1] in ("aborted", "complete"), self.states()

    def stopped_ms(self, since_s: float) -> float:
        """Time from an instant to the end of the motion of the stand, ms."""
        until(lambda: not self.stand.moving, "the stand rests")
        times = [at_s for at_s, _ in self.stand.stops if at_s >= since_s]
        return 1e3 * (times[0] - since_s) if times else 0.0

    # ---- the microscope

    def picture(self, **how: Any) -> tuple[bytes, bytes | None]:
        """An exported image and its text file, as the microscope writes them; see `frame`."""
        return picture(self.folder, self.frames, **how)

    def frame(self, name: str | None = None, **how: Any) -> Path:
        """A complete image in the export folder, scanned just now."""
        data, text = self.picture(**how)
        self.frames += 1
        path = self.export / (name or f"frame_{self.frames:04d}.tif")
        working = path.with_suffix(".tmp")
        working.write_bytes(data)
        if text is not None:
            path.with_suffix(".txt").write_bytes(text)
        working.replace(path)
        return path

    def close(self) -> None:
        for process in self.started:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
                process.communicate()
        self.stand.over.set()
        with contextlib.suppress(OSError):
            if self.operator is not None:
                os.close(self.operator)


def picture(
    folder: Path,
    number: int,
    *,
    vendor: Vendor = Vendor.FEI,
    ago_s: float = 0.0,
    lasts_s: float = 0.2,
    clock_s: float = 0.0,
    contrast: float = 1.0,
    size: tuple[int, int] = (256, 221),
    seed: int = 7,
    bits: int = 8,
    line_passes: int = 1,
) -> tuple[bytes, bytes | None]:
    """An image of speckle whose scan ended `ago_s` ago, by a clock with an offset of `clock_s`."""
    dwell_s = 0.8 * lasts_s / (size[0] * size[1])
    scan = Scan(size[0], size[1], dwell_s, lasts_s, 0.0, 1.0, line_passes, "line" if line_passes > 1 else "frame")
    generator = np.random.default_rng(seed)
    coarse = generator.normal(size=(size[1] // 3 + 2, size[0] // 3 + 2))
    grey = np.kron(coarse, np.ones((3, 3)))[: size[1], : size[0]] * 45.0 * contrast + 128.0
    noisy = grey + np.random.default_rng(number + 1).normal(size=grey.shape) * (2.0 if contrast else 0.2)
    image = np.clip(noisy, 1, 254).astype(np.uint8) if bits == 8 else (np.clip(noisy, 1, 254) * 250).astype(np.uint16)
    end_ns = time.time_ns() - round(ago_s * 1e9) + round(clock_s * 1e9)
    facts = ImageMetadata(scan, end_ns, 12.5, -3.25, frame=number, name=f"frame_{number:04d}")
    files = Export(WriteStyle.DIRECT, 0.0, 0.0, 6, 20, "frame", vendor).encode(image, facts)
    return files.image, files.sidecar


@contextlib.contextmanager
def laboratory(folder: Path) -> Iterator[Lab]:
    """The environment of one row."""
    lab = Lab(folder)
    try:
        yield lab
    finally:
        lab.close()
