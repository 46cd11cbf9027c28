"""Subtraction of the effects of a model from the maps of a run before the estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from semlive import estimate
from semlive.data.diagnosis import EffectModel, ModelEffect
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.settings import EstimateSettings
from semlive.data.strain import Tensor2
from semlive.diagnose.baseline.model_effects import effect_displacement, interpolate_to_grid, observable_effects, subtract_effects
from semlive.diagnose.baseline.observation import Observation, StepConditions, baseline_solution, make_observation, step_conditions
from semlive.diagnose.maps.relinearise import choose_coupling
from semlive.diagnose.scalars.load_cell import LoadReadings, load_offsets, load_readings
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.normal_equations import DENSE_PAIRS
from semlive.model.effects.load_cell import LOAD_CELL_EFFECTS, OUT_OF_PLANE
from semlive.model.effects.stage import non_map_effect

Array = NDArray[np.float64]
MAX_PAIRS = DENSE_PAIRS
"""That effects are fitted to: baseline and effects are one matrix over all pairs."""
NOTHING = Tensor2(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """A measured pair.

    Attributes:
        decision: the decision that requested the pair.
        times: scan times of its frames.
        maps: the map within the pair and the maps from frame 0 to each of its frames.
    """

    decision: PairDecision
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]


@dataclass(frozen=True, slots=True, eq=False)
class EffectCorrection:
    """Displacement caused by the effects of a model in a run so far.

    Attributes:
        pairs: numbers of the pairs used in the fit.
        displacement_by_frame: by frame number, (ny, nx, 2) displacement subtracted from the map, px; empty if nothing is subtracted.
        strain: by frame number, mean strain of that displacement.
        loads_n: by pair number, error of the load cell reading, N.
        notes: sentences for the operator.
    """

    pairs: int
    displacement_by_frame: Mapping[int, Array] = field(default_factory=dict)
    strain: Mapping[int, Tensor2] = field(default_factory=dict)
    loads_n: Mapping[int, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def apply(self, disparity: DisparityMap) -> DisparityMap:
        """Subtract the displacement from a map."""
        return subtract_effects(disparity, self.displacement_by_frame)

    def strain_of(self, frame: int) -> Tensor2:
        """Mean strain subtracted from a frame."""
        return self.strain.get(frame, NOTHING)

    def load_of(self, pair: int) -> float:
        """Error of the load cell reading of a pair, N."""
        return self.loads_n.get(pair, 0.0)


def fit_effect_correction(
    model: EffectModel, settings: EstimateSettings, loading_axis: str, observed: Sequence[MeasuredPair]
) -> EffectCorrection:
    """Fit the amplitudes of the effects of a model to all pairs so far, jointly with drift, distortion and motion.

    Effects of the load cell are fitted to its readings together with the strain of maps corrected for the other effects. If the fit fails,
    nothing is subtracted and a note gives the reason; the run continues.

    Args:
        model: the effects.
        settings: settings of the estimate; the fit uses the joint method.
        loading_axis: image axis of the load, ``x`` or ``y``.
        observed: the pairs so far, in order of arrival.
    """
    if len(observed) > MAX_PAIRS:
        return unavailable_for_long_run(len(observed))
    first = observed[0].decision.first
    of_maps = [effect for effect in model.effects if non_map_effect(effect.name) is None]
    of_cell = [effect.name for effect in model.effects if effect.name in LOAD_CELL_EFFECTS]
    notes = [f"model: {effect.name} is {_kind(effect)}, and is left in" for effect in model.effects if _left_alone(effect)]
    why = incompatibility_reason(model, (first.width_px, first.height_px))
    if why or not (of_maps or of_cell):
        return EffectCorrection(
            len(observed), notes=(*((f"WARNING: model: nothing is taken out of the maps: {why}",) if why else ()), *notes)
        )
    state = estimate.init(settings, observed[0].maps[0].grid, first.width_px, first.height_px)
    for entry in observed:
        state = estimate.update(state, entry.decision.pair, entry.decision.step.phase, entry.times, entry.maps)
    try:
        steps = step_conditions([entry.decision for entry in observed])
        solution, alternative = baseline_solution(state)
        observation = make_observation(solution, steps, alternative)
    except IllPosed as error:
        return EffectCorrection(len(observed), notes=(f"model: nothing is taken out of the maps yet: {error}", *notes))
    loads_n, said = _cell(load_readings(observation, steps, loading_axis), of_cell, steps)
    if not of_maps:
        return EffectCorrection(len(observed), loads_n=loads_n, notes=(*said, *notes))
    return replace(_taken(observation, of_maps, [*said, *notes]), loads_n=loads_n)


def _left_alone(effect: ModelEffect) -> bool:
    return non_map_effect(effect.name) is not None and effect.name not in LOAD_CELL_EFFECTS


def _kind(effect: ModelEffect) -> str:
    return "strain to the maps" if effect.name == OUT_OF_PLANE.name else "not a matter of maps"


def _cell(readings: LoadReadings, names: Sequence[str], steps: Sequence[StepConditions]) -> tuple[dict[int, float], list[str]]:
    """Error of the load cell reading of each pair, and the notes about it."""
    added = load_offsets(readings, names)
    total = np.sum([np.zeros(len(steps)), *added.values()], axis=0)
    notes = [f"model: {name}, {value[np.argmax(np.abs(value))]:+.2f} N at most, taken off the loads" for name, value in added.items()]
    notes += [f"model: {name} cannot be seen in these readings, and is left in" for name in names if name not in added]
    return ({step.pair: float(load_n) for step, load_n in zip(steps, total, strict=True)} if added else {}), notes


def unavailable_for_long_run(pairs: int) -> EffectCorrection:
    """Empty correction of a run with more pairs than the fit supports. In a live run, earlier pairs lose their correction."""
    why = f"{pairs} pairs are more than the {MAX_PAIRS} that its effects can be fitted to together"
    return EffectCorrection(pairs, notes=(f"WARNING: model: nothing is taken out of the maps: {why}",))


def incompatibility_reason(model: EffectModel, size_px: tuple[int, int]) -> str:
    """Reason why a model does not apply to frames of a size; empty if it does."""
    if model.size_px is None or model.size_px == size_px:
        return ""
    return f"it was found in frames of {model.size_px[0]} x {model.size_px[1]} px, and these are {size_px[0]} x {size_px[1]} px"


def _taken(observation: Observation, effects: Sequence[ModelEffect], notes: Sequence[str]) -> EffectCorrection:
    observed = observable_effects(observation, effects)
    moved = effect_displacement(choose_coupling(observation, (), observed).observation, observed)
    out = [effect for effect in moved.effects if effect not in moved.not_corrected]
    said = [f"model: {', '.join(out)} taken out of the maps; what is stated of strain does not hold their uncertainty"] if out else []
    said += [f"model: {value} is strain or cannot be told from it, and is left in" for value in moved.not_corrected]
    said += [
        f"model: {effect.name} cannot be seen: there are no loads or moves for it to go with"
        for effect in effects
        if effect not in observed
    ]
    fields = interpolate_to_grid(observation, moved.field_px, observation.grid) if out else {}
    strain = {frame: _strain(observation.grid, moved_px) for frame, moved_px in fields.items()}
    return EffectCorrection(len(observation.geometry.frame) // 2, fields, strain, notes=(*said, *notes))


def _strain(grid: Grid, moved_px: Array) -> Tensor2:
    """Strain of the plane fitted to a field (ny, nx, 2)."""
    x, y = grid.mesh()
    rows = np.stack((np.ones_like(x), x, y), axis=-1).reshape(-1, 3)
    _, along_x, along_y = np.linalg.lstsq(rows, moved_px.reshape(-1, 2), rcond=None)[0]
    return Tensor2(float(along_x[0]), float(along_y[1]), 0.5 * float(along_x[1] + along_y[0]))
