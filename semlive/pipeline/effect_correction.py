"""Fit the effect model of the settings to a run; its displacement is subtracted from the maps before estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from semlive import estimate
from semlive.data.diagnosis.effects import EffectModel, ModelEffect
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.grid import Grid
from semlive.data.notes import Note, NoteCode, information, warning
from semlive.data.pair import PairDecision
from semlive.data.settings import EstimateSettings
from semlive.data.strain import Tensor2
from semlive.diagnose.baseline.model_effects import (
    EffectDisplacement,
    effect_displacement,
    interpolate_to_grid,
    observable_effects,
    subtract_effects,
)
from semlive.diagnose.baseline.observation import (
    Observation,
    StepConditions,
    baseline_solution,
    make_observation,
    rows_from_frame_0,
    step_conditions,
)
from semlive.diagnose.maps.relinearise import choose_coupling
from semlive.diagnose.scalars.load_cell import LoadReadings, load_offsets, load_readings
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.accumulation import DENSE_PAIRS
from semlive.model.effects.load_cell import LOAD_CELL_EFFECTS, OUT_OF_PLANE
from semlive.model.effects.stage import non_map_effect

Array = NDArray[np.float64]
MAX_PAIRS = DENSE_PAIRS
"""Limit for the fit of effects: baseline and effects are one matrix over all pairs."""
ZERO_STRAIN = Tensor2(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """A pair with its maps as measured.

    Attributes:
        decision: of the pair.
        times: scan times of its frames.
        maps: within the pair and from frame 0 to each of its frames.
    """

    decision: PairDecision
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]


@dataclass(frozen=True, slots=True, eq=False)
class EffectCorrection:
    """Displacement, strain and load offsets of a model's effects in a run so far.

    Attributes:
        pairs: number of pairs in the fit.
        displacement_by_frame: by frame number (ny, nx, 2), px; empty where no effect is subtracted.
        strain: mean strain of the displacement by frame number.
        loads_n: error of the load cell by pair number.
        notes: notes for the operator.
    """

    pairs: int
    displacement_by_frame: Mapping[int, Array] = field(default_factory=dict)
    strain: Mapping[int, Tensor2] = field(default_factory=dict)
    loads_n: Mapping[int, float] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()

    def apply(self, disparity: DisparityMap) -> DisparityMap:
        """Subtract the displacement from a map."""
        return subtract_effects(disparity, self.displacement_by_frame)

    def strain_of(self, frame: int) -> Tensor2:
        """Mean strain of the displacement that is subtracted from a frame."""
        return self.strain.get(frame, ZERO_STRAIN)

    def load_of(self, pair: int) -> float:
        """Error of the load cell in a pair's reading, N."""
        return self.loads_n.get(pair, 0.0)


def fit_effect_correction(
    model: EffectModel, settings: EstimateSettings, loading_axis: str, measured: Sequence[MeasuredPair]
) -> EffectCorrection:
    """Fit the amplitudes of a model's effects to all pairs so far, jointly with drift, distortion and motion.

    Errors of the load cell are fitted to its readings, jointly with the strain in maps without the other effects.
    Where the fit is not possible, no effect is subtracted, a note gives the reason, and the run continues.

    Args:
        model: the effects.
        settings: of the estimate; effects are always fitted with the joint method.
        loading_axis: axis of the image along which the specimen is loaded.
        measured: the pairs so far, in order.
    """
    if len(measured) > MAX_PAIRS:
        return unavailable_for_long_run(len(measured))
    first = measured[0].decision.first
    of_maps = [one for one in model.effects if non_map_effect(one.name) is None]
    of_cell = [one.name for one in model.effects if one.name in LOAD_CELL_EFFECTS]
    notes = [_note(f"{one.name} is {_kind(one)}, and is left in") for one in model.effects if _is_not_corrected(one)]
    why = incompatibility_reason(model, (first.width_px, first.height_px))
    if why or not (of_maps or of_cell):
        unsuitable = (_nothing_corrected(NoteCode.EFFECTS_OF_OTHER_FRAMES, why),) if why else ()
        return EffectCorrection(len(measured), notes=(*unsuitable, *notes))
    state = estimate.init(settings, measured[0].maps[0].grid, first.width_px, first.height_px)
    for one in measured:
        state = estimate.update(state, one.decision.pair, one.decision.step.phase, one.times, one.maps)
    try:
        steps = step_conditions([one.decision for one in measured])
        rows_from_frame_0(state, steps)  # a solution of too few pairs, which takes seconds, would not be used
        solution, other = baseline_solution(state)
        observation = make_observation(solution, steps, other)
        observed = observable_effects(observation, of_maps)
        moved = effect_displacement(choose_coupling(observation, (), observed).observation, observed) if of_maps else None
        # Strain of the estimate contains what the maps' effects add to it, which would count as an error of the cell.
        with_effects = moved.baseline_with_effects if moved is not None and observed else None
        loads_n, load_notes = _cell(load_readings(observation, steps, loading_axis, with_effects), of_cell, steps)
        if moved is None:
            return EffectCorrection(len(measured), loads_n=loads_n, notes=(*load_notes, *notes))
        notes = [*load_notes, *_not_observed(of_maps, observed), *notes]
        return replace(_map_correction(observation, moved, notes), loads_n=loads_n)
    except IllPosed as error:
        return EffectCorrection(len(measured), notes=(_note(f"nothing is taken out of the maps yet: {error}"), *notes))


