"""A permanent jump of the image during a frame, for example by a slipping grip, a discharge or thermal stress."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

PLACES = np.arange(0.05, 1.0, 0.1)  # as fractions of the time in which a frame scans the points


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = J H(T - T_s), T_s in a frame; a block scanned during the jump is displaced by the fraction of its rows after T_s.

    With a sharp edge, a jump of 0.12 px was identified together with two further effects that compensated the edge.
    """
    share = np.clip((scene.time_s - values["at_s"]) / _block_s(scene) + 0.5, 0.0, 1.0)
    return BasisField(xy_columns(share), xy_parameters("px"))


def _block_s(scene: RunGeometry) -> float:
    """Scan time of the rows of one block, s."""
    spacing_s = np.asarray(np.diff(np.sort(scene.time_in_frame_s[0])), dtype=np.float64)
    return float(np.quantile(spacing_s[spacing_s > 0.1 * spacing_s.max()], 0.5)) or 1.0


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Ten instants in every frame within the rows with points; a jump in other rows equals one between two frames."""
    first_s, last_s = float(scene.time_in_frame_s.min()), float(scene.time_in_frame_s.max())
    return ({"at_s": float(start_s + first_s + place * (last_s - first_s))} for start_s in scene.start_s for place in PLACES)


FAMILY = EffectClass(
    "drift_jump",
    "the image jumps permanently during a frame",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("at_s", "s", 9.5),),
    discriminating_experiment="load and grey level at that instant: the load drops with a slip, a discharge causes a flash",
    sizes_px=(0.003, 10.0),
    recurrence=Recurrence.ONE_TIME,
)
