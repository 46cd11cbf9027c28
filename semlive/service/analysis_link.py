"""Control's end of the analysis process: hand messages over, take results back, start it again when it dies."""

from __future__ import annotations

import contextlib
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from semlive.formats.log import LogMessage
from semlive.service.analysis import INPUT_TOPICS
from semlive.service.pipe import read_message, write_message
from semlive.service.process import start_apart

_MAX_RESTARTS = 3
_FLUSH_AGAIN_S = 0.5

_Messages = queue.SimpleQueue[LogMessage | None]


class AnalysisLink:
    """Owns the child process and the two threads that keep its pipes moving.

    The child is a function of its input messages, so the numbers of inputs given and outputs taken say exactly where a
    new child has to go on; what came before it reads from the log.
    """

    def __init__(
        self, log: Path, flush: Callable[[], bool], on_output: Callable[[LogMessage], None], on_trouble: Callable[[str, bool], None]
    ) -> None:
        """Start the child.

        Args:
            log: the growing log, for catching up.
            flush: tries to bring everything recorded so far to where it can be read from the log, and says whether it did.
            on_output: gets every output, in a thread of ours.
            on_trouble: gets a sentence, and whether the child is lost for good.
        """
        self._log, self._flush, self._on_output, self._on_trouble = log, flush, on_output, on_trouble
        self._given = self._taken = self._restarts = 0
        self._closing = self._killed = False
        self._heard_s = time.monotonic()
        self._over = threading.Event()
        self._finished = False
        self._lock = threading.Lock()
        self._queue: _Messages = queue.SimpleQueue()
        self._process = self._start([], self._queue)

    def give(self, message: LogMessage) -> None:
        """Hand over the next message of the log; those that analysis does not read are passed over. Never blocks."""
        if message.topic in INPUT_TOPICS and not self._over.is_set():
            with self._lock:
                self._given += 1
                self._queue.put(message)

    def kill(self) -> None:
        """Do not wait for it any more."""
        self._killed = True
        self._over.set()
        self._process.kill()

    def drain(self, quiet_s: float) -> bool:
        """Let the child finish what it has, however long that takes while it keeps saying something, then end it; never raises.

        Returns:
            True if everything that it was given is analysed.
        """
        self._heard_s = time.monotonic()
        self._let_end()
        while not self._over.is_set() and (left_s := self._heard_s + quiet_s - time.monotonic()) > 0:
            self._over.wait(left_s)
        return self.close(0.0)

    def close(self, timeout_s: float) -> bool:
        """Let the child finish what it has, then end it; never raises, any number of times.

        Returns:
            True if everything that it was given is analysed.
        """
        self._let_end()
        if not self._over.wait(timeout_s):
            self.kill()
        with self._lock:
            reader, process = self._reader, self._process
        if process.poll() is None:
            process.kill()
        reader.join(5.0)
        process.wait()
        return self._finished

    def _let_end(self) -> None:
        with self._lock:
            self._closing = True
            self._queue.put(None)

    def _start(self, arguments: list[str], messages: _Messages) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "semlive.service.analysis", *arguments]
        process = start_apart(command, stdout=subprocess.PIPE)
        writer = threading.Thread(target=self._write, args=(process, messages), name="analysis-writer", daemon=True)
        self._reader = threading.Thread(target=self._read, args=(process,), name="analysis-reader", daemon=True)
        writer.start()
        self._reader.start()
        return process

    @staticmethod
    def _write(process: subprocess.Popen[bytes], messages: _Messages) -> None:
        stream = process.stdin
        if stream is None:
            return
        # A broken pipe here means that the child died; the reader notices and starts another.
        with contextlib.suppress(OSError):
            while (message := messages.get()) is not None:
                write_message(stream, message)
        with contextlib.suppress(OSError):
            stream.close()

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        stream = process.stdout
        if stream is None:
            return
        try:
            with stream:
                while (message := read_message(stream)) is not None:
                    self._taken += 1
                    self._heard_s = time.monotonic()
                    self._on_output(message)
        except Exception:
            # Whatever is wrong with what it says, a child that cannot be understood is as good as dead.
            process.kill()
        code = process.wait()
        if code == 0 and self._closing:
            self._finished = True
            self._over.set()
        elif not self._killed:
            self._again(code)

    def _again(self, code: int) -> None:
        self._restarts += 1
        lost = self._restarts > _MAX_RESTARTS
        with self._lock:
            # Whatever was given so far is recorded; once it is on disk the new child can read it there.
            self._queue.put(None)
            self._queue, given, taken = queue.SimpleQueue(), self._given, self._taken
            if self._closing:
                self._queue.put(None)
        with contextlib.suppress(RuntimeError):
            # The loop may be closed by now.
            self._on_trouble(f"the analysis process died (exit code {code}); {'it is given up' if lost else 'it is started again'}", lost)
        # The lock is free meanwhile: flushing takes as long as the disk likes, and the loop must be able to give.
        while not lost and not self._flush():
            lost = self._over.wait(_FLUSH_AGAIN_S)
        if lost:
            self._over.set()
            return
        with self._lock:
            if not self._killed:
                self._process = self._start(["--log", str(self._log), "--inputs", str(given), "--skip", str(taken)], self._queue)
