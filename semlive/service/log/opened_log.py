"""A log that is read once, from its beginning to its end."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from semlive.errors import BadLog
from semlive.formats.log.messages import RunMessage, from_json
from semlive.formats.log.reader import LogMessage
from semlive.service.log.files import messages

MAX_STORED_BYTES = 2**28
"""Largest amount of messages that are kept between a search and the reading; a larger one is read again."""


class OpenedLog:
    """The messages of a log, with a search among the first ones before all are read.

    Args:
        path: one file, or a run folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stored = deque[LogMessage]()
        self._unread = messages(path)
        self._was_read = False

    @cached_property
    def run(self) -> RunMessage:
        """The first `/run` message.

        Raises:
            BadLog: the log cannot be read or has none.
        """
        message = self.first("/run")
        if message is None:
            raise BadLog(f"{self.path}: holds no run's configuration; give a log that semlive wrote.")
        run = from_json(message.topic, message.payload)
        assert isinstance(run, RunMessage)  # by its topic
        return run

    def first(self, topic: str) -> LogMessage | None:
        """Return the first message of a topic; None if there is none.

        Raises:
            BadLog: the log cannot be read, or its messages were read already.
        """
        self._require_unread()
        for message in self._stored:
            if message.topic == topic:
                return message
        size = sum(len(message.payload) for message in self._stored)
        for message in self._unread:
            size += len(message.payload)
            if size <= MAX_STORED_BYTES:
                self._stored.append(message)
            if message.topic == topic:
                break
        else:
            message = None
        if size > MAX_STORED_BYTES:
            self._stored.clear()
            self._unread = messages(self.path)
        return message

    def messages(self) -> Iterator[LogMessage]:
        """Yield all messages once, in the order in which they were written.

        Raises:
            BadLog: the log cannot be read, or its messages were read already.
        """
        self._require_unread()
        self._was_read = True
        while self._stored:
            yield self._stored.popleft()
        yield from self._unread

    def _require_unread(self) -> None:
        if self._was_read:
            raise BadLog(f"{self.path}: its messages were read already.")
