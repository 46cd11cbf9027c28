"""Folder, log and clock of a run: locking, the segments of an interrupted run, the recorder, and the folder of a refused start.

Theory of operation
-------------------
The daemon calls these functions once, at the start, in the main thread; reading the log of a long run blocks for seconds. Each resource is
pushed on the exit stack of the daemon, which closes the log after everything that writes to it. The path of a new folder is locked before
the folder exists, because another process may hold the lock of a deleted folder there.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from types import TracebackType

from semlive.errors import BadConfig, BadInput
from semlive.service.config.configuration import Config
from semlive.service.control.previous_segments import PreviousSegments
from semlive.service.control.resume import read_previous_segments
from semlive.service.daemon.refused_start import remove_refused_start
from semlive.service.log.files import segment_path
from semlive.service.log.lock import held_itself, only_one_at, run_lock
from semlive.service.log.recording import Recorder
from semlive.service.log.repair import repair_partial_segments
from semlive.service.log.run_log import RunLog
from semlive.service.runtime.clock import SimulatedClock, SystemClock, boot_id, open_clock

LOG_TIMEOUT_S = 10.0
"""Longest wait for a slow disk at the end of the run, s."""
LOG_REFUSED_S = 3.0
"""Longest wait for a disk that rejects writes at the end of the run, s; shorter than for a slow disk."""


class RunFolder:
    """Folder of a run and its log.

    Args:
        config: configuration of the run.
        on_disk_trouble: callback with a message on a write error, in the thread of the recorder.
    """

    def __init__(self, config: Config, on_disk_trouble: Callable[[str], None]) -> None:
        self._config, self._on_disk_trouble = config, on_disk_trouble
        self.path = config.run.folder / config.run.name
        self.replaced_start: str | None = None
        """Reason of an earlier refused start whose log this run replaced."""
        self.keep = False
        """Keep the folder after bad input: devices were opened."""
        self.log_ended = False
        """The log was ended, so that closing it again does not wait a second time."""

    def previous_segments(self, stack: contextlib.ExitStack) -> PreviousSegments:
        """Lock the folder of an interrupted run and return the state in its log.

        Raises:
            BadConfig: there is no such run, it is complete, it is running, or its configuration differs.
            BadLog: the log cannot be read.
        """
        if self.path.is_dir():
            stack.enter_context(run_lock(self.path))
            repair_partial_segments(self.path)
        return read_previous_segments(self.path, self._config)

    def open_clock(self, previous: PreviousSegments | None) -> SystemClock | SimulatedClock:
        """Open the clock of the run, which must be ahead of the log.

        Raises:
            BadConfig: the clock cannot be read, or is behind the end of the log.
        """
        clock = open_clock(self._config.run.clock_file, None if previous is None else previous.clock_line(boot_id()))
        if previous is not None and clock.now_ns() <= previous.last_log_time_ns:
            behind_s = (previous.last_log_time_ns - clock.now_ns()) / 1e9
            raise BadConfig(f"{self.path}: the clock is {behind_s:.1f} s behind the end of the run's log; set it right, then resume")
        return clock

    def open_log(
        self, stack: contextlib.ExitStack, clock: SystemClock | SimulatedClock, previous: PreviousSegments | None
    ) -> tuple[RunLog, Recorder]:
        """Create the folder of a new run, or repair the last segment of a resumed one, and open the next segment.

        Raises:
            BadConfig: the folder exists already, or cannot be created.
        """
        if previous is None:
            self._make(stack)
        else:
            # The last segment is repaired first; `previous` lists the damage.
            repair_partial_segments(self.path)
        recorder = Recorder(
            segment_path(self.path, self._config.run.name, 0 if previous is None else previous.segment),
            clock,
            self._on_disk_trouble,
            after_ns=0 if previous is None else previous.last_log_time_ns,
            segment_bytes=round(self._config.run.segment_gb * 1e9),
        )
        # There is no second wait for a disk that rejected writes at the end of the run.
        stack.callback(lambda: recorder.close(0.0 if self.log_ended else LOG_TIMEOUT_S, LOG_REFUSED_S))
        return RunLog(recorder, None if previous is None else previous.alarms), recorder

    def _make(self, stack: contextlib.ExitStack) -> None:
        """Create the folder of a new run. Its path is locked first, because another process may hold the lock of a deleted folder there."""
        try:
            # A parent that is a file makes mkdir fail below.
            with contextlib.suppress(FileExistsError):
                self.path.parent.mkdir(parents=True)
            stack.enter_context(only_one_at(self.path))
            self.replaced_start = remove_refused_start(self.path)
            self.path.mkdir()
        except FileExistsError:
            raise BadConfig(f"{self.path}: this run exists already; give run.name another name, or --resume to continue it") from None
        except OSError as error:
            raise BadConfig(f"{self.path}: cannot be created ({error.strerror}); correct run.folder") from error
        stack.push(self._remove_refused)
        stack.enter_context(held_itself(self.path))

    def _remove_refused(self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None) -> None:
        """Remove the folder after bad input before a device was opened, so that the run can be started again after a correction."""
        if isinstance(error, BadInput) and not self.keep:
            shutil.rmtree(self.path, ignore_errors=True)
