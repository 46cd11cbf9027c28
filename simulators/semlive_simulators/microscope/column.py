"""The column: position of the beam at each time, and the signal there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict

from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.distortion import Distortion
from semlive_simulators.effects.drift import Drift
from semlive_simulators.effects.interfaces import Instants, PixelVisits, Plane
from semlive_simulators.kernels.exposure import add_coverage, beam_points, digitise
from semlive_simulators.kernels.raster import raster_rows
from semlive_simulators.microscope.patterns import Pattern, Speckle
from semlive_simulators.microscope.scan import Scan, Timing
from semlive_simulators.specimen.specimen import Motion

__all__ = ["Column", "Detector", "Scan", "build_column"]

_REFINEMENTS = 4
"""Iterations for the undeformed position: with gradients below 0.05, a deformation of 2 px is accurate to 1e-5 px."""

_BAND_ROWS = 32
"""Number of rows that are rendered together for all visits, so that their planes (0.25 MB each) fit into the processor cache."""


@dataclass(frozen=True, slots=True)
class Detector:
    """Conversion of signal to grey levels.

    Attributes:
        offset: grey level of the metal without gold.
        gain: grey levels from metal to gold.
        read_noise: standard deviation of the noise without signal, grey levels of the exported image.
        shot_noise: variance of the noise per grey level of signal.
        seed: seed of the noise.
        bits: 8 or 16; grey levels are those of 8 bit in both cases, 16 bit has 256 steps in each.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    offset: float
    gain: float
    read_noise: float
    shot_noise: float
    seed: int
    bits: int = 8

    def __post_init__(self) -> None:
        if self.bits not in (8, 16):
            raise ValueError(f"bits must be 8 or 16, not {self.bits}")

    @property
    def dtype(self) -> np.dtype[np.unsignedinteger]:
        """Type of the images."""
        return np.dtype(np.uint8 if self.bits == 8 else np.uint16)


