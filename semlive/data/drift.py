"""Results of the estimator: drift over time, spatial distortion, motion of the specimen per pair, and their quality."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
from semlive.data.notes import Note
from semlive.data.scan import ScanTiming


@dataclass(frozen=True, slots=True)
class FrameTime:
    """When a frame was scanned, on the estimator's time axis.

    Attributes:
        frame: number of the frame (2 * pair + 0 or 1).
        start_s: start of the scan, seconds after the start of frame 0.
        timing: scan timing.
        start_sigma_s: standard uncertainty of the start; 0 where it is assumed exact.
    """

    frame: int
    start_s: float
    timing: ScanTiming
    start_sigma_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DriftForecast:
    """Forecast of the drift during future scans with the duration of the newest frame.

    Attributes:
        time_s: (n,) start of each scan, seconds after the start of frame 0; the first starts at the end of the newest frame.
        duration_s: duration of each scan.
        rate_px_s: (n, 2) mean drift rate over each.
        sigma_px_s: (n, 2) its standard uncertainty.
    """

    time_s: NDArray[np.float64]
    duration_s: float
    rate_px_s: NDArray[np.float64]
    sigma_px_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HoldDrift:
    """Drift measured directly between two frames of a hold, whether or not they became a pair.

    Attributes:
        before: export number of the first frame.
        after: export number of the second frame.
        begin_time_ns: start of the first scan, UTC ns.
        end_time_ns: end of the second scan, UTC ns.
        rate_px_s: mean drift rate (x, y) between the frames, from the median of the disparity.
        sigma_px_s: its standard uncertainty, from correlation noise and start times.
    """

    before: int
    after: int
    begin_time_ns: int
    end_time_ns: int
    rate_px_s: tuple[float, float]
    sigma_px_s: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class DriftEstimate:
    """Drift as a function of scan time, relative to the start of frame 0 (gauge F3: d = 0 there).

    Attributes:
        time_s: (n,) seconds after the start of frame 0, ascending: `rows` samples in every accepted frame. Some revisions hold only the
            frames of the newest pairs; earlier frames then keep the values of an earlier revision.
        frame: (n,) number of the frame of each sample.
        drift_px: (n, 2) drift along x and y.
        sigma_px: (n, 2) standard uncertainty of the drift's change since the middle of its own frame.
        rate_px_s: (n, 2) drift rate.
        revision: number of the estimate; re-estimated drift has a higher revision.
        forecast: expected drift of the next scans; None from a method without a forecast.
    """

    time_s: NDArray[np.float64]
    frame: NDArray[np.int64]
    drift_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    rate_px_s: NDArray[np.float64]
    revision: int
    forecast: DriftForecast | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DistortionField:
    """Spatial distortion E at the scan address: an ideal raster places pixel R at R - E(R).

    The best affine map over the grid is removed: calibration by unknown translations cannot determine it (gauges F1, F2).

    Attributes:
        grid: scan addresses of the samples.
        ex_px: (ny, nx) along x.
        ey_px: (ny, nx) along y.
        sigma_px: (ny, nx) standard uncertainty, per component.
        valid: (ny, nx) True where the calibration's translations covered the address.
    """

    grid: Grid
    ex_px: NDArray[np.float64]
    ey_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class PairMotion:
    """Motion of the specimen in one pair, relative to pair 0: ``p = p0 + shift + gradient (p0 - centre)``.

    Attributes:
        pair: number of the pair.
        shift_px: (2,) translation of the point with p0 at the centre; under strain the centre of the specimen moves differently.
        shift_sigma_px: (2,) standard uncertainty (drift across the motion included).
        gradient: (2, 2) [[du/dx, du/dy], [dv/dx, dv/dy]]; antisymmetric (or zero) in calibration.
        gradient_sigma: (2, 2) standard uncertainty.
    """

    pair: int
    shift_px: NDArray[np.float64]
    shift_sigma_px: NDArray[np.float64]
    gradient: NDArray[np.float64]
    gradient_sigma: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Disparity by drift and distortion; disparity minus this correction is displacement.

    Attributes:
        frame: number of the current frame; the reference is frame 0.
        u_px: (ny, nx) ``[E(R_n) + d(t_n)] - [E(R_0) + d(t_0)]``, x component.
        v_px: (ny, nx) likewise, y.
        valid: (ny, nx) False where a point of the frame lies outside the calibrated area; None: all points are valid.
    """

    frame: int
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    valid: NDArray[np.bool_] | None = None


@dataclass(frozen=True, slots=True)
class TermTest:
    """Test of an optional term of the model.

    Attributes:
        name: ``magnification``, ``raster_rotation``, or ``coupling`` (advection of the distortion with the drift).
        included: whether the estimate includes the term.
        f_ratio: mean square per degree of freedom explained by the term, over that of the noise.
        evidence: natural logarithm of the Bayes factor for the term.
        value: advection coefficient of ``coupling``, 0 for other terms.
        sigma: standard uncertainty of the value.
    """

    name: str
    included: bool
    f_ratio: float
    evidence: float
    value: float = 0.0
    sigma: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RasterDrift:
    """Change of the raster since the start of frame 0, at the middle of every frame; zero without the term.

    Attributes:
        frame: (n,) numbers of the frames.
        magnification: (n,) relative change; positive enlarges the image.
        magnification_sigma: (n,) standard uncertainty.
        rotation_rad: (n,) rotation of the image, positive from x towards y.
        rotation_sigma_rad: (n,) standard uncertainty.
    """

    frame: NDArray[np.int64]
    magnification: NDArray[np.float64]
    magnification_sigma: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]
    rotation_sigma_rad: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CalibrationQuality:
    """How well the pairs so far determine the distortion.

    Attributes:
        covered: fraction of the grid, 0 to 1, where the data and not the prior determine the distortion.
        lever_px: extent of the translations along x and y in calibration and translation pairs.
        wave_sigma_px: standard uncertainty of a distortion wave of one period over the grid, along x and along y; None from a method
            without this estimate.
        refused: why the calibration must not correct loaded frames, with the figures; empty where the calibration is sufficient.
    """

    covered: float
    lever_px: tuple[float, float]
    wave_sigma_px: tuple[float, float] | None = None
    refused: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class EstimateRevision:
    """One revision of all results of the estimator.

    Attributes:
        drift: drift in time.
        distortion: distortion in space.
        motions: motion of the specimen in each pair.
        noise_floor_px: robust standard deviation of the residual, per component.
        notes: messages for the operator (which quantity is not determined, and why).
        terms: tests of the optional terms of the model.
        raster: change of magnification and rotation of the raster.
        calibration: how well the pairs determine the distortion.
    """

    drift: DriftEstimate
    distortion: DistortionField
    motions: tuple[PairMotion, ...]
    noise_floor_px: float
    notes: tuple[Note, ...]
    terms: tuple[TermTest, ...] = ()
    raster: RasterDrift | None = None
    calibration: CalibrationQuality | None = None
