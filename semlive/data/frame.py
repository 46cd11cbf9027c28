"""Frames: images as the SEM exported them, and what is known of each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from semlive.data.scan import ScanTiming, Sourced


@dataclass(frozen=True, slots=True)
class ExportedFile:
    """One file that the SEM finished writing, as bytes.

    Attributes:
        index: running number of the exported file in this run, from 0, in order of arrival.
        name: file name without folder.
        data: the file's bytes.
        sha256: their SHA-256, hexadecimal.
        mtime_ns: the file's modification time, UTC ns.
        arrival_time_ns: experiment time when the watcher believed it complete, UTC ns.
        sidecar: bytes of the text file beside it, for vendors that write one; None if there is none.
        stable_time_ns: experiment time when the watcher first saw it as it stayed, UTC ns; 0 if unknown.
    """

    index: int
    name: str
    data: bytes
    sha256: str
    mtime_ns: int
    arrival_time_ns: int
    sidecar: bytes | None = None
    stable_time_ns: int = 0


@dataclass(frozen=True, slots=True)
class ColumnSettings:
    """How the microscope was set, as far as the file says; None where it does not.

    Attributes:
        detector: its name.
        voltage_v: acceleration voltage.
        working_distance_m: working distance.
        magnification: as the vendor counts it.
        scan_rotation_deg: rotation of the scan.
    """

    detector: Sourced[str] | None = None
    voltage_v: Sourced[float] | None = None
    working_distance_m: Sourced[float] | None = None
    magnification: Sourced[float] | None = None
    scan_rotation_deg: Sourced[float] | None = None


class FrameOrigin(StrEnum):
    """Origin of the pixels of a frame."""

    MICROSCOPE = "microscope"
    IMPORTED = "imported"
    """The frame has no pixels: another engine made its disparity maps. This value is stored as `FrameInfo.vendor`."""


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """Everything known of a frame but its pixels.

    Attributes:
        export: number of the exported file it came from.
        name: file name.
        vendor: ``fei``, ``plain``, ...
        width_px: image width without databar.
        height_px: image height without databar.
        databar_rows: rows cropped from below the image.
        timing: scan timing.
        start_time_ns: instant of pixel (0, 0), UTC ns.
        start_sigma_s: standard uncertainty of that instant.
        pixel_size_m: edge of a pixel on the specimen.
        column: how the microscope was set.
        start_anchor: what the embedded time was taken to mark: ``start``, ``end`` or ``save``.
        embedded_time_ns: the embedded time as the microscope's computer told it, taken for UTC; None if the file has none.
        notes: what is unusual about the file, one sentence each.
    """

    export: int
    name: str
    vendor: str
    width_px: int
    height_px: int
    databar_rows: int
    timing: ScanTiming
    start_time_ns: Sourced[int]
    start_sigma_s: float
    pixel_size_m: Sourced[float]
    column: ColumnSettings = ColumnSettings()
    start_anchor: str = "end"
    embedded_time_ns: int | None = None
    notes: tuple[str, ...] = ()

    @property
    def origin(self) -> FrameOrigin:
        """Origin of the pixels."""
        return FrameOrigin.IMPORTED if self.vendor == FrameOrigin.IMPORTED else FrameOrigin.MICROSCOPE

    @property
    def end_time_ns(self) -> int:
        """Instant when the scan ended, UTC ns."""
        return self.start_time_ns.value + round(self.timing.duration_s * 1e9)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame with its pixels.

    Attributes:
        info: what is known of it.
        image: (height, width), uint8 or uint16, read-only, databar cropped.
    """

    info: FrameInfo
    image: NDArray[np.uint8] | NDArray[np.uint16]

    def __post_init__(self) -> None:
        if self.image.shape != (self.info.height_px, self.info.width_px):
            raise ValueError(f"image is {self.image.shape}, info says {(self.info.height_px, self.info.width_px)}")
        self.image.setflags(write=False)
