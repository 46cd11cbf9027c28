"""One trial: the device, the real daemon as a process, an operator at its terminal, and a microscope that exports frames."""

from __future__ import annotations

import contextlib
import json
import math
import os
import pty
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from semlive.errors import SemliveError
from semlive.service.log.tail import LogTail

from .building import ROOT
from .configuration import configuration
from .device import Device, running
from .frames import FrameWriter
from .hand import Hand
from .observation import observe
from .scenario import Act, Ending, Fault, Observed, Peer, Scenario, When

_FRAME_EVERY_S = 0.45
_TRIAL_MAX_S = 150.0
_REFUSES_WITHIN_S = 45.0
_LATE_ACT_S = 10.0
_STARTS_WITHIN_S = 40.0
_WAITING = {"fault", "estopped"}
_RUNS_ON = {Ending.COMPLETE, Ending.RECOVERED, Ending.SAFE}
_OVER = {"complete", "aborted"}
_UNHARMED = {"ratex": 1.0, "targx": 1.0, "fneglim": 1e9, "sat": 1e9}
"""Values of the independent frame's switches that are not off at 0."""
_NO_SWITCHES = {"F", "E", "K", "cnt", "goto", "reboot", "drop", "settarget", "press", "break", "slip", "hand", "handstop"}
_PATHS = os.pathsep.join(str(ROOT / part) for part in ("", "drivers", "simulators"))


@dataclass
class Daemon:
    """`semlive run` with its terminal; its output goes into a file."""

    process: subprocess.Popen[bytes]
    terminal: int
    output: Path
    started_s: float

    def type_line(self, word: str) -> None:
        """Type a line at its terminal."""
        os.write(self.terminal, f"{word}\n".encode())

    def signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.process.poll() is None:
            self.process.send_signal(number)

    def end(self, within_s: float = 25.0) -> int | None:
        """Terminate it; its exit code, or None if it had to be killed because it did not end within a time."""
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        code: int | None = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self.process.wait(within_s)
        if code is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        os.close(self.terminal)
        return code

    def output_text(self) -> str:
        """What it printed so far, on one line, without control sequences."""
        text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.output.read_text(encoding="utf-8", errors="replace"))
        return " ".join(text.split())


@dataclass
class Follower:
    """Content of the log of the run while it grows; instants are those of reading, CLOCK_MONOTONIC in s."""

    log: Path
    tail: LogTail | None = None
    states: list[tuple[str, int | None, float]] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    loaded_pairs: int = 0

    def follow(self) -> None:
        """Read what is new."""
        if self.tail is None:
            if not self.log.is_dir():
                return
            self.tail = LogTail(self.log)
        try:
            for message in self.tail.poll():
                if message.topic == "/state":
                    fields = json.loads(message.payload)
                    self.states.append((fields["after"], fields["step"], time.monotonic()))
                elif message.topic == "/fault":
                    fields = json.loads(message.payload)
                    self.faults.append(Fault(fields["time_ns"], fields.get("code", ""), fields["what"], fields["action"]))
                elif message.topic == "/pair":
                    self.loaded_pairs += json.loads(message.payload)["step"]["phase"] == "tension"
        except SemliveError:
            return  # a segment that is being renamed is read at the next call

    @property
    def state(self) -> str:
        """The present state, empty before the first."""
        return self.states[-1][0] if self.states else ""


