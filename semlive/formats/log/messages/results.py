"""Messages with results of the analysis."""

from __future__ import annotations

from pydantic import ConfigDict, JsonValue, RootModel

from semlive.data.drift import CalibrationQuality
from semlive.data.grid import Grid
from semlive.data.strain import MeasuredValue, StrainGageComparison, Tensor2
from semlive.formats.log.messages.base import Message, Point

Values = tuple[float, ...]
Rows = tuple[tuple[float, ...], ...]


class DicMessage(Message):
    """`/dic/summary`: summary of one disparity map; means are None if no point converged."""

    reference: int
    current: int
    points: int
    converged: int
    mean_u_px: float | None = None
    mean_v_px: float | None = None
    noise_px: float | None = None
    wall_s: float


class DriftForecastMessage(Message):
    """Forecast of the drift of the next scans (see `semlive.data.drift.DriftForecast`)."""

    time_s: Values
    duration_s: float
    rate_px_s: tuple[Point, ...]
    sigma_px_s: tuple[Point, ...]


class DriftMessage(Message):
    """`/drift/estimate`: one revision of drift in time, and the quality of the calibration (see `semlive.data.drift`).

    The numbers from `x_px` on repeat the newest row of the arrays, because plots show scalars, not the ends of arrays.
    `pairs` is the number of pairs of the estimate; older logs without this key have one revision for each pair. `newest_pair` is the
    number of the newest of these pairs; older logs do not have it.
    """

    revision: int
    pairs: int | None = None
    newest_pair: int | None = None
    time_s: Values
    frame: tuple[int, ...]
    drift_px: tuple[Point, ...]
    sigma_px: tuple[Point, ...]
    rate_px_s: tuple[Point, ...]
    forecast: DriftForecastMessage | None = None
    x_px: float | None = None
    y_px: float | None = None
    sigma_x_px: float | None = None
    sigma_y_px: float | None = None
    rate_x_px_s: float | None = None
    rate_y_px_s: float | None = None
    calibration: CalibrationQuality | None = None


class HoldDriftMessage(Message):
    """`/drift/hold`: drift measured directly between two frames of one hold (see `semlive.data.drift.HoldDrift`)."""

    before: int
    after: int
    begin_time_ns: int
    end_time_ns: int
    rate_px_s: Point
    sigma_px_s: Point


class DistortionMessage(Message):
    """`/distortion/estimate`: one revision of distortion in space (see `semlive.data.drift.DistortionField`)."""

    revision: int
    grid: Grid
    ex_px: Rows
    ey_px: Rows
    sigma_px: Rows
    valid: tuple[tuple[bool, ...], ...]


class MotionMessage(Message):
    """`/motion`: one revision of the shift and gradient of the specimen in a pair (see `semlive.data.drift.PairMotion`)."""

    revision: int
    pair: int
    shift_px: Point
    shift_sigma_px: Point
    gradient: tuple[Point, Point]
    gradient_sigma: tuple[Point, Point]


class StrainMessage(Message):
    """`/strain/summary`: strain of a frame relative to frame 0 (see `semlive.data.strain.StrainSummary`)."""

    revision: int
    frame: int
    mean: Tensor2
    mean_sigma: Tensor2
    sd: Tensor2
    vsg_px: float
    gauge_sigma: Tensor2 | None = None
    systematic_sigma: Tensor2 | None = None


class ElasticMessage(Message):
    """`/elastic`: elastic constants so far, None while the loads do not determine them, and their comparison with a strain gage.

    `pairs` is the number of pairs of the estimate; older logs without this key have one revision for each pair.
    """

    revision: int
    pairs: int | None = None
    youngs_modulus_gpa: MeasuredValue | None = None
    poissons_ratio: MeasuredValue | None = None
    gage: StrainGageComparison | None = None


class ResultMessage(RootModel[dict[str, JsonValue]]):
    """`/result`: the object that `semlive replay --json` prints."""

    model_config = ConfigDict(frozen=True)
