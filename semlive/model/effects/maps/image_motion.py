"""Motion of the image between and during frames: jumps and oscillation."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

Array = NDArray[np.float64]


# A permanent jump of the image during a frame, for example by a slipping grip, a discharge or thermal stress.
PLACES = np.arange(0.05, 1.0, 0.1)  # as fractions of the time in which a frame scans the points


def _drift_jump(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = J H(T - T_s), T_s in a frame; a block scanned during the jump is displaced by the fraction of its rows after T_s.

    With a sharp edge, a jump of 0.12 px was identified together with two further effects that compensated the edge. Points are means
    over the rows of their subsets. With the rows of a block alone, the instant was wrong by 0.25 s rms in subsets of 4.6 s; with both,
    by 0.02 s.
    """
    share = _share_after(scene.time_s - values["at_s"], _block_s(scene), scene.subset_s)
    return BasisField(xy_columns(share), xy_parameters("px"))


def _share_after(elapsed_s: Array, block_s: float, subset_s: float) -> Array:
    """Fraction after an instant of a block whose points are means over subsets: the step, averaged over both durations."""
    if subset_s <= 0.0:
        return np.clip(elapsed_s / block_s + 0.5, 0.0, 1.0)
    half_sum_s, half_difference_s = 0.5 * (block_s + subset_s), 0.5 * (block_s - subset_s)
    corners = ((half_sum_s, 1.0), (half_difference_s, -1.0), (-half_difference_s, -1.0), (-half_sum_s, 1.0))
    squares = sum(sign * np.maximum(elapsed_s + offset_s, 0.0) ** 2 for offset_s, sign in corners)
    return np.clip(squares / (2.0 * block_s * subset_s), 0.0, 1.0)


def _block_s(scene: RunGeometry) -> float:
    """Scan time of the rows of one block, s."""
    spacing_s = np.asarray(np.diff(np.sort(scene.time_in_frame_s[0])), dtype=np.float64)
    return float(np.quantile(spacing_s[spacing_s > 0.1 * spacing_s.max()], 0.5)) or 1.0


def _drift_jump_grid(scene: RunGeometry) -> Iterable[Values]:
    """Ten instants in every frame within the rows with points; a jump in other rows equals one between two frames."""
    first_s, last_s = float(scene.time_in_frame_s.min()), float(scene.time_in_frame_s.max())
    return ({"at_s": float(start_s + first_s + place * (last_s - first_s))} for start_s in scene.start_s for place in PLACES)


DRIFT_JUMP = EffectClass(
    "drift_jump",
    "the image jumps permanently during a frame",
    _drift_jump,
    _drift_jump_grid,
    nonlinear_parameters=(NonlinearParameter("at_s", "s", 9.5),),
    discriminating_experiment="load and grey level at that instant: the load drops with a slip, a discharge causes a flash",
    sizes_px=(0.003, 10.0),
    recurrence=Recurrence.ONE_TIME,
)


# A permanent jump of the image between the two frames of a pair.


def _jump_within_pair(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = J from the second frame of a pair on."""
    later = np.broadcast_to((scene.frame >= values["first_frame"])[:, None], scene.time_s.shape)
    return BasisField(xy_columns(later.astype(np.float64)), xy_parameters("px"))


def _jump_within_pair_grid(scene: RunGeometry) -> Iterable[Values]:
    """Every pair."""
    return ({"first_frame": float(frame)} for frame in scene.frame[scene.frame % 2 == 1])


JUMP_WITHIN_PAIR = EffectClass(
    "jump_within_pair",
    "the image jumps permanently between the two frames of a pair",
    _jump_within_pair,
    _jump_within_pair_grid,
    group="G8",
    discriminating_experiment="a third frame in the pair",
    sizes_px=(0.003, 10.0),
    recurrence=Recurrence.ONE_TIME,
    discrete_parameters=("first_frame",),
)


# Periodic motion of the image by air conditioning or a chiller.
LONGEST_S, SHORTEST_S = 900.0, 60.0


def _thermal_oscillation(scene: RunGeometry, values: Values) -> BasisField:
    """A sine of arbitrary phase along each axis."""
    angle = 2.0 * np.pi * scene.time_s / values["period_s"]
    columns = np.concatenate((xy_columns(np.sin(angle)), xy_columns(np.cos(angle))), axis=-1)
    return BasisField(columns, random_amplitude=("amplitude_px", "px", 2.0**0.5))


def _thermal_oscillation_grid(scene: RunGeometry) -> Iterable[Values]:
    """Frequencies half a cycle per run apart; a wider grid misses spectral lines."""
    frequencies = np.arange(1.0 / LONGEST_S, 1.0 / SHORTEST_S, 0.5 / scene.end_s)
    return ({"period_s": float(1.0 / frequency)} for frequency in frequencies)


THERMAL_OSCILLATION = EffectClass(
    "thermal_oscillation",
    "the image oscillates with one period",
    _thermal_oscillation,
    _thermal_oscillation_grid,
    nonlinear_parameters=(NonlinearParameter("period_s", "s", 1.02, ratio=True),),
    group="G8",
    discriminating_experiment="the temperatures of laboratory and chiller, logged during the run",
    recurrence=Recurrence.NEW_DRAW,
)
