"""Control's end of the analysis process: hand messages over, take results back, start it again when it dies."""

from __future__ import annotations

import contextlib
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from semlive.errors import SemliveError
from semlive.formats.log import LogMessage
from semlive.service.analysis import INPUT_TOPICS
from semlive.service.pipe import read_message, write_message
from semlive.service.process import start_apart

_MAX_RESTARTS = 3


class AnalysisLink:
    """Owns the child process and the two threads that keep its pipes moving.

    The child is a function of its input messages, so the numbers of inputs given and outputs taken say exactly where a
    new child has to go on; what came before it reads from the log.
    """

    def __init__(
        self, log: Path, flush: Callable[[], object], on_output: Callable[[LogMessage], None], on_trouble: Callable[[str, bool], None]
    ) -> None:
        """Start the child.

        Args:
            log: the growing log, for catching up.
            flush: returns when everything recorded so far can be read from the log.
            on_output: gets every output, in a thread of ours.
            on_trouble: gets a sentence, and whether the child is lost for good.
        """
        self._log, self._flush, self._on_output, self._on_trouble = log, flush, on_output, on_trouble
        self._given = self._taken = self._restarts = 0
        self._closing = False
        self._lock = threading.Lock()
        self._start([])

    def give(self, message: LogMessage) -> None:
        """Hand over the next message of the log; those that analysis does not read are passed over. Never blocks."""
        if message.topic in INPUT_TOPICS:
            with self._lock:
                self._given += 1
                self._queue.put(message)

    def close(self, timeout_s: float) -> None:
        """Let the child finish what it has, then end it; never raises."""
        self._closing = True
        with self._lock:
            self._queue.put(None)
        self._reader.join(timeout_s)
        if self._process.poll() is None:
            self._process.kill()
        self._reader.join(5.0)
        self._process.wait()

    def _start(self, arguments: list[str]) -> None:
        command = [sys.executable, "-m", "semlive.service.analysis", *arguments]
        self._process = start_apart(command, stdout=subprocess.PIPE)
        self._queue: queue.SimpleQueue[LogMessage | None] = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._write, args=(self._process, self._queue), name="analysis-writer", daemon=True)
        self._reader = threading.Thread(target=self._read, args=(self._process,), name="analysis-reader", daemon=True)
        self._writer.start()
        self._reader.start()

    @staticmethod
    def _write(process: subprocess.Popen[bytes], messages: queue.SimpleQueue[LogMessage | None]) -> None:
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
        with contextlib.suppress(SemliveError), stream:
            while (message := read_message(stream)) is not None:
                self._taken += 1
                self._on_output(message)
        code = process.wait()
        if not self._closing:
            self._again(code)

    def _again(self, code: int) -> None:
        self._queue.put(None)
        self._restarts += 1
        lost = self._restarts > _MAX_RESTARTS
        self._on_trouble(f"the analysis process died (exit code {code}); {'it is given up' if lost else 'it is started again'}", lost)
        if lost:
            return
        with self._lock:
            # Whatever was given is recorded already; once it is on disk the new child can read it there.
            self._flush()
            self._start(["--log", str(self._log), "--inputs", str(self._given), "--skip", str(self._taken)])