def _inverted(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2) inverses by Cramer's rule, which takes 0.2 ms for 10,000 matrices, and `numpy.linalg.inv` 4 ms."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    return np.stack((d, -b, -c, a), axis=1).reshape(-1, 2, 2) / (a * d - b * c)[:, None, None]


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A microscope with a speckle pattern.

    Attributes:
        scan: the raster.
        detector: conversion of signal to grey levels.
        speckle: the speckle pattern.
        drift: drift of the beam.
        distortion_px: E at every scan address in x and in y, (height, width) each.
        effects: further effects.
        timing: true times at which pixels are visited.
        is_plain_raster: whether the fast kernel can render the rows, each visited one time from left to right.
    """

    scan: Scan
    detector: Detector
    speckle: Pattern
    drift: Drift
    distortion_px: tuple[NDArray[np.float64], NDArray[np.float64]]
    effects: EffectSet = field(default_factory=EffectSet)
    timing: Timing = field(init=False)
    is_plain_raster: bool = field(init=False)

    def __post_init__(self) -> None:
        timing, dots = self.effects.timing(self.scan), isinstance(self.speckle, Speckle)
        plain = dots and timing.plain and self.detector.bits == 8 and self.scan.spot_px == 0.0 and not self.effects.by_pixel
        object.__setattr__(self, "timing", timing)
        object.__setattr__(self, "is_plain_raster", plain)

    @property
    def duration_s(self) -> float:
        """True duration of a frame, s, but not less than the nominal duration of the scan."""
        return max(self.scan.duration_s, self.timing.end_s)

    @property
    def visits(self) -> int:
        """Number of visits of each pixel."""
        return self.timing.row_start_s.shape[0]

    def rows_span_s(self, first_row: int, end_row: int) -> tuple[float, float]:
        """First start and last end of rows `first_row` ... `end_row - 1`, seconds since the frame began."""
        start_s = self.timing.row_start_s[:, first_row:end_row]
        return float(start_s.min()), float(start_s.max()) + self.timing.row_time_s

    def render_rows(self, out: NDArray[np.unsignedinteger], first_row: int, start_time_s: float, motion: Motion, frame: int) -> None:
        """Write rows of a frame.

        Args:
            out: (rows, width) of the detector's dtype, written.
            first_row: number of the first row.
            start_time_s: start of the scan, seconds since the run began.
            motion: motion of the specimen in the time of these rows.
            frame: number of the scan, which determines its noise.
        """
        if not (self.is_plain_raster and isinstance(self.speckle, Speckle)):
            self._expose(out, first_row, start_time_s, motion, frame)
            return
        detector, speckle = self.detector, self.speckle
        rows = np.arange(first_row, first_row + out.shape[0] + 1)
        maps = self.row_maps(start_time_s + rows * self.timing.row_time_s, motion, start_time_s, frame)
        ex_px, ey_px = self.distortion_px
        raster_rows(
            out, first_row, ex_px, ey_px, maps, self.timing.dwell_time_s / self.timing.row_time_s,
            speckle.seed, speckle.pitch_px, speckle.radius_px, speckle.radius_spread, speckle.presence, speckle.edge_px,
            detector.offset, detector.gain, detector.read_noise, detector.shot_noise, detector.seed, frame,
        )  # fmt: skip

    def row_maps(self, time_s: ArrayLike, motion: Motion, start_time_s: float = 0.0, frame: int = 0) -> NDArray[np.float64]:
        """The affine maps [A | b] from undistorted scan address to material point at times (n,): (n, 2, 3).

        p = c + T (1 - g)(R - E(R) - c) - d(t) is the position of the beam (T scan rotation, g deflection). The point xi at this
        position fulfils p = xi + s + G (xi - c), so xi = A (p - c - s) + c with A = (1 + G)^-1.
        """
        at = Instants(np.asarray(time_s, dtype=np.float64), start_time_s, frame, self.scan, motion)
        state = self.effects.moved(at)
        inverse = _inverted(np.eye(2) + state.gradient)
        deflection = self.effects.deflection(at)
        raster = np.broadcast_to(self.scan.rotation, inverse.shape) if deflection is None else self.scan.rotation @ (np.eye(2) - deflection)
        effect_drift = self.effects.drift_px(at)
        drift = self.drift.at(at.time_s) if effect_drift is None else self.drift.at(at.time_s) + effect_drift
        centre = self.scan.centre_px
        maps = np.empty((at.time_s.size, 2, 3))
        for i, k in np.ndindex(2, 2):  # 0.13 ms for 10,000 matrices, and `@` 1.3 ms
            maps[:, i, k] = inverse[:, i, 0] * raster[:, 0, k] + inverse[:, i, 1] * raster[:, 1, k]
        maps[:, :, 2] = centre - np.einsum("nij,nj->ni", inverse, raster @ centre + state.shift_px + drift)
        return maps

    def specimen_points(
        self, rows: range, visit: int, start_time_s: float, motion: Motion, frame: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], PixelVisits]:
        """Material points (x, y) of a visit of rows, (rows, width) each, and the visit."""
        timing, width, band = self.timing, self.scan.width_px, slice(rows.start, rows.stop)
        begin_s = start_time_s + timing.row_start_s[visit, band]
        end_s = begin_s + width * timing.dwell_time_s
        backwards = timing.reversed_rows[band]
        at = self._visits(rows, visit, start_time_s, motion, frame)
        offset_x_px, offset_y_px = (part[band] for part in self.distortion_px)
        for x_px, y_px in self.effects.offset_px(at):
            offset_x_px, offset_y_px = offset_x_px + x_px, offset_y_px + y_px
        maps = self.row_maps(np.concatenate([begin_s, end_s]), motion, start_time_s, frame)
        points_x, points_y = np.empty((len(rows), width)), np.empty((len(rows), width))
        count = len(rows)
        beam_points(points_x, points_y, rows.start, offset_x_px, offset_y_px, maps[:count], maps[count:], backwards)
        if self.effects.deforming:
            middle = Instants(0.5 * (begin_s + end_s), start_time_s, frame, self.scan, motion)
            inverse = np.linalg.inv(np.eye(2) + self.effects.moved(middle).gradient)
            points_x, points_y = self._undeformed(points_x, points_y, inverse, at)
        return points_x, points_y, at

    def _visits(self, rows: range, visit: int, start_time_s: float, motion: Motion, frame: int) -> PixelVisits:
        timing, band = self.timing, slice(rows.start, rows.stop)
        columns = np.arange(self.scan.width_px, dtype=np.float64)[None, :]
        backwards = timing.reversed_rows[band, None]
        order = np.where(backwards, self.scan.width_px - 1 - columns, columns)
        time_s = (start_time_s + timing.row_start_s[visit, band])[:, None] + order * timing.dwell_time_s
        y_px = np.arange(rows.start, rows.stop, dtype=np.float64)[:, None]
        bend_px = (self.distortion_px[0][band], self.distortion_px[1][band])
        return PixelVisits(columns, y_px, time_s, start_time_s, frame, visit, backwards, self.scan, motion, bend_px)

    def _undeformed(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], inverse: NDArray[np.floating], at: PixelVisits) -> Plane:
        """Solve xi = xi0 - A w(xi) by iteration."""
        material_x, material_y = x_px, y_px
        xx, xy, yx, yy = (inverse[:, i, j, None] for i in range(2) for j in range(2))
        for _ in range(_REFINEMENTS):
            planes = self.effects.material_px(material_x, material_y, at)
            wx, wy = sum(plane[0] for plane in planes), sum(plane[1] for plane in planes)
            material_x, material_y = x_px - xx * wx - xy * wy, y_px - yx * wx - yy * wy
        return material_x, material_y

    def _expose(self, out: NDArray[np.unsignedinteger], first_row: int, start_time_s: float, motion: Motion, frame: int) -> None:
        """Render rows in the general case: every visit of every pixel at its own time."""
        for begin in range(0, out.shape[0], _BAND_ROWS):
            band = out[begin : begin + _BAND_ROWS]
            signal = np.zeros(band.shape)
            for visit in range(self.visits):
                self.expose(signal, first_row + begin, visit, start_time_s, motion, frame)
            self.digitise(band, first_row + begin, signal, frame)

    def expose(self, signal: NDArray[np.float64], first_row: int, visit: int, start_time_s: float, motion: Motion, frame: int) -> None:
        """Add the signal of one visit of rows; after all visits `digitise` converts the sum to grey levels.

        Rows can be exposed in any groups; the sum is equal to the last bit if the visits of each row are in order.

        Args:
            signal: (rows, width) added to, zeros before the first visit.
            first_row: number of the first row.
            visit: number of the visit.
            start_time_s: start of the frame, seconds since the run began.
            motion: motion of the specimen in the time of this visit.
            frame: number of the frame.
        """
        detector, speckle, optics = self.detector, self.speckle, self.effects.optics()
        x_px, y_px, at = self.specimen_points(range(first_row, first_row + signal.shape[0]), visit, start_time_s, motion, frame)
        probe_px = optics.probe_px(Instants(at.time_s[:, 0], start_time_s, frame, self.scan, motion))
        gold = np.zeros(signal.shape)
        add_coverage(gold, x_px, y_px, probe_px, 1.0, speckle.kind, speckle.seed, speckle.numbers)
        signal += optics.grey(detector.offset + detector.gain * gold, x_px, y_px, at)

    def digitise(self, out: NDArray[np.unsignedinteger], first_row: int, signal: NDArray[np.float64], frame: int) -> None:
        """Write rows of a frame from the sum of all visits."""
        detector = self.detector
        mean = signal / self.visits
        variance = self.effects.optics().variance(detector.read_noise**2 + detector.shot_noise * mean, mean)
        digitise(out, first_row, mean, np.maximum(variance, 0.0), 1.0 if detector.bits == 8 else 256.0, detector.seed, frame)


def build_column(
    scan: Scan, detector: Detector, speckle: Pattern, drift: Drift, distortion: Distortion, effects: EffectSet | None = None
) -> Column:
    """A column with its distortion computed for every scan address."""
    x_px, y_px = np.meshgrid(np.arange(scan.width_px), np.arange(scan.height_px), sparse=True)
    bend = distortion.at(x_px, y_px, scan.width_px, scan.height_px)
    bend_px = np.ascontiguousarray(bend[..., 0]), np.ascontiguousarray(bend[..., 1])
    effects = EffectSet() if effects is None else effects
    return Column(scan, detector, effects.optics().speckle(speckle), drift, bend_px, effects)