class Trial:
    """A scenario while it is carried out."""

    def __init__(self, scenario: Scenario, device: Device, folder: Path, peers: Path) -> None:
        self.scenario, self.device = scenario, device
        self._folder, self._peers = folder, peers
        self._export = folder / "export"
        self._export.mkdir()
        self.log = folder / "log" / "run"
        self.follower = Follower(self.log)
        self._writer, self._frame_s = FrameWriter(self._export), 0.0
        self.fault_s: float | None = None
        self.daemons = list[Daemon]()
        self._started = self._states_before = 0
        self.second: Daemon | None = None
        self.foreign = list[tuple[float, int]]()
        self.begun_s = time.monotonic()
        self._hand = Hand(scenario.hand == "types") if scenario.hand else None

    # ---- actions on the daemon

    def start(self, *options: str, name: str = "run", loads_n: list[float] | None = None) -> Daemon:
        """Start a daemon on the scenario's configuration."""
        path = self._folder / f"{name}.yaml"
        path.write_text(configuration(self.scenario, self._peers, self.device.port, self._folder, name, loads_n), encoding="utf-8")
        ours, theirs = pty.openpty()
        self._started += 1
        output = self._folder / f"{name}.{self._started}.txt"
        command = [sys.executable, "-m", "semlive", "run", str(path), "--attended", "--no-page", *options]
        environment = {**os.environ, "PYTHONPATH": _PATHS, "COLUMNS": "600"}
        with output.open("wb") as file:
            process = subprocess.Popen(
                command, stdin=theirs, stdout=file, stderr=subprocess.STDOUT, cwd=self._folder, env=environment, start_new_session=True
            )
        os.close(theirs)
        return Daemon(process, ours, output, time.monotonic())

    def restart(self, *options: str) -> None:
        """Start the daemon of the run, again after one that ended."""
        self.follower.follow()
        self._states_before = len(self.follower.states)
        self.daemons.append(self.start(*options))

    @property
    def daemon(self) -> Daemon:
        """The daemon of the run, started last."""
        return self.daemons[-1]

    def _act(self, command: str) -> None:
        if not command.startswith("!"):
            self.device.switch(command)
            return
        word, _, rest = command[1:].partition(" ")
        ACTIONS[word](self, rest)

    # ---- the course of the trial

    def carry_out(self) -> Observed:
        """Run it to its end."""
        acts = list(self.scenario.acts)
        while acts and not acts[0].when.state:
            self._perform(acts.pop(0))
        self.restart()
        last_act_s, fault_detected_s = time.monotonic(), None
        longest_s = _REFUSES_WITHIN_S if self.scenario.expected.ending is Ending.REFUSED else _TRIAL_MAX_S
        watch_s = math.inf if self.scenario.expected.ending in _RUNS_ON else self.scenario.watch_s
        while True:
            self.follower.follow()
            self._expose()
            if self._hand is not None:
                self._hand.follow(self.daemon.output_text(), self.device, self.daemon.type_line)
            now_s = time.monotonic()
            if self._is_starting(now_s):
                last_act_s = now_s
            if acts and self._is_due(acts[0].when):
                self._perform(acts.pop(0))
                last_act_s, fault_detected_s = now_s, None
            if self.follower.state in _WAITING and fault_detected_s is None:
                fault_detected_s = now_s
            ended = self.daemon.process.poll() is not None
            watched = fault_detected_s is not None and now_s > fault_detected_s + self.scenario.linger_s
            watched |= self.fault_s is not None and now_s > last_act_s + watch_s
            watched &= self.follower.state not in _OVER
            if ended or (watched and not acts) or now_s > self.begun_s + longest_s:
                break
            if acts and fault_detected_s is not None and now_s > fault_detected_s + self.scenario.linger_s + _LATE_ACT_S:
                break  # a fault came before an act whose instant cannot come any more
            time.sleep(0.01)
        return self._observed()

    def _is_starting(self, now_s: float) -> bool:
        """The daemon has not come to its first decision yet; on a busy computer that takes as long as a complete scenario."""
        new = self.follower.states[self._states_before :]
        return now_s < self.daemon.started_s + _STARTS_WITHIN_S and all(state == "connecting" for state, _, _ in new)

    def _perform(self, act: Act) -> None:
        if act.is_fault and self.fault_s is None:
            self.fault_s = time.monotonic()
        for command in act.commands:
            self._act(command)

    def _is_due(self, when: When) -> bool:
        reached = [at_s for state, step, at_s in self.follower.states if state == when.state and when.step in (None, step)]
        if not reached:
            return False
        since_s = reached[0]
        if when.force_n is not None:
            passed = [item.at_s for item in self.device.samples if item.at_s >= since_s and item.force_n >= when.force_n]
            if not passed:
                return False
            since_s = passed[0]
        return time.monotonic() >= since_s + when.after_s

    def _expose(self) -> None:
        if self.follower.state != "imaging" or self.daemon.process.poll() is not None:
            return
        now_s = time.monotonic()
        second = self.second
        if second is not None and second.process.poll() is None and now_s < second.started_s + _STARTS_WITHIN_S:
            return  # the first run continues for the time in which the second may be refused
        if now_s > self.follower.states[-1][2] + self.scenario.frames_after_s and now_s > self._frame_s + _FRAME_EVERY_S:
            self._writer.write()
            self._frame_s = now_s

    def _observed(self) -> Observed:
        ended_s, by_itself = time.monotonic(), self.daemon.process.poll() is not None
        waits = self.follower.state in {"recover", "paused"}
        self.follower.follow()
        counted = None if by_itself else len(self.follower.faults)
        second = ""
        if self.second is not None:
            code = self.second.end()
            second = f"second run: exit status {code}: {self.second.output_text()}"
        self._end_faults()
        exit_code = self.daemon.end(self.scenario.ends_within_s)
        self.follower.follow()
        return observe(self, ended_s, by_itself, exit_code, waits, second, counted)

    def _end_faults(self) -> None:
        """Switch off what the scenario switched on, so that the end of the run does not wait for a device that cannot rest."""
        names = {command.split()[0] for act in self.scenario.acts for command in act.commands if not command.startswith("!")}
        for name in names - _NO_SWITCHES:
            default = _UNHARMED.get(name, 0.0) if self.scenario.peer is Peer.C else 0.0
            self.device.switch(f"{name} {default:g}")

    def close(self) -> None:
        """Kill whatever still runs."""
        for item in (*self.daemons, *([self.second] if self.second else [])):
            if item.process.poll() is None:
                os.killpg(item.process.pid, signal.SIGKILL)
                item.process.wait()