def _is_not_corrected(effect: ModelEffect) -> bool:
    return non_map_effect(effect.name) is not None and effect.name not in LOAD_CELL_EFFECTS


def _kind(effect: ModelEffect) -> str:
    return "strain to the maps" if effect.name == OUT_OF_PLANE.name else "not a matter of maps"


def _cell(readings: LoadReadings, names: Sequence[str], steps: Sequence[StepConditions]) -> tuple[dict[int, float], list[Note]]:
    """Error of the load cell in each pair's reading, and the notes on it."""
    added = load_offsets(readings, names)
    total = np.sum([np.zeros(len(steps)), *added.values()], axis=0)
    notes = [_note(f"{name}, {value[np.argmax(np.abs(value))]:+.2f} N at most, taken off the loads") for name, value in added.items()]
    notes += [_note(f"{name} cannot be seen in these readings, and is left in") for name in names if name not in added]
    return ({step.pair: float(load_n) for step, load_n in zip(steps, total, strict=True)} if added else {}), notes


def _note(text: str) -> Note:
    return information(NoteCode.EFFECTS, f"model: {text}")


def _nothing_corrected(code: NoteCode, why: str) -> Note:
    return warning(code, f"model: nothing is taken out of the maps: {why}")


def unavailable_for_long_run(pairs: int) -> EffectCorrection:
    """No correction, for a run with more pairs than the limit of the fit; live, earlier pairs lose their correction."""
    why = f"{pairs} pairs are more than the {MAX_PAIRS} that its effects can be fitted to together"
    return EffectCorrection(pairs, notes=(_nothing_corrected(NoteCode.EFFECTS_IN_LONG_RUN, why),))


def incompatibility_reason(model: EffectModel, size_px: tuple[int, int]) -> str:
    """The reason why a model does not apply to frames of a size; empty if it applies."""
    if model.size_px is None or model.size_px == size_px:
        return ""
    return f"it was found in frames of {model.size_px[0]} x {model.size_px[1]} px, and these are {size_px[0]} x {size_px[1]} px"


def _not_observed(effects: Sequence[ModelEffect], observed: Sequence[ModelEffect]) -> list[Note]:
    missing = [effect.name for effect in effects if effect not in observed]
    return [_note(f"{name} cannot be seen: there are no loads or moves for it to go with") for name in missing]


def _map_correction(observation: Observation, moved: EffectDisplacement, notes: Sequence[Note]) -> EffectCorrection:
    out = [effect for effect in moved.effects if effect not in moved.not_corrected]
    messages = [_note(f"{', '.join(out)} taken out of the maps; the stated uncertainty of strain does not include theirs")] if out else []
    messages += [_note(f"{value} is strain or cannot be separated from it, and is left in") for value in moved.not_corrected]
    fields = interpolate_to_grid(observation, moved.field_px, observation.grid) if out else {}
    strain = {frame: _strain(observation.grid, moved_px) for frame, moved_px in fields.items()}
    return EffectCorrection(len(observation.geometry.frame) // 2, fields, strain, notes=(*messages, *notes))


def _strain(grid: Grid, moved_px: Array) -> Tensor2:
    """Strain of the plane that fits a field (ny, nx, 2) best."""
    x, y = grid.mesh()
    rows = np.stack((np.ones_like(x), x, y), axis=-1).reshape(-1, 3)
    _, along_x, along_y = np.linalg.lstsq(rows, moved_px.reshape(-1, 2), rcond=None)[0]
    return Tensor2(float(along_x[0]), float(along_y[1]), 0.5 * float(along_x[1] + along_y[0]))
