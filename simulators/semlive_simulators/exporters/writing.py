"""How the files of a frame grow in the folder: a plan of writes, each at its time, and its execution."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from semlive_simulators.exporters.image_metadata import EncodedFrame
from semlive_simulators.exporters.settings import Export, WriteStyle


@dataclass(frozen=True, slots=True)
class Write:
    """Bytes that go to a place in a file.

    Attributes:
        due_s: when, seconds after the end of the scan.
        offset: where in the file.
        data: what.
    """

    due_s: float
    offset: int
    data: bytes


@dataclass(frozen=True, slots=True)
class FilePlan:
    """How one file comes into being.

    Attributes:
        name: it has in the end.
        working_name: it has while it is written.
        writes: in order of time.
        finished: the file becomes whole; otherwise it keeps its working name and lacks its last bytes.
    """

    name: str
    working_name: str
    writes: tuple[Write, ...]
    finished: bool = True

    @property
    def last_s(self) -> float:
        """When it is whole, seconds after the end of the scan."""
        return self.writes[-1].due_s


def plan_files(product: EncodedFrame, name: str, export: Export, frame: int = 0) -> tuple[FilePlan, ...]:
    """The image file, then its sidecar, which is small and comes at once or, beside an image that is never finished, not at all."""
    data, pieces = product.image, export.chunks
    bounds = [round(part * len(data) / pieces) for part in range(pieces + 1)]
    writes = [
        Write(export.delay_s + export.duration_s * (part + 1) / pieces, bounds[part], data[bounds[part] : bounds[part + 1]])
        for part in range(pieces)
    ]
    if export.style is WriteStyle.PREALLOCATE:
        writes.insert(0, Write(export.delay_s, 0, bytes(len(data))))
    working_name = f"{name}.tmp" if export.style is WriteStyle.RENAME else name
    if frame in export.never_finished:
        return (FilePlan(name, working_name, tuple(_until(writes, round(export.finished_part * len(data)), len(data))), finished=False),)
    image = FilePlan(name, working_name, tuple(writes))
    if product.sidecar is None:
        return (image,)
    beside = Path(name).with_suffix(".txt").name
    return image, FilePlan(beside, beside, (Write(image.last_s + export.sidecar_delay_s, 0, product.sidecar),))


def _until(writes: list[Write], end: int, whole: int) -> list[Write]:
    """The writes up to a byte of the file; what preallocates it stays, and what lies behind is never written."""
    preallocated = len(writes[0].data) == whole and len(writes) > 1
    kept = writes[:1] if preallocated else []
    for write in writes[len(kept) :]:
        if write.offset < end or not kept:
            kept.append(Write(write.due_s, write.offset, write.data[: max(0, end - write.offset)]))
    return kept


def write_file(plan: FilePlan, folder: Path, begin_ns: int, at: Callable[[float], AbstractContextManager[object]]) -> None:
    """Write a file as planned; its modification time is that of its last write.

    Args:
        plan: of the file.
        folder: where.
        begin_ns: from when the plan counts, UTC ns: the end of the scan, or of the export before.
        at: gives a context that begins when so many seconds have passed since then.
    """
    working, path = folder / plan.working_name, folder / plan.name
    first, *rest = plan.writes
    with at(first.due_s):
        stream = open(working, "wb", buffering=0)  # noqa: SIM115 - it stays open, as the instrument keeps it
        stream.write(first.data)
    with stream:
        for piece in rest:
            with at(piece.due_s):
                stream.seek(piece.offset)
                stream.write(piece.data)
    last_ns = begin_ns + round(plan.last_s * 1e9)
    os.utime(working, ns=(last_ns, last_ns))
    if working != path and plan.finished:
        os.replace(working, path)