def _signal(trial: Trial, name: str) -> None:
    trial.daemon.signal(getattr(signal, f"SIG{name}"))


def _type_line(trial: Trial, word: str) -> None:
    trial.daemon.type_line(word)


def _restart(trial: Trial, options: str) -> None:
    """Kill the daemon if it runs, and start it again with options such as ``--resume``."""
    if trial.daemon.process.poll() is None:
        trial.daemon.process.kill()
        trial.daemon.process.wait()
    trial.restart(*options.split())


def _second(trial: Trial, loads: str) -> None:
    """Start a run with another name on the same device, with these loads."""
    trial.second = trial.start(name="second", loads_n=[float(load) for load in loads.split()])


def _same(trial: Trial, options: str) -> None:
    """Start the same run again while the first one runs."""
    trial.second = trial.start(*options.split())


def _order(trial: Trial, words: str) -> None:
    """Another master orders the independent frame: ``1 TARGET RATE`` a ramp, ``2`` a stop."""
    command, target_n, rate_n_s = (float(word) for word in [*words.split(), "0", "0"][:3])
    floats = [half for value in (target_n, rate_n_s) for half in reversed(struct.unpack(">HH", struct.pack(">f", value)))]
    pdu = struct.pack(">BBHHB5H", 1, 16, 0, 5, 10, *floats, int(command))
    trial.foreign.append((time.monotonic(), int(command)))
    with socket.create_connection(("127.0.0.1", trial.device.port), 2.0) as link:
        link.sendall(struct.pack(">HHH", 4711, 0, len(pdu)) + pdu)
        link.recv(100)


def _delete(trial: Trial, _: str) -> None:
    """Delete the folder of the run, and start the same configuration again while it runs."""
    shutil.rmtree(trial.log)
    trial.second = trial.start()


ACTIONS: dict[str, Callable[[Trial, str], None]] = {
    "signal": _signal,
    "type": _type_line,
    "restart": _restart,
    "second": _second,
    "same": _same,
    "order": _order,
    "delete": _delete,
}
"""Actions on the daemon, by the name of a command that begins with ``!``."""


def carry_out(scenario: Scenario, command: Callable[[int, Path], list[str]], folder: Path, peers: Path) -> Observed:
    """Carry out a scenario in a folder of its own.

    Args:
        scenario: which.
        command: makes the command line of its device from port and log.
        folder: empty.
        peers: folder of the independent frame.

    Raises:
        RuntimeError: the device did not start.
    """
    folder.mkdir(parents=True)
    with running(command, folder) as device:
        trial = Trial(scenario, device, folder, peers)
        try:
            return trial.carry_out()
        finally:
            trial.close()
