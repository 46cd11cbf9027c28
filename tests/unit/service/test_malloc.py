"""What is read and done with does not stay in memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

from semlive.formats.log.messages import FileMessage, from_json, to_json
from semlive.service.runtime.memory import trim_heap

MESSAGES = 5000


def test_names_in_messages_are_not_cached() -> None:
    """pydantic caches short strings that it reads, unless this is switched off: 0.1 kB for every exported file."""

    def read(number: int) -> None:
        reported = FileMessage(
            export=number,
            name=f"scan_{number}.tif",
            size=1,
            sha256="",
            mtime_ns=1,
            arrival_time_ns=1,
            decision="arrived",
            reason=f"r{number}",
        )
        from_json("/sem/file", to_json(reported))

    read(0)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for number in range(1, MESSAGES):
            read(number)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 10 * MESSAGES


def resident_kb() -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return int(next(line for line in lines if line.startswith("RssAnon")).split()[1])


def test_what_lies_free_in_between_is_given_back() -> None:
    if not Path("/proc/self/status").exists():  # only on Linux
        return
    blocks = [bytearray(b"x") * 20_000 for _ in range(4000)]
    stored = blocks[::50]
    full = resident_kb()
    del blocks
    trim_heap()
    assert full - resident_kb() > 50_000
    assert all(stored)
