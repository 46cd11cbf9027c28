"""Parent side of the analysis process: reports new input, receives results, restarts the process after a crash or hang."""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.pipe import HEARTBEAT, read_message, write_count
from semlive.service.analysis.worker import INPUT_TOPICS, LOG_REPLACED
from semlive.service.log.files import messages
from semlive.service.runtime.process import start_child

# In a row, without a new output in between: what it dies of is in the log then, and it would die of it again.
_MAX_RESTARTS = 3
_LOOK_S = 1.0
# It beats every second, on a computer with twenty others at work sometimes only after four. Importing numerical packages comes before the
# first beat: seconds, on a busy computer a minute.
_SILENT_S = 60.0
_SILENT_AT_FIRST_S = 300.0
_REFUSED_S = 3.0
# A run that was stopped is not kept from its end by a child that stands still.
_SILENT_STOPPED_S = 8.0
_SILENT_STOPPED_AT_FIRST_S = 12.0


class AnalysisProcess:
    """Owner of the child process and its threads.

    The child reads its input from the log, as the page does, so control only sends the number of inputs. The outputs of the child are a
    function of that input, so the numbers of inputs and received outputs determine where a new child continues.
    """

    def __init__(
        self,
        log: Path,
        log_refused: Callable[[], bool],
        on_output: Callable[[LogMessage], None],
        on_trouble: Callable[[str, bool], None],
        before: tuple[int, int] = (0, 0),
    ) -> None:
        """Start the child.

        Args:
            log: the growing log.
            log_refused: whether recorded messages do not reach the readable log.
            on_output: callback with every output, in a separate thread.
            on_trouble: callback with a sentence, and whether the child is lost permanently.
            before: inputs and outputs that stand in the log already, of a run that is taken up again; the child catches up from there.
        """
        self._log, self._log_refused, self._on_output, self._on_trouble = log, log_refused, on_output, on_trouble
        self._given, self._taken = before
        # A child that is started again must find the log that the first one read.
        self._began_ns = next((message.log_time_ns for message in messages(log)), None) if self._given else None
        self._restarts = 0
        self._closing = self._killed = self._finished = False
        self._heard_s = time.monotonic()
        self._silent_s, self._has_spoken = 0.0, False
        self._over = threading.Event()
        self._changed = threading.Condition()
        self._start()
        threading.Thread(target=self._watch, name="analysis-watch", daemon=True).start()

    def notify_input(self, message: LogMessage) -> None:
        """Count a recorded message if it is an input of the analysis. Never blocks."""
        if self._began_ns is None:
            self._began_ns = message.log_time_ns
        if message.topic in INPUT_TOPICS and not self._over.is_set():
            with self._changed:
                self._given += 1
                self._changed.notify_all()

    def kill(self) -> None:
        """End the child without waiting for its results."""
        self._killed = True
        self._end()
        self._process.kill()

    def drain(self, quiet_s: float, stopped: bool = False) -> bool:
        """Wait for the remaining results while the child keeps writing outputs, then end it; never raises.

        There is no wait for a disk that rejects writes: the missing input is then not in the log.

        Args:
            quiet_s: wall seconds without a new output after which it is ended.
            stopped: the run was stopped before its end: a child that does not even say that it lives is ended after some seconds, and
                none is started in its place.

        Returns:
            True if all its input is analysed.
        """
        now_s = self._heard_s = taken_s = time.monotonic()
        self._let_end()
        while not self._over.wait(0.1) and now_s < self._heard_s + quiet_s and now_s < taken_s + _REFUSED_S:
            if stopped and self._silent_s > (_SILENT_STOPPED_S if self._has_spoken else _SILENT_STOPPED_AT_FIRST_S):
                break
            now_s = time.monotonic()
            taken_s = taken_s if self._log_refused() else now_s
        return self.close(0.0)

    def close(self, timeout_s: float) -> bool:
        """Wait for the remaining results, then end the child; never raises, may be called repeatedly.

        Returns:
            True if all its input is analysed.
        """
        self._let_end()
        if not self._over.wait(timeout_s):
            self.kill()
        with self._changed:
            reader, process = self._reader, self._process
        if process.poll() is None:
            process.kill()
        reader.join(5.0)
        process.wait()
        return self._finished

    def _let_end(self) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def _end(self) -> None:
        self._over.set()
        with self._changed:
            self._changed.notify_all()

    def _start(self) -> None:
        place = ["--log", str(self._log), "--inputs", str(self._given), "--skip", str(self._taken)]
        place += [] if self._began_ns is None else ["--began-ns", str(self._began_ns)]
        process = start_child("semlive.service.analysis.worker", ["--beat", *place], stdout=subprocess.PIPE)
        self._process = process
        self._silent_s, self._has_spoken = 0.0, False
        self._reader = threading.Thread(target=self._read, args=(process,), name="analysis-reader", daemon=True)
        threading.Thread(target=self._tell, args=(process,), name="analysis-writer", daemon=True).start()
        self._reader.start()

    def _tell(self, process: subprocess.Popen[bytes]) -> None:
        stream, reported = process.stdin, 0
        if stream is None:
            return
        # A broken pipe here means that the child died; the reader notices and starts another.
        with contextlib.suppress(OSError), stream:
            while (count := self._next_count(process, reported)) is not None:
                write_count(stream, count)
                reported = count

    def _next_count(self, process: subprocess.Popen[bytes], reported: int) -> int | None:
        """How much there is to read once that is more, however often it grew meanwhile; None if there will be no more for this child."""
        with self._changed:
            self._changed.wait_for(lambda: self._given > reported or self._closing or self._over.is_set() or process is not self._process)
            is_more = self._given > reported and not self._over.is_set() and process is self._process
            return self._given if is_more else None

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        stream = process.stdout
        if stream is None:
            return
        try:
            with stream:
                while (message := read_message(stream)) is not None:
                    self._silent_s, self._has_spoken = 0.0, True
                    if message != HEARTBEAT:
                        self._taken += 1
                        self._restarts = 0
                        self._heard_s = time.monotonic()
                        self._on_output(message)
        except Exception:
            # Whatever is wrong with what it says, a child that cannot be understood is as good as dead.
            process.kill()
        code = process.wait()
        if code == 0 and self._closing:
            self._finished = True
            self._end()
        elif not self._killed:
            self._again(code)

    def _watch(self) -> None:
        """End a child that hangs; the reader then starts a new one. Only time in which this process runs counts."""
        while not self._over.wait(_LOOK_S):
            self._silent_s += _LOOK_S
            if self._is_hung():
                with self._changed:
                    self._process.kill()

    def _is_hung(self) -> bool:
        return self._silent_s > (_SILENT_S if self._has_spoken else _SILENT_AT_FIRST_S)

    def _again(self, code: int) -> None:
        self._restarts += 1
        lost = self._restarts > _MAX_RESTARTS or code == LOG_REPLACED
        what = f"hung: it was silent for {self._silent_s:.0f} s" if self._is_hung() else f"died (exit code {code})"
        if code == LOG_REPLACED:
            what = f"ended: {self._log} was replaced by the log of another run"
        with contextlib.suppress(RuntimeError):
            # The loop may be closed by now.
            self._on_trouble(f"the analysis process {what}; {'it is given up' if lost else 'it is started again'}", lost)
        if lost:
            self._end()
            return
        with self._changed:
            if not self._killed:
                self._start()
            self._changed.notify_all()
