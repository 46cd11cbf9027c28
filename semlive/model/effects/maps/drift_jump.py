"""A grip slips, a charge breaks down, metal clicks as it cools: a jump in the middle of a frame, and it stays."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

PLACES = np.arange(0.05, 1.0, 0.1)  # of the time in which a frame sees the points


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = J H(T - T_s), T_s in a frame; a block that sees the jump shows the part of it that its rows after T_s are.

    With a sharp edge a jump of 0.12 px was found, and two effects more that mended the edge.
    """
    share = np.clip((scene.time_s - values["at_s"]) / _block_s(scene) + 0.5, 0.0, 1.0)
    return BasisField(xy_columns(share), xy_parameters("px"))


def _block_s(scene: RunGeometry) -> float:
    """How long the beam is in the rows of one block."""
    spacing_s = np.asarray(np.diff(np.sort(scene.time_in_frame_s[0])), dtype=np.float64)
    return float(np.quantile(spacing_s[spacing_s > 0.1 * spacing_s.max()], 0.5)) or 1.0


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Ten instants in every frame, none of them in rows without points: a jump there is one between two frames."""
    first_s, last_s = float(scene.time_in_frame_s.min()), float(scene.time_in_frame_s.max())
    return ({"at_s": float(start_s + first_s + place * (last_s - first_s))} for start_s in scene.start_s for place in PLACES)


FAMILY = EffectClass(
    "drift_jump",
    "the picture jumps in the middle of a frame and stays where it is",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("at_s", "s", 9.5),),
    discriminating_experiment="load and grey level at that instant: a slip lets the load drop, a discharge flashes",
    sizes_px=(0.003, 10.0),
    recurrence=Recurrence.ONE_TIME,
)
