"""Frames: exported images of the SEM with their metadata and the expected quality of their correlation."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
from semlive.data.scan import ScanGeometry, ScanTiming, Sourced


@dataclass(frozen=True, slots=True)
class ExportedFile:
    """One complete file of the SEM, as bytes.

    Attributes:
        index: running number of the exported file in this run, from 0, in order of arrival.
        name: file name without folder.
        data: the file's bytes.
        sha256: SHA-256 of the bytes, hexadecimal.
        mtime_ns: the file's modification time, UTC ns.
        arrival_time_ns: experiment time when the watcher accepted it as complete, UTC ns.
        sidecar: bytes of the text file with metadata that some vendors write; None if there is none.
        stable_time_ns: experiment time when the watcher first saw its final size and time, UTC ns; 0 if unknown.
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
    """Settings of the microscope from the metadata of a file; None for missing values.

    Attributes:
        detector: name of the detector.
        voltage_v: acceleration voltage.
        working_distance_m: working distance.
        magnification: in the convention of the vendor.
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
    """Metadata of a frame.

    Attributes:
        export: number of the exported file.
        name: file name.
        vendor: ``fei``, ``plain``, ...
        width_px: image width without databar.
        height_px: image height without databar.
        databar_rows: rows of the databar, cropped from the bottom of the image.
        timing: scan timing.
        start_time_ns: instant of pixel (0, 0), UTC ns.
        start_sigma_s: standard uncertainty of that instant.
        pixel_size_m: edge of a pixel on the specimen.
        column: settings of the microscope.
        start_anchor: instant that the embedded time is assumed to mark: ``start``, ``end`` or ``save``.
        embedded_time_ns: embedded time by the clock of the microscope's computer, read as UTC; None if the file has none.
        notes: messages about unusual properties of the file.
        geometry: settings of the scan that change the geometry of the image.
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
    geometry: ScanGeometry = field(default_factory=ScanGeometry)

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
        info: metadata of the frame.
        image: (height, width), uint8 or uint16, read-only, databar cropped.
    """

    info: FrameInfo
    image: NDArray[np.uint8] | NDArray[np.uint16]

    def __post_init__(self) -> None:
        if self.image.shape != (self.info.height_px, self.info.width_px):
            raise ValueError(f"image is {self.image.shape}, its metadata give {(self.info.height_px, self.info.width_px)}")
        self.image.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class PatternQuality:
    """Noise and speckle pattern of a frame, and the displacement noise expected from them.

    Where `usable` is False a POI's predictions are meaningless (zero), never a code.

    Attributes:
        grid: the POI.
        noise_grey: standard deviation of the white noise, median over the frame, rounding included.
        contrast_grey: standard deviation of the pattern, noise subtracted.
        mean_grey: mean grey level.
        saturated_fraction: fraction of pixels at the ends of the range of grey levels.
        speckle_x_px: speckle size along x: full width at half maximum of the autocorrelation.
        speckle_y_px: speckle size along y.
        speckles_per_subset: number of speckles of that size in a subset.
        mean_intensity_gradient_grey_px: mean length of the intensity gradient, noise subtracted.
        sssig: (ny, nx) smaller eigenvalue of the subset's sum of squared subset intensity gradients, (grey/px)^2.
        sigma_u_px: (ny, nx) predicted standard deviation of u between two frames with this noise.
        sigma_v_px: (ny, nx) predicted standard deviation of v.
        usable: (ny, nx) whether the contrast at a POI suffices for correlation.
        warnings: insufficient quantities with their values and remedies; empty if there are none.
    """

    grid: Grid
    noise_grey: float
    contrast_grey: float
    mean_grey: float
    saturated_fraction: float
    speckle_x_px: float
    speckle_y_px: float
    speckles_per_subset: float
    mean_intensity_gradient_grey_px: float
    sssig: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    usable: NDArray[np.bool_]
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("sssig", "sigma_u_px", "sigma_v_px", "usable"):
            array = getattr(self, name)
            if array.shape != self.grid.shape:
                raise ValueError(f"{name} is {array.shape}, the grid is {self.grid.shape}")
            array.setflags(write=False)

    @property
    def median_sigma_px(self) -> tuple[float, float]:
        """Predicted standard deviation of u and v, medians over the usable POI; zero if none is usable."""
        if not self.usable.any():
            return 0.0, 0.0
        return float(np.median(self.sigma_u_px[self.usable])), float(np.median(self.sigma_v_px[self.usable]))

    @property
    def usable_fraction(self) -> float:
        """Fraction of usable POI."""
        return float(np.mean(self.usable))
