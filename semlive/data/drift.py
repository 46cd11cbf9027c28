"""What the estimator says: drift in time, distortion in space, motion of the specimen per pair."""

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
        start_sigma_s: standard uncertainty of the start; 0 where it is taken for exact.
    """

    frame: int
    start_s: float
    timing: ScanTiming
    start_sigma_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DriftForecast:
    """Drift of scans to come, as long as the newest frame's.

    Attributes:
        time_s: (n,) begin of the scans, seconds after the start of frame 0, the first where the newest frame ends.
        duration_s: how long each lasts.
        rate_px_s: (n, 2) mean drift rate over each.
        sigma_px_s: (n, 2) its standard uncertainty.
    """

    time_s: NDArray[np.float64]
    duration_s: float
    rate_px_s: NDArray[np.float64]
    sigma_px_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HoldDrift:
    """Drift seen directly between two frames while nothing was moved, whether or not they came to be of a pair.

    Attributes:
        before: number of export of the first.
        after: of the second.
        begin_time_ns: start of the first's scan.
        end_time_ns: end of the second's.
        rate_px_s: mean drift rate (x, y) between them, the field's median.
        sigma_px_s: its standard uncertainty, from the correlation's noise and the starts'.
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
        time_s: (n,) seconds after the start of frame 0, ascending: `rows` samples in every accepted frame, or in those of the newest
            pairs alone, where earlier ones stand as an earlier revision said.
        frame: (n,) number of the frame that each sample lies in.
        drift_px: (n, 2) drift along x and y.
        sigma_px: (n, 2) standard uncertainty of the drift's change since the middle of its own frame.
        rate_px_s: (n, 2) drift rate.
        revision: counts estimates; past drift that is re-estimated is a new value with a higher revision.
        forecast: how it will go on, or None from a method that does not say.
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
    """Spatial distortion E at the scan address: an ideal raster would have written pixel R at R - E(R).

    The best affine map over the grid is removed: calibration by unknown translations cannot know it (gauges F1, F2).

    Attributes:
        grid: where it is sampled (scan addresses).
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
    """How the specimen lay in one pair, relative to pair 0: ``p = p0 + shift + gradient (p0 - centre)``.

    Attributes:
        pair: number of the pair.
        shift_px: (2,) translation of the point whose p0 is the centre; under strain that of the specimen's own centre is another.
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
    """What must be subtracted from one disparity map to get displacement.

    Attributes:
        frame: number of the current frame; the reference is frame 0.
        u_px: (ny, nx) ``[E(R_n) + d(t_n)] - [E(R_0) + d(t_0)]``, x component.
        v_px: (ny, nx) likewise, y.
        valid: (ny, nx) False where the frame shows a point beyond what the calibration covered; None where nothing is known against it.
    """

    frame: int
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    valid: NDArray[np.bool_] | None = None


@dataclass(frozen=True, slots=True)
class TermTest:
    """Whether the data asked for an optional term of the model.

    Attributes:
        name: ``magnification``, ``raster_rotation``, or ``coupling`` (whether the drift carries the distortion along).
        included: whether the estimate has it.
        f_ratio: mean square per degree of freedom that the term explains, in units of the noise.
        evidence: natural logarithm of how much likelier the data are with it.
        value: gamma of the coupling, 0 for the others.
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
    """Change of the raster since the start of frame 0, at the middle of every frame; zero where its term is not used.

    Attributes:
        frame: (n,) numbers of the frames.
        magnification: (n,) relative change; positive makes everything larger.
        magnification_sigma: (n,) standard uncertainty.
        rotation_rad: (n,) rotation of what is seen, positive from x towards y.
        rotation_sigma_rad: (n,) standard uncertainty.
    """

    frame: NDArray[np.int64]
    magnification: NDArray[np.float64]
    magnification_sigma: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]
    rotation_sigma_rad: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CalibrationQuality:
    """How well the pairs so far fix the distortion.

    Attributes:
        covered: part of the grid, 0 to 1, where the data and not the belief determine the distortion.
        lever_px: extent along x and y of how the picture lay in calibration and translation pairs.
        wave_sigma_px: standard uncertainty of a wave of one period over the grid, along x and along y; None from a method that
            does not say.
        refused: why nothing under load is to be corrected with it, one sentence with the figures; empty where it is good enough.
    """

    covered: float
    lever_px: tuple[float, float]
    wave_sigma_px: tuple[float, float] | None = None
    refused: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class EstimateRevision:
    """One revision of everything the estimator knows.

    Attributes:
        drift: drift in time.
        distortion: distortion in space.
        motions: one for each pair.
        noise_floor_px: robust standard deviation of what the model leaves unexplained, per component.
        notes: notes for the operator: which parameters are not determined, and why.
        terms: optional terms of the model, and whether the data asked for them.
        raster: change of magnification and rotation of the raster.
        calibration: how well the pairs fix the distortion.
    """

    drift: DriftEstimate
    distortion: DistortionField
    motions: tuple[PairMotion, ...]
    noise_floor_px: float
    notes: tuple[Note, ...]
    terms: tuple[TermTest, ...] = ()
    raster: RasterDrift | None = None
    calibration: CalibrationQuality | None = None
