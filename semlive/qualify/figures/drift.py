"""Drift rate of each pair, its decay, and the best waiting time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from semlive.data.disparity import DisparityMap
from semlive.data.frame import FrameInfo
from semlive.qualify.figures.intervals import Interval, length_quantiles, magnitude_interval, quantiles, raised, scaled, stretched
from semlive.qualify.figures.noise import independent_points
from semlive.qualify.values import Figure, Result, Trend, Undetermined

Array = NDArray[np.float64]
MIN_PAIRS_DECAY = 4
SIGNIFICANCE_LEVEL = 0.01
DECAYED_PX = 0.1
"""Drift by the decaying part during one frame at the end of the waiting time, px: a tenth of what one frame of a usable run drifts."""
DECAY_TIMES = 60
MAX_DECAY_SPANS = 10.0
"""Longest decay time, in durations of the frames: a longer one cannot be distinguished from a constant change of the rate."""
DRAWS = 4000
NEGLIGIBLE = 1e-6
"""Posterior weight, relative to the largest, below which a decay time is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class DriftRates:
    """Mean drift rate between the two frames of each pair.

    Attributes:
        time_s: (k,) middle between the starts of both frames, s after the start of the first pair.
        rate_px_s: (k, 2) rate along x and y.
        sigma_px_s: (k, 2) standard uncertainty from correlation noise and start times.
        frame_s: duration of a frame.
        interval_s: interval of the frames of the last pair.
    """

    time_s: Array
    rate_px_s: Array
    sigma_px_s: Array
    frame_s: float
    interval_s: float

    @property
    def spacing(self) -> float:
        """Median time from pair to pair, in intervals of the frames; 0 for one pair."""
        return float(np.median(np.diff(self.time_s))) / self.interval_s if len(self.time_s) > 1 and self.interval_s > 0.0 else 0.0


def drift_rates(pairs: Sequence[tuple[FrameInfo, FrameInfo]], maps: Sequence[DisparityMap], further_sigma_px: float = 0.0) -> DriftRates:
    """Drift rates from the mean disparity of the maps within pairs.

    Args:
        pairs: metadata of both frames of each pair.
        maps: map within each pair, in the same order.
        further_sigma_px: standard uncertainty of a mean motion beyond correlation noise, px.
    """
    zero_ns = pairs[0][0].start_time_ns.value
    times, rates, sigmas, interval_s = [], [], [], 0.0
    for (first, second), disparity in zip(pairs, maps, strict=True):
        begin_s, end_s = ((info.start_time_ns.value - zero_ns) * 1e-9 for info in (first, second))
        interval_s = end_s - begin_s
        rate, sigma = pair_rate(
            disparity, interval_s, float(np.hypot(first.start_sigma_s, second.start_sigma_s)), first.timing.row_time_s.value
        )
        times.append(0.5 * (begin_s + end_s))
        rates.append(rate)
        sigmas.append(np.hypot(sigma, further_sigma_px / interval_s))
    return DriftRates(np.array(times), np.array(rates), np.array(sigmas), pairs[-1][1].timing.duration_s, interval_s)


def pair_rate(disparity: DisparityMap, interval_s: float, interval_sigma_s: float, row_s: float) -> tuple[Array, Array]:
    """(2,) mean rate of a map within a pair, px/s, and its standard uncertainty.

    Args:
        disparity: map within the pair.
        interval_s: from the start of the first frame to that of the second.
        interval_sigma_s: its standard uncertainty.
        row_s: row time. A point that moves down by a row is scanned a row later, which changes the rate of a warm microscope by 0.3 %.
    """
    valid = disparity.valid
    independent = independent_points(disparity, 1)
    interval_s += row_s * float(disparity.v_px[valid].mean())
    rate = np.array([disparity.u_px[valid].mean(), disparity.v_px[valid].mean()]) / interval_s
    noise_px = np.array([np.sqrt(np.mean(sigma[valid] ** 2)) for sigma in (disparity.sigma_u_px, disparity.sigma_v_px)])
    return rate, np.hypot(noise_px / np.sqrt(independent), rate * interval_sigma_s) / interval_s


