"""There is no memory left: Linux ends the analysis, not control, or refuses it what it asks for, and the run loses nothing."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from ..waiting import RUN_END_S, GrowingLog, logged

ROOM_BYTES = 2 * 2**20  # of new memory, for control and analysis together
GROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Group:
    """A group of processes whose memory the kernel limits, and kills one of when they want more; cgroup version 1 or 2."""

    folder: Path
    limit: str
    none: str
    killed: str

    def allow(self, room: int | None) -> None:
        (self.folder / self.limit).write_text(self.none if room is None else str(room))

    def take_in(self, pid: int) -> None:
        (self.folder / "cgroup.procs").write_text(str(pid))

    def kills(self) -> int:
        lines = (item.split() for item in (self.folder / self.killed).read_text().splitlines())
        return next(int(count) for name, count in lines if name == "oom_kill")


@pytest.fixture
def kernel_peer() -> Iterator[Group]:
    name = f"semlive-{os.getpid()}"
    first = (GROUPS / "memory").is_dir()
    made = (
        Group(GROUPS / "memory" / name, "memory.limit_in_bytes", "-1", "memory.oom_control")
        if first
        else Group(GROUPS / name, "memory.max", "max", "memory.events")
    )
    try:
        made.folder.mkdir()
        made.allow(None)
    except OSError as error:
        pytest.skip(f"no group of processes can be made here: {error}")
    try:
        yield made
    finally:
        made.allow(None)
        for pid in (made.folder / "cgroup.procs").read_text().split():
            (made.folder.parent / "cgroup.procs").write_text(pid)
        made.folder.rmdir()


def test_linux_ends_the_analysis_first_and_the_run_loses_nothing(
    instrument: Callable[..., Any], wait_until: Callable[..., None], kernel_peer: Group
) -> None:
    item = instrument("out-of-memory")
    process, growing = item.start(), GrowingLog(item.log)
    wait_until(lambda: len(growing.logged("/pair")) == 2)
    (analysis,) = (int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split())
    kernel_peer.allow(ROOM_BYTES)
    for pid in (process.pid, analysis):
        kernel_peer.take_in(pid)
    wait_until(lambda: kernel_peer.kills() > 0)
    kernel_peer.allow(None)
    out, err = process.communicate(timeout=RUN_END_S)
    assert process.returncode == 0, out + err
    assert f"died (exit code -{int(signal.SIGKILL)})" in " ".join((out + err).split()), out + err
    (result,) = logged(item.log, "/result")
    assert result["pairs"] == 5
    maps = [(reported["reference"], reported["current"]) for reported in logged(item.log, "/dic/summary")]
    assert len(maps) == len(set(maps)) == 13


def test_an_analysis_that_is_refused_memory_does_not_hang(instrument: Callable[..., Any], wait_until: Callable[..., None]) -> None:
    """The thread that was to help it ended before it ran, and was waited for, while the process continued its heartbeats.

    Without that thread it continues with the memory that it has, or dies and is replaced.
    """
    item = instrument("refused-memory")
    process, growing = item.start(), GrowingLog(item.log)
    wait_until(lambda: len(growing.logged("/pair")) == 2)
    (analysis,) = (int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split())
    lines = Path(f"/proc/{analysis}/status").read_text().splitlines()
    size = next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmSize:"))
    resource.prlimit(analysis, resource.RLIMIT_AS, (size // 2, size // 2))  # nothing more, also of what it gave back
    out, err = process.communicate(timeout=RUN_END_S)
    assert process.returncode == 0, out + err
    (result,) = logged(item.log, "/result")
    assert result["pairs"] == 5
    maps = [(reported["reference"], reported["current"]) for reported in logged(item.log, "/dic/summary")]
    assert len(maps) == len(set(maps)) == 13
