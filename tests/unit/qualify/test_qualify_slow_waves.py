"""A vibration or hum near a multiple of the row rate is named from the maps within pairs; other changes within pairs are no wave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.diagnose.rows.series import RowSeries
from semlive.qualify.figures.scan import row_results
from semlive.qualify.figures.slow_waves import SlowWave, slow_wave
from semlive.qualify.figures.waves import RowPairs
from semlive.qualify.limits import Sources, limits_of
from semlive.qualify.values import Figure

GRID = Grid(13, 13, 5, 97, 83, 25)
HEIGHT_PX, WIDTH_PX, PAIRS, NOISE_PX = 442, 512, 9, 0.02
MAINS_HZ, SLOW = 50.0, 6.0 / HEIGHT_PX
ROW_S = (1.0 + SLOW) / MAINS_HZ
"""Rows sample the hum as 6 cycles per frame."""
DWELL_S, INTERVAL_S = ROW_S / WIDTH_PX / 1.1, 9.907
FILE = Provenance.FILE
TIMING = ScanTiming(Sourced(DWELL_S, FILE), Sourced(ROW_S, FILE), Sourced(ROW_S * HEIGHT_PX, FILE), Sourced(1, FILE))
Y_PX, X_PX = np.meshgrid(GRID.y_px, GRID.x_px, indexing="ij")
Fields = np.ndarray
"""(2, ny, nx) displacement along x and y."""
Change = Callable[[np.random.Generator], Fields]


def _noise(rng: np.random.Generator) -> Fields:
    """Noise of subsets that overlap."""
    white = rng.standard_normal((2, *GRID.shape))
    return NOISE_PX * 5.0 * np.stack([uniform_filter(one, 5) for one in white])


def _map(change_px: Fields) -> DisparityMap:
    sigma, status = np.full(GRID.shape, NOISE_PX), np.zeros(GRID.shape, np.uint8)
    return DisparityMap(0, 1, GRID, change_px[0], change_px[1], sigma, sigma, np.ones(GRID.shape), status)


def _wave(frequency_hz: float, turn: float, sizes_px: Sequence[float]) -> Fields:
    """A wave of one frame in the means over the subsets; rows sample it at their begin."""
    slow = frequency_hz * ROW_S - round(frequency_hz * ROW_S)
    remaining = np.sinc(slow * GRID.subset_px) * np.sinc(frequency_hz * DWELL_S * GRID.subset_px)
    one = remaining * np.sin(2.0 * np.pi * (slow * Y_PX + frequency_hz * DWELL_S * X_PX + turn))
    return np.stack([size * one for size in sizes_px])


def _vibration(frequency_hz: float, sizes_px: Sequence[float]) -> Change:
    """A phase of its own in every frame."""
    return lambda rng: _wave(frequency_hz, rng.uniform(), sizes_px) - _wave(frequency_hz, rng.uniform(), sizes_px)


def _hum(rng: np.random.Generator) -> Fields:
    """A hum that continues from frame to frame."""
    turn = rng.uniform()
    return _wave(MAINS_HZ, turn + MAINS_HZ * INTERVAL_S, SIZES_PX) - _wave(MAINS_HZ, turn, SIZES_PX)


SIZES_PX = (0.05, 0.1)


def _found(change: Change, seed: int = 3) -> SlowWave | None:
    rng = np.random.default_rng((seed, 39))
    return slow_wave([_map(_noise(rng) + change(rng)) for _ in range(PAIRS)], TIMING, NOISE_PX)


def _pairs() -> RowPairs:
    rows, middle_px = np.arange(float(HEIGHT_PX)), np.arange(21.0, 504.0, 42.0)
    plain = np.zeros((2, HEIGHT_PX, len(middle_px)))
    series = RowSeries(plain, plain + 1.0, rows, middle_px, 42.0, ROW_S, DWELL_S, 1.0)
    return RowPairs([series] * PAIRS, np.full(PAIRS, INTERVAL_S), np.zeros((PAIRS, 2)))


NO_ROWS = RowDiagnosis(Outcome.NONE, (), (), None, (), (), PAIRS, HEIGHT_PX, 0.02, (), (), 0.0)


def _at(multiple: int, cycles: float) -> float:
    """Frequency near a multiple of the row rate, Hz."""
    return (multiple + cycles / HEIGHT_PX) / ROW_S


@pytest.mark.parametrize(
    ("change", "name", "frequency_hz"),
    [
        (_vibration(_at(0, 7.0), SIZES_PX), "vibration", _at(0, 7.0)),
        (_vibration(_at(1, -6.0), SIZES_PX), "vibration", _at(1, -6.0)),
        (_vibration(_at(3, 2.5), SIZES_PX), "vibration", _at(3, 2.5)),
        (_hum, "mains_hum", MAINS_HZ),
    ],
)
def test_a_wave_near_a_multiple_of_the_row_rate_is_named_with_frequency_and_amplitude(
    change: Change, name: str, frequency_hz: float
) -> None:
    slow = _found(change)
    assert slow is not None
    assert slow.effect.name == name
    figures = {figure.name: figure for figure in row_results(NO_ROWS, "", _pairs(), slow) if isinstance(figure, Figure)}
    true = {"frequency_hz": frequency_hz, "amplitude_x_px": SIZES_PX[0], "amplitude_y_px": SIZES_PX[1]}
    assert set(figures) == {f"{name}_{key}" for key in true}
    for key, value in true.items():
        figure = figures[f"{name}_{key}"]
        assert figure.low <= value <= figure.high
        assert figure.high - figure.low < 0.5 * value


def _none(_rng: np.random.Generator) -> Fields:
    return np.zeros((2, *GRID.shape))


def _drift(rng: np.random.Generator) -> Fields:
    """A random walk of the drift over the rows."""
    walk = np.cumsum(rng.standard_normal((2, HEIGHT_PX)), axis=1)
    return 0.01 * np.broadcast_to(walk[:, GRID.y_px.astype(int), None], (2, *GRID.shape))


def _decay(rng: np.random.Generator) -> Fields:
    """A drift that decays within the frame, along both axes."""
    return rng.normal(0.0, 3.0, (2, 1, 1)) * np.exp(-Y_PX / rng.uniform(30.0, 600.0))


def _charging(rng: np.random.Generator) -> Fields:
    """A smooth field of another shape in each pair."""
    return np.stack([gaussian_filter(rng.standard_normal(GRID.shape), 10) for _ in range(2)]) * 2.0


def _jump(rng: np.random.Generator) -> Fields:
    return np.where(rng.uniform(50.0, 400.0) < Y_PX, rng.normal(0.0, 0.2, (2, 1, 1)), 0.0)


def _settling(rng: np.random.Generator) -> Fields:
    return np.stack([rng.normal(0.0, 1.0) * np.exp(-X_PX / 40.0), np.zeros(GRID.shape)])


def _jitter(rng: np.random.Generator) -> Fields:
    rows = uniform_filter(rng.normal(0.0, 0.5, HEIGHT_PX), GRID.subset_px)
    return np.stack([np.broadcast_to(rows[GRID.y_px.astype(int), None], GRID.shape), np.zeros(GRID.shape)])


def _two_waves(rng: np.random.Generator) -> Fields:
    """Two waves of equal size, neither of which explains most of the noise."""
    return _vibration(_at(1, -6.0), SIZES_PX)(rng) + _vibration(_at(3, 4.0), SIZES_PX)(rng)


def _one_pair(rng: np.random.Generator) -> Fields:
    """A wave in a pair of nine."""
    return _vibration(_at(1, -6.0), (0.3, 0.3))(rng) if rng.uniform() < 0.1 else _none(rng)


@pytest.mark.parametrize("change", [_none, _drift, _decay, _charging, _jump, _settling, _jitter, _two_waves, _one_pair])
@pytest.mark.parametrize("seed", range(3))
def test_other_changes_within_pairs_are_no_wave(change: Change, seed: int) -> None:
    assert _found(change, seed) is None


def test_without_a_wave_in_rows_and_maps_none_is_significant() -> None:
    (missing,) = row_results(NO_ROWS, "", _pairs())
    assert missing.name == "row_waves"


def test_the_slow_wave_is_the_limit_in_place_of_unexplained_noise() -> None:
    slow = _found(_hum)
    assert slow is not None
    sources = Sources(6e-4, 0.3, 1e-5, 1e-6, 1e-5, 1e-6, 0.0, 0.2, 221.0)
    assert limits_of(sources)[0].name == "unexplained_noise"
    assert limits_of(replace(sources, row_effects=(slow.effect,)))[0].name == "mains_hum"


def test_smaller_jitter_of_the_rows_is_a_consequence_of_the_slow_wave() -> None:
    slow = _found(_vibration(_at(1, -6.0), SIZES_PX))
    assert slow is not None
    sizes = tuple(ParameterEstimate(f"sd_{axis}_px", 0.01, 1e-3, "px") for axis in "xy")
    jitter = IdentifiedEffect("row_jitter", sizes, 0.04, 50.0, 1e-3, strain=False, model_effect=ModelEffect("row_jitter", (), 0.04))
    rows = replace(NO_ROWS, outcome=Outcome.IDENTIFIED, effects=(jitter,))
    assert not any(result.name.startswith("row_jitter") for result in row_results(rows, "", _pairs(), slow))
    assert any(result.name.startswith("row_jitter") for result in row_results(rows, "", _pairs()))