def rate_results(
    rates: DriftRates, row_s: float, pixel_nm: float, *, timed: bool, stretch: tuple[float, float] = (1.0, 0.0), slowest: float = 1.0
) -> list[Result]:
    """First and last drift rate, drift during one frame, and its false strain, at the time of the last pair.

    Args:
        rates: of all pairs.
        row_s: row time.
        pixel_nm: pixel size; 0 if unknown.
        timed: whether the times of the scans are given; otherwise only the shift from frame to frame is a figure.
        stretch: true over stated row time, with its standard uncertainty.
        slowest: largest true over stated row time that the frames permit, if nothing else determines it.
    """
    last = magnitude_interval(rates.rate_px_s[-1], rates.sigma_px_s[-1], 1)
    moved = scaled(last, rates.interval_s)
    if not timed:
        reason = "the files do not contain the times of the scans"
        remedy = "export files with dwell, row and frame time and the time of the scan, or give them in frames.csv"
        title = "shift between the frames of the last pair"
        return [Figure("drift_in_frame", title, *moved, "px"), Undetermined("drift_rate", reason, remedy)]
    figures = [Figure("drift_rate", "drift rate at the last pair", *last, "px/s")]
    if pixel_nm > 0.0:
        figures.append(Figure("drift_rate_nm", "drift rate at the last pair", *scaled(last, pixel_nm), "nm/s"))
    if len(rates.time_s) > 1:
        first = magnitude_interval(rates.rate_px_s[0], rates.sigma_px_s[0], 2)
        figures.insert(0, Figure("drift_rate_first", "drift rate at the first pair", *first, "px/s"))
    in_frame = raised(stretched(scaled(last, rates.frame_s), *stretch), slowest)
    figures.append(Figure("drift_in_frame", "drift during one frame, last pair", *in_frame, "px"))
    strain = raised(stretched(scaled(last, row_s), *stretch), slowest)
    figures.append(Figure("drift_strain", "false strain by drift within a frame, not corrected", *strain, ""))
    return list[Result](figures)


