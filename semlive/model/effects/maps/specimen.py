"""Effects of the specimen, the load frame and the stage on disparity maps."""

import numpy as np

from semlive.model.effects.effect_class import (
    BasisField,
    EffectClass,
    NonlinearParameter,
    Recurrence,
    ReportedParameter,
    Values,
    values_grid,
    xy_parameters,
)
from semlive.model.effects.run_geometry import RunGeometry, exponential_decay, field_column, times_time_columns, xy_columns

POISSON = 0.33
TIME_CONSTANTS_S = tuple(np.geomspace(8.0, 400.0, 9))
"""Time constants of the motion after a step or a move."""


# Perspective by tilt of the specimen under load with misaligned grips.


def _tilt_with_load(scene: RunGeometry, values: Values) -> BasisField | None:
    """U = a x y, v = a y^2, a proportional to the load."""
    del values
    if not scene.load.any():
        return None
    shape = field_column(scene.x * scene.y * scene.load, scene.y**2 * scene.load)
    row = np.array([1.0 / (scene.half_px**2 * scene.highest_n)])
    return BasisField(shape, (ReportedParameter("tilt_over_working_distance_per_n", "1/(px N)", row),))


TILT_WITH_LOAD = EffectClass(
    "tilt_with_load",
    "the specimen tilts with the load: (u, v) = a F (x y, y^2)",
    _tilt_with_load,
    group="G11",
    discriminating_experiment="unload to zero and repeat; working distance in focus at nine points",
)


# Creep of the specimen at constant load.
ONSETS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


def _creep_in_hold(scene: RunGeometry, values: Values) -> BasisField | None:
    """Eps = c F ln(1 + (T - T_k) / t0), across -nu eps."""
    if not scene.load.any():
        return None
    strain = scene.load * np.log1p(scene.since_step_at_s / values["onset_s"])
    reported = (ReportedParameter("strain_per_n", "1/N", np.array([1.0 / (scene.half_px * scene.highest_n)])),)
    return BasisField(field_column(-POISSON * scene.x * strain, scene.y * strain), reported)


CREEP_IN_HOLD = EffectClass(
    "creep_in_hold",
    "the specimen creeps during the hold: eps = c F ln(1 + t / t0)",
    _creep_in_hold,
    values_grid("onset_s", ONSETS_S),
    nonlinear_parameters=(NonlinearParameter("onset_s", "s", 3.0, ratio=True),),
    discriminating_experiment="a longer hold with a third frame; the load in displacement "
    "control falls as the strain grows in load control",
)


# Decaying motion after each load step by seating of the grips and settling of the load frame.


def _load_step_transient(scene: RunGeometry, values: Values) -> BasisField | None:
    """D += dF A exp(-(T - T_k) / tau)."""
    largest_n = float(np.abs(scene.steps.load_change_n).max())
    if largest_n == 0.0:
        return None
    fall = exponential_decay(scene, scene.steps.load_change_n[:, None] / largest_n, values["time_constant_s"])
    return BasisField(xy_columns(fall[..., 0]), xy_parameters("px/N", 1.0 / largest_n))


LOAD_STEP_TRANSIENT = EffectClass(
    "load_step_transient",
    "the image creeps after each load step with an exponential decay",
    _load_step_transient,
    values_grid("time_constant_s", TIME_CONSTANTS_S),
    nonlinear_parameters=(NonlinearParameter("time_constant_s", "s", 1.63, ratio=True),),
    discriminating_experiment="a step without a change of load, and a longer hold",
    sizes_px=(0.003, 10.0),
)


# Decaying motion of the stage after each move.


def _stage_step_transient(scene: RunGeometry, values: Values) -> BasisField | None:
    """D += A m_n exp(-(T - T_n) / tau) along the move."""
    largest_px = float(np.abs(scene.steps.move_px).max())
    if largest_px == 0.0:
        return None
    fall = exponential_decay(scene, scene.steps.move_px / largest_px, values["time_constant_s"])
    return BasisField(fall[..., None], (ReportedParameter("fraction", "1", np.array([1.0 / largest_px])),))


STAGE_STEP_TRANSIENT = EffectClass(
    "stage_step_transient",
    "the stage creeps along each move with an exponential decay",
    _stage_step_transient,
    values_grid("time_constant_s", TIME_CONSTANTS_S),
    nonlinear_parameters=(NonlinearParameter("time_constant_s", "s", 1.63, ratio=True),),
    discriminating_experiment="a longer wait after some of the moves, or beam shifts instead",
    sizes_px=(0.003, 10.0),
)


# Small rotation of the specimen with each move by the guides of the stage.


def _stage_yaw(scene: RunGeometry, values: Values) -> BasisField | None:
    """An independent rotation of each calibration pair except the first; in later pairs the gradient is free."""
    del values
    pairs = [pair for pair in np.unique(scene.pair)[1:] if not scene.steps.gradient_free[scene.pair == pair].any()]
    if not pairs:
        return None
    each = (scene.pair[:, None] == np.array(pairs)[None]).astype(np.float64)[:, None, :]
    return BasisField(times_time_columns(field_column(-scene.y, scene.x), each), random_amplitude=("sd_rad", "rad", 1.0 / scene.half_px))


STAGE_YAW = EffectClass(
    "stage_yaw",
    "each move rotates the specimen slightly",
    _stage_yaw,
    group="G2",
    discriminating_experiment="an hour of pairs with a stationary stage: a rotation only with moves is that of the stage",
    recurrence=Recurrence.FOLLOWS_MOVES,
)


# In-plane bending of the specimen by an eccentric load.


def _bending_misalignment(scene: RunGeometry, values: Values) -> BasisField | None:
    """U = -k F (y^2 + nu x^2) / 2, v = k F x y."""
    del values
    if not scene.load.any():
        return None
    shape = field_column(-0.5 * (scene.y**2 + POISSON * scene.x**2) * scene.load, scene.x * scene.y * scene.load)
    return BasisField(shape, (ReportedParameter("curvature_per_n", "1/(px N)", np.array([1.0 / (scene.half_px**2 * scene.highest_n)])),))


BENDING_MISALIGNMENT = EffectClass(
    "bending_misalignment",
    "the specimen bends in its plane as the load grows",
    _bending_misalignment,
    group="G11",
    discriminating_experiment="the specimen turned over in the grips, or a strain gage on either edge",
)


# Inhomogeneous strain of the specimen by grains, yielding or a crack: the measured quantity, never corrected.
WAVES = 9


def _inhomogeneous_strain(scene: RunGeometry, values: Values) -> BasisField | None:
    """A smooth field that grows with the load: cosines over the material points, finer ones smaller."""
    del values
    if not scene.load.any():
        return None
    at = scene.address_px - scene.disparity_px
    low, high = at.min(axis=(0, 1)), at.max(axis=(0, 1))
    x, y = np.moveaxis((at - low) / (high - low), -1, 0)
    columns = []
    for i in range(WAVES):
        for j in range(WAVES - i):
            if i + j >= 2:
                size = 1.0 / (1.0 + (i * i + j * j) / 8.0)
                columns.append(xy_columns(size * np.cos(np.pi * i * x) * np.cos(np.pi * j * y) * scene.load))
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


INHOMOGENEOUS_STRAIN = EffectClass(
    "inhomogeneous_strain",
    "the specimen deforms inhomogeneously with the load: the measured signal, not corrected",
    _inhomogeneous_strain,
    group="G11",
    discriminating_experiment="unload: the residual is plastic; a fresh field",
    strain_like=True,
)
