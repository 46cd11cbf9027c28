"""Settings of the exported files in a scenario."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import ConfigDict

from semlive_simulators.exporters import fei, hitachi, jeol, plain, tescan, zeiss
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels


class Vendor(StrEnum):
    """Vendor of the exporting software, or a plain format."""

    FEI = "fei"
    ZEISS = "zeiss"
    TESCAN = "tescan"
    JEOL = "jeol"
    HITACHI = "hitachi"
    TIFF = "tiff"
    PNG = "png"


class WriteStyle(StrEnum):
    """Order of the writes to a file."""

    DIRECT = "direct"
    RENAME = "rename"
    PREALLOCATE = "preallocate"


class Collision(StrEnum):
    """Behaviour if a file with the same name exists."""

    OVERWRITE = "overwrite"
    NUMBER = "number"


Encoder = Callable[[Pixels, ImageMetadata, int], EncodedFrame]
_ENCODERS: dict[Vendor, Encoder] = {
    Vendor.FEI: fei.encode,
    Vendor.ZEISS: zeiss.encode,
    Vendor.TESCAN: tescan.encode,
    Vendor.JEOL: jeol.encode,
    Vendor.HITACHI: hitachi.encode,
    Vendor.TIFF: plain.encode_tiff,
    Vendor.PNG: plain.encode_png,
}


@dataclass(frozen=True, slots=True)
class Export:
    """Settings of the exported files.

    Attributes:
        style: ``direct`` writes to the final name in chunks, ``rename`` to a temporary name that is renamed, ``preallocate`` to the final
            name, with zeros of the full size first.
        delay_s: time from the end of a scan to the first byte, s.
        duration_s: time from the first byte to the last, s; long on a slow network share.
        chunks: number of writes in that time.
        databar_rows: rows of the databar below the image; with Zeiss it replaces the last rows of the image.
        prefix: prefix of the file names.
        vendor: format of the files.
        clock_offset_s: clock of the microscope PC minus experiment time, s; it shifts the times in the files.
        sidecar_delay_s: time from the end of the image file to the sidecar, s, for vendors that write one.
        counter_restarts_after: number of files after which the number in the name restarts at 1; 0 never.
        collision: for a name that exists, ``overwrite`` replaces the old file, ``number`` appends ``_1``, ``_2``, ... to the new name.
        never_finished: frames, counted from 0, whose file is never completed, as after a crash of the software or a full disk.
        finished_part: fraction of the bytes of such a file that is written, 0 to 1.
        row_clock: whether the true start of each row is written to a text file with the name of the image, for vendors without one.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    style: WriteStyle
    delay_s: float
    duration_s: float
    chunks: int
    databar_rows: int
    prefix: str
    vendor: Vendor = Vendor.FEI
    clock_offset_s: float = 0.0
    sidecar_delay_s: float = 0.0
    counter_restarts_after: int = 0
    collision: Collision = Collision.OVERWRITE
    never_finished: tuple[int, ...] = ()
    finished_part: float = 0.6
    row_clock: bool = False

    def __post_init__(self) -> None:
        if self.chunks < 1:
            raise ValueError(f"chunks must be at least 1, not {self.chunks}")
        if min(self.delay_s, self.duration_s, self.sidecar_delay_s, self.databar_rows, self.counter_restarts_after) < 0:
            raise ValueError("times, databar_rows and counter_restarts_after must not be below zero")
        if not 0.0 <= self.finished_part < 1.0:
            raise ValueError(f"finished_part must be at least 0 and below 1, not {self.finished_part}")

    @property
    def suffix(self) -> str:
        """Suffix of the image files."""
        return ".png" if self.vendor is Vendor.PNG else ".tif"

    def file_name(self, frame: int) -> str:
        """Name of the image file of a frame, counted from 0."""
        number = frame % self.counter_restarts_after if self.counter_restarts_after else frame
        return f"{self.prefix}{number + 1:04d}{self.suffix}"

    def free_name(self, frame: int, exists: Callable[[str], bool]) -> str:
        """Name of the image file in a folder where some names exist already."""
        name = self.file_name(frame)
        if self.collision is Collision.OVERWRITE or not exists(name):
            return name
        stem = name.removesuffix(self.suffix)
        return next(numbered for count in itertools.count(1) if not exists(numbered := f"{stem}_{count}{self.suffix}"))

    def encode(self, image: Pixels, facts: ImageMetadata) -> EncodedFrame:
        """The files of a frame."""
        product = _ENCODERS[self.vendor](image, facts, self.databar_rows)
        if not self.row_clock or product.sidecar is not None:
            return product
        rows = "".join(f"{value!r}\n" for value in facts.row_start_s)
        return replace(product, sidecar=f"row_start_s\n{rows}".encode())