@dataclass(frozen=True, slots=True, eq=False)
class Decay:
    """Draws from the posterior of an exponential decay of the drift rate.

    Attributes:
        time_s: (d,) decay time.
        final_px_s: (d, 2) final rate.
        start_px_s: (d, 2) decaying part at the first pair.
    """

    time_s: Array
    final_px_s: Array
    start_px_s: Array

    def wait_s(self, frame_s: Array) -> Array:
        """(d,) waiting time after the first pair until the decaying part moves the image by less than 0.1 px during frames of (d,) s."""
        moved = np.linalg.norm(self.start_px_s, axis=1) * frame_s
        return self.time_s * np.log(np.maximum(moved / DECAYED_PX, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """Fits at given decay times.

    Attributes:
        decay_s: (n,) decay times.
        fits: results of `_fit`.
        misfit: (n,) sums of squared residuals.
        scale2: (n,) variance of a rate.
        weight: (n,) posterior weight, largest 1.
    """

    decay_s: Array
    fits: list[tuple[Array, float, float, Array]]
    misfit: Array
    scale2: Array
    weight: Array


def _scan(rates: DriftRates, decay_s: Array, floor: float) -> _Scan:
    since, freedom = rates.time_s - rates.time_s[0], 2 * len(rates.time_s) - 5
    fits = [_fit(np.column_stack((np.ones(len(since)), np.exp(-since / tau))), rates.rate_px_s) for tau in decay_s]
    misfit = np.array([fit[1] for fit in fits])
    scale2 = np.maximum(misfit / freedom, floor**2)
    # Flat in the rates at the first and the last pair, once for each axis. Flat in the amplitudes, the posterior preferred the longest
    # times, whose amplitudes are arbitrary: 34 of 351 simulated decays were shorter than their interval, and none longer.
    flat = 2.0 * np.log(-np.expm1(-since[-1] / decay_s))
    log_weight = -0.5 * freedom * np.log(scale2) - 0.5 * misfit / scale2 + np.array([fit[2] for fit in fits]) + flat
    return _Scan(decay_s, fits, misfit, scale2, np.exp(log_weight - log_weight.max()))


def fit_decay(rates: DriftRates) -> Decay | None:
    """Decay of the drift rate; None if a constant rate describes the pairs.

    Both axes have one decay time. Amplitudes and final rates are linear and integrated over; the decay time has a uniform prior in its
    logarithm. The scatter about the law is that of the data, and at least their uncertainty.
    """
    count = len(rates.time_s)
    if count < MIN_PAIRS_DECAY:
        return None
    span = float(np.ptp(rates.time_s))
    floor = float(np.sqrt(np.mean(rates.sigma_px_s**2)))
    coarse = _scan(rates, np.geomspace(0.5 * span / (count - 1), MAX_DECAY_SPANS * span, DECAY_TIMES), floor)
    constant = _fit(np.ones((count, 1)), rates.rate_px_s)[1]
    freedom = 2 * count - 5
    least = float(coarse.misfit.min())
    ratio = max(constant - least, 0.0) / 3.0 / max(least / freedom, floor**2)
    if fdtrc(3, freedom, ratio) > SIGNIFICANCE_LEVEL:
        return None
    # The posterior of precise rates is narrower than a step of the first grid.
    likely = np.flatnonzero(coarse.weight > NEGLIGIBLE * coarse.weight.max())
    begin, end = max(likely[0] - 1, 0), min(likely[-1] + 1, DECAY_TIMES - 1)
    fine = _scan(rates, np.geomspace(coarse.decay_s[begin], coarse.decay_s[end], DECAY_TIMES), floor)
    fits, decay_s, weight, scale2 = fine.fits, fine.decay_s, fine.weight, fine.scale2
    rng = np.random.default_rng(3)
    chosen = rng.choice(DECAY_TIMES, DRAWS, p=weight / weight.sum())
    step = np.log(decay_s[1] / decay_s[0])
    final, start = np.empty((DRAWS, 2)), np.empty((DRAWS, 2))
    spread = rng.standard_t(freedom, (DRAWS, 2, 2))
    for at in np.unique(chosen):
        mine = chosen == at
        draws = fits[at][0][:, None, :] + np.sqrt(scale2[at]) * np.einsum("ij,njc->inc", fits[at][3], spread[mine])
        final[mine], start[mine] = draws[0], draws[1]
    return Decay(decay_s[chosen] * np.exp(step * rng.uniform(-0.5, 0.5, DRAWS)), final, start)


def _fit(columns: Array, values: Array) -> tuple[Array, float, float, Array]:
    """Coefficients (k, 2), sum of squared residuals, log weight of the integral over them, and a square root of their covariance."""
    normal = columns.T @ columns
    coefficients = np.asarray(np.linalg.lstsq(columns, values, rcond=None)[0], dtype=np.float64)
    values_, vectors = np.linalg.eigh(normal)
    values_ = np.maximum(values_, 1e-12 * values_[-1])
    # Two axes: the determinant counts once for each.
    return coefficients, float(np.sum((values - columns @ coefficients) ** 2)), -float(np.sum(np.log(values_))), vectors / np.sqrt(values_)


def decay_results(rates: DriftRates, slowest: float = 1.0, frame_sigma: float = 0.0) -> list[Result]:
    """Decay time, final rate and waiting time, or why they are not determined.

    Args:
        rates: drift rates of the pairs.
        slowest: largest true row time relative to the stated one that nothing excludes; the drift during a frame, and with it the upper end
            of the waiting time, increases with it.
        frame_sigma: relative standard uncertainty of the duration of a frame.
    """
    count = len(rates.time_s)
    if count < MIN_PAIRS_DECAY:
        return [
            Undetermined(
                "drift_decay",
                f"{count} pairs do not determine a decay",
                f"take at least {MIN_PAIRS_DECAY} pairs one after the other, the first soon after the specimen was inserted",
            )
        ]
    decay = fit_decay(rates)
    if decay is None:
        change = rates.rate_px_s[-1] - rates.rate_px_s[0]
        reason = f"the rate does not decay significantly within the frames (change {float(np.hypot(*change)):.2g} px/s)"
        remedy = "none is needed if the microscope was warm; else begin soon after the specimen was inserted"
        return [Undetermined("drift_decay", reason, remedy, by_pairs=False)]
    note = (
        f"after the first pair, until the decaying part moves the image by less than {DECAYED_PX:g} px during a frame; "
        "with the correction of drift the recommended protocol may wait less"
    )
    return [
        Figure("drift_decay", "decay time of the drift rate", *quantiles(decay.time_s), "s", Trend.LARGER),
        Figure("drift_rate_final", "drift rate after the decay", *length_quantiles(decay.final_px_s), "px/s"),
        Figure("waiting_time", "best waiting time", *_waiting(decay, rates.frame_s, slowest, frame_sigma), "s", note=note),
    ]


def _waiting(decay: Decay, frame_s: float, slowest: float, frame_sigma: float) -> Interval:
    """Waiting time with its 95 % interval, s."""
    drawn_s = frame_s * np.maximum(1.0 + frame_sigma * np.random.default_rng(4).standard_normal(DRAWS), 0.0)
    value, low, _ = quantiles(decay.wait_s(drawn_s))
    return value, low, quantiles(decay.wait_s(slowest * drawn_s))[2]
