"""Helpers of several tests: a clock that the test sets, a folder that is watched by it, images, and whether a process runs."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path

import numpy as np
import tifffile

from semlive.data.frame import ExportedFile
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

from ..clocks import HandClock


class Watched:
    """A watched folder under a clock that is moved by hand, in steps of one second."""

    def __init__(self, path: Path, **settings: object) -> None:
        self.path, self.clock = path, HandClock()
        self.files: list[ExportedFile] = []
        self.refused: list[RejectedFile] = []
        self.troubles: list[str] = []
        self.notices: list[str] = []
        chosen = WatchSettings(path, **{"give_up_after_s": 20.0, **settings})  # type: ignore[arg-type]
        self.folder = ExportFolder(chosen, self.clock, self.files.append, self.refused.append, self.troubles.append, self.notices.append)
        self.folder.open()

    def wait(self, seconds: int) -> None:
        for _ in range(seconds):
            self.folder.poll()
            self.clock.ns += 10**9

    def write(self, name: str, data: bytes) -> None:
        (self.path / name).write_bytes(data)
        os.utime(self.path / name, ns=(self.clock.ns, self.clock.ns))


def image(seed: int) -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, np.random.default_rng(seed).integers(0, 255, (40, 50), dtype=np.uint8), metadata=None)
    return stream.getvalue()


def lives(pid: int) -> bool:
    """Whether a process runs or is suspended; a zombie does not run."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"
