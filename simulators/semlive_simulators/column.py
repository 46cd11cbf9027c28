"""The column: where the beam is when, and what it sees there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict

from semlive_simulators.effects.distortion import Distortion
from semlive_simulators.effects.drift import Drift
from semlive_simulators.kernels.raster import raster_rows
from semlive_simulators.specimen import Motion, Speckle


@dataclass(frozen=True, slots=True)
class Scan:
    """One raster scan over the field of view.

    Attributes:
        width_px: pixels in a row.
        height_px: rows.
        dwell_time_s: time on a pixel.
        frame_time_s: time of all rows, fly-back included.
        gap_s: between the end of a scan and the start of the next when scanning continuously.
        pixel_size_um: edge of a pixel on the specimen.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    width_px: int
    height_px: int
    dwell_time_s: float
    frame_time_s: float
    gap_s: float
    pixel_size_um: float

    def __post_init__(self) -> None:
        if self.width_px * self.dwell_time_s > self.row_time_s:
            raise ValueError(f"a row takes {self.row_time_s} s, too little for {self.width_px} px of {self.dwell_time_s} s")

    @property
    def row_time_s(self) -> float:
        """From the start of a row to the start of the next."""
        return self.frame_time_s / self.height_px

    @property
    def centre_px(self) -> NDArray[np.float64]:
        """Centre of the frame, (x, y)."""
        return np.array([0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1)])


@dataclass(frozen=True, slots=True)
class Detector:
    """How signal becomes grey.

    Attributes:
        offset: grey level of the bare metal.
        gain: grey levels from bare metal to gold.
        read_noise: standard deviation of the noise that is always there, grey levels.
        shot_noise: variance of the noise per grey level of signal.
        seed: of the noise.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    offset: float
    gain: float
    read_noise: float
    shot_noise: float
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A microscope looking at a speckle.

    Attributes:
        scan: the raster.
        detector: signal to grey.
        speckle: what is looked at.
        drift: wanders in time.
        distortion_px: E at every scan address in x and in y, (height, width) each.
    """

    scan: Scan
    detector: Detector
    speckle: Speckle
    drift: Drift
    distortion_px: tuple[NDArray[np.float64], NDArray[np.float64]]

    def render_rows(self, out: NDArray[np.uint8], first_row: int, start_time_s: float, motion: Motion, frame: int) -> None:
        """Write rows of a frame.

        Args:
            out: (rows, width) uint8, written.
            first_row: its first row's number.
            start_time_s: when the scan began, seconds since the run began.
            motion: of the specimen, covering these rows' times.
            frame: number of the scan; decides its noise.
        """
        scan, detector, speckle = self.scan, self.detector, self.speckle
        rows = np.arange(first_row, first_row + out.shape[0] + 1)
        maps = self.row_maps(start_time_s + rows * scan.row_time_s, motion)
        ex_px, ey_px = self.distortion_px
        raster_rows(
            out, first_row, ex_px, ey_px, maps, scan.dwell_time_s / scan.row_time_s,
            speckle.seed, speckle.pitch_px, speckle.radius_px, speckle.radius_spread, speckle.presence, speckle.edge_px,
            detector.offset, detector.gain, detector.read_noise, detector.shot_noise, detector.seed, frame,
        )  # fmt: skip

    def row_maps(self, time_s: ArrayLike, motion: Motion) -> NDArray[np.float64]:
        """The affine maps [A | b] from undistorted scan address to material point at times (n,): (n, 2, 3).

        p = R - E(R) - d(t) is where the beam is; the point xi seen there fulfils p = xi + s + G (xi - c), so
        xi = A (p - c - s) + c with A = (1 + G)^-1.
        """
        times = np.asarray(time_s, dtype=np.float64)
        state = motion.at(times)
        inverse = np.linalg.inv(np.eye(2) + state.gradient)
        centre = self.scan.centre_px
        offset = centre + np.einsum("nij,nj->ni", inverse, -centre - state.shift_px - self.drift.at(times))
        maps = np.empty((times.size, 2, 3))
        maps[:, :, :2], maps[:, :, 2] = inverse, offset
        return maps


def build_column(scan: Scan, detector: Detector, speckle: Speckle, drift: Drift, distortion: Distortion) -> Column:
    """A column with its distortion worked out for every scan address."""
    x_px, y_px = np.meshgrid(np.arange(scan.width_px), np.arange(scan.height_px))
    bend = distortion.at(x_px, y_px, scan.width_px, scan.height_px)
    return Column(scan, detector, speckle, drift, (np.ascontiguousarray(bend[..., 0]), np.ascontiguousarray(bend[..., 1])))
