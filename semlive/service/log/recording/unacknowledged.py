"""Messages that the disk has not acknowledged: their description, and verification by reading back.

After a failed fsync the system may have discarded buffered data, and the next fsync succeeds without them. A message is therefore safe only
after a successful fsync. Until then the recorder retains it in memory.
"""

from __future__ import annotations

import errno
import json
import os
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path

from semlive.formats.log.messages import SEM_ORIGINAL
from semlive.formats.log.reader import LogMessage, read_messages

_NAMED_FILES = 10
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# A write that fails with one of these errors does not change the file; the same write can be repeated later.
_NO_ROOM = frozenset({errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)})
_REPEATABLE = _NO_ROOM | {errno.EINTR, errno.EAGAIN}


def is_repeatable(error: OSError) -> bool:
    """Whether a refused write (not an fsync) can be repeated on the same file."""
    return error.errno in _REPEATABLE


def remedy(error: OSError) -> str:
    """What the operator should do about a refusal, an imperative clause."""
    return "make room on the disk" if error.errno in _NO_ROOM else "check the disk and its connection"


def described(messages: Sequence[LogMessage]) -> str:
    """Return a description of messages: number by topic, names of image files and interval of log times in UTC."""
    if not messages:
        return "no messages"
    counts = Counter(message.topic for message in messages)
    topics = ", ".join(f"{number} x {topic}" for topic, number in sorted(counts.items()))
    files = _original_names(messages)
    more = f" and {len(files) - _NAMED_FILES} more" if len(files) > _NAMED_FILES else ""
    images = f"; images: {', '.join(islice(files, _NAMED_FILES))}{more}" if files else ""
    return f"{topics}{images}; {_clock_time(messages[0].log_time_ns)} to {_clock_time(messages[-1].log_time_ns)} UTC"


def read_back(path: Path, expected: Sequence[LogMessage]) -> None:
    """Compare messages with what the disk returns, bypassing cached pages where the system allows it.

    Raises:
        OSError: the file cannot be read, or holds something else.
    """
    with path.open("rb") as stream:
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        read = read_messages(stream)
        same = all(next(read, None) == message for message in expected)
        if not same or next(read, None) is not None:
            raise OSError(errno.EIO, "the disk returns other bytes than were written")


def _original_names(messages: Sequence[LogMessage]) -> list[str]:
    """Return the names of the image files whose bytes the messages contain; the number of the export if no message contains the name."""
    names: dict[int, str] = {}
    for message in messages:
        if message.topic == "/sem/file":
            content = json.loads(message.payload)
            if isinstance(content.get("export"), int):
                names[content["export"]] = str(content.get("name", ""))
    return [names.get(message.sequence) or f"export {message.sequence}" for message in messages if message.topic == SEM_ORIGINAL]


def _clock_time(time_ns: int) -> str:
    return (_EPOCH + timedelta(microseconds=time_ns // 1000)).strftime("%H:%M:%S.%f")[:-3]
