"""Growth of the files of a frame in the folder: a plan of writes with their times, and its execution."""

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
    """One write to a file.

    Attributes:
        due_s: time, seconds after the end of the scan.
        offset: position in the file, bytes.
        data: bytes to write.
    """

    due_s: float
    offset: int
    data: bytes


@dataclass(frozen=True, slots=True)
class FilePlan:
    """The plan of one file.

    Attributes:
        name: final name.
        working_name: name while it is written.
        writes: writes in the order of time.
        finished: whether the file becomes complete; otherwise it keeps its working name and lacks its last bytes.
    """

    name: str
    working_name: str
    writes: tuple[Write, ...]
    finished: bool = True

    @property
    def last_s(self) -> float:
        """Time of the last write, seconds after the end of the scan."""
        return self.writes[-1].due_s


def plan_files(product: EncodedFrame, name: str, export: Export, frame: int = 0) -> tuple[FilePlan, ...]:
    """Plans of the image file and of its sidecar, which is written in one piece; an image that is never finished has no sidecar."""
    data, chunks = product.image, export.chunks
    bounds = [round(part * len(data) / chunks) for part in range(chunks + 1)]
    writes = [
        Write(export.delay_s + export.duration_s * (part + 1) / chunks, bounds[part], data[bounds[part] : bounds[part + 1]])
        for part in range(chunks)
    ]
    if export.style is WriteStyle.PREALLOCATE:
        writes.insert(0, Write(export.delay_s, 0, bytes(len(data))))
    working_name = f"{name}.tmp" if export.style is WriteStyle.RENAME else name
    if frame in export.never_finished:
        return (FilePlan(name, working_name, tuple(_until(writes, round(export.finished_part * len(data)), len(data))), finished=False),)
    image = FilePlan(name, working_name, tuple(writes))
    if product.sidecar is None:
        return (image,)
    sidecar = Path(name).with_suffix(".txt").name
    return image, FilePlan(sidecar, sidecar, (Write(image.last_s + export.sidecar_delay_s, 0, product.sidecar),))


def _until(writes: list[Write], end: int, size: int) -> list[Write]:
    """The writes up to a byte of a file of a size; a write that preallocates the file is retained."""
    preallocated = len(writes[0].data) == size and len(writes) > 1
    retained = writes[:1] if preallocated else []
    for write in writes[len(retained) :]:
        if write.offset < end or not retained:
            retained.append(Write(write.due_s, write.offset, write.data[: max(0, end - write.offset)]))
    return retained


def write_file(plan: FilePlan, folder: Path, begin_ns: int, at: Callable[[float], AbstractContextManager[object]]) -> None:
    """Write a file as planned; its modification time is that of its last write.

    Args:
        plan: plan of the file.
        folder: the export folder.
        begin_ns: start of the plan, UTC ns: the end of the scan, or of the previous export.
        at: returns a context that begins a number of seconds after the start of the plan.
    """
    working, path = folder / plan.working_name, folder / plan.name
    first, *rest = plan.writes
    with at(first.due_s):
        stream = open(working, "wb", buffering=0)  # noqa: SIM115 - it stays open between writes, as with an instrument
        stream.write(first.data)
    with stream:
        for write in rest:
            with at(write.due_s):
                stream.seek(write.offset)
                stream.write(write.data)
    last_ns = begin_ns + round(plan.last_s * 1e9)
    os.utime(working, ns=(last_ns, last_ns))
    if working != path and plan.finished:
        os.replace(working, path)
