"""How the instrument writes its files, as a scenario says it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from pydantic import ConfigDict

from semlive_simulators.exporters import fei, hitachi, jeol, plain, tescan, zeiss
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels


class Vendor(StrEnum):
    """Whose software exports."""

    FEI = "fei"
    ZEISS = "zeiss"
    TESCAN = "tescan"
    JEOL = "jeol"
    HITACHI = "hitachi"
    TIFF = "tiff"
    PNG = "png"


class WriteStyle(StrEnum):
    """How a file comes into being."""

    DIRECT = "direct"
    RENAME = "rename"
    PREALLOCATE = "preallocate"


class Collision(StrEnum):
    """What software does when a file of that name is there already."""

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
    """How the instrument writes its files.

    Attributes:
        style: ``direct`` writes the final name bit by bit, ``rename`` a temporary name that is renamed, ``preallocate`` the
            final name at full size, zeros first.
        delay_s: from the end of a scan to the first byte.
        duration_s: from the first byte to the last; long on a slow share.
        chunks: writes in that time.
        databar_rows: rows of the databar below the image; Zeiss burns it into the image's last rows.
        prefix: of the file names.
        vendor: whose files they are.
        clock_offset_s: clock of the microscope's PC minus experiment time; shifts the times inside the files.
        sidecar_delay_s: from the end of the image file to the sidecar, for vendors that have one.
        counter_restarts_after: files after which the number in the name begins at 1 again; 0 never.
        collision: what becomes of a file whose name is taken: ``overwrite`` replaces the old one, ``number`` adds ``_1``, ``_2``, ...
        never_finished: frames, counted from 0, whose file is begun and never finished, as when the software or its disk gives up.
        finished_part: part of such a file's bytes that is written, 0 to 1.
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

    def __post_init__(self) -> None:
        if self.chunks < 1:
            raise ValueError(f"chunks must be at least 1, not {self.chunks}")
        if min(self.delay_s, self.duration_s, self.sidecar_delay_s, self.databar_rows, self.counter_restarts_after) < 0:
            raise ValueError("times, databar_rows and counter_restarts_after must not be below zero")
        if not 0.0 <= self.finished_part < 1.0:
            raise ValueError(f"finished_part must be at least 0 and below 1, not {self.finished_part}")

    @property
    def suffix(self) -> str:
        """Of the image files."""
        return ".png" if self.vendor is Vendor.PNG else ".tif"

    def file_name(self, frame: int) -> str:
        """Name of the image file of a frame, counted from 0."""
        number = frame % self.counter_restarts_after if self.counter_restarts_after else frame
        return f"{self.prefix}{number + 1:04d}{self.suffix}"

    def free_name(self, frame: int, taken: Callable[[str], bool]) -> str:
        """Name of the image file in a folder where some names are taken."""
        name = self.file_name(frame)
        if self.collision is Collision.OVERWRITE or not taken(name):
            return name
        stem = name.removesuffix(self.suffix)
        return next(other for count in itertools.count(1) if not taken(other := f"{stem}_{count}{self.suffix}"))

    def encode(self, image: Pixels, facts: ImageMetadata) -> EncodedFrame:
        """The files of a frame."""
        return _ENCODERS[self.vendor](image, facts, self.databar_rows)
