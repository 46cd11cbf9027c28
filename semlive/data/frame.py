"""Frames: images as the SEM exported them, and what is known of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
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


@dataclass(frozen=True, slots=True, eq=False)
class PatternQuality:
    """Noise, speckle and the displacement noise to be expected of a frame.

    Where `usable` is False a POI's predictions are meaningless (zero), never a code.

    Attributes:
        grid: the POI.
        noise_grey: standard deviation of the white noise, median over the frame, rounding included.
        contrast_grey: standard deviation of the pattern, noise taken off.
        mean_grey: mean grey level.
        saturated_fraction: share of pixels at either end of the range of grey levels.
        speckle_x_px: size of speckle along x: full width at half maximum of the autocorrelation.
        speckle_y_px: the same along y.
        speckles_per_subset: how many of that size a subset has room for.
        mean_intensity_gradient_grey_px: mean length of the intensity's gradient, noise taken off.
        sssig: (ny, nx) smaller eigenvalue of a subset's sum of squared gradients, (grey/px)^2.
        sigma_u_px: (ny, nx) predicted standard deviation of u, both frames as noisy as this one.
        sigma_v_px: (ny, nx) the same of v.
        usable: (ny, nx) whether a POI has contrast enough to be correlated.
        warnings: what is too poor, with the figure and what to do; empty if all is well.
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
        """Predicted standard deviation of u and v of the middle usable POI; zero if none is usable."""
        if not self.usable.any():
            return 0.0, 0.0
        return float(np.median(self.sigma_u_px[self.usable])), float(np.median(self.sigma_v_px[self.usable]))

    @property
    def usable_fraction(self) -> float:
        """Share of the POI that can be correlated."""
        return float(np.mean(self.usable))
