"""The spine: what happens to a pair, from exported bytes to strain.

    ExportedFile --read_frame--> Frame \
    ExportedFile --read_frame--> Frame --Pair--> DisparityMap --> Estimate --> Displacement --> StrainField --> ElasticConstants

The daemon feeds it from the export folder, replay from a log, tests from the simulator. State goes in, state comes out;
what is already said is never edited: a later pair gives a later revision.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semlive import dic, mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.drift import EstimateRevision, FrameTime
from semlive.data.experiment import Phase
from semlive.data.frame import Frame, FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import FrameResult, PairResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.storage import IN_MEMORY, Storage
from semlive.data.strain import ElasticConstants, MeasuredValue, StrainGageComparison, StrainSummary, Tensor2
from semlive.diagnose.effect_correction import (
    MAX_PAIRS,
    EffectCorrection,
    MeasuredPair,
    fit_effect_correction,
    unavailable_for_long_run,
)
from semlive.diagnose.residual_whiteness import whiteness_test
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.smoother import LIVE_WINDOW_PAIRS
from semlive.estimate.joint.outputs.stage_path import stage_path_messages
from semlive.estimate.joint.solution.solver import selection_due
from semlive.estimate.method import METHODS, Method
from semlive.mechanics.reference import zero_displacement
from semlive.mechanics.strain_gage import mean_gage_strain

MAX_REVISIONS_PER_PAIR, MAX_REVISIONS_PER_REVIEW = (
    2,
    64,
)  # earlier frames corrected again, at most: with a pair, and where choices were made anew
IMPORTED = "imported"  # vendor of frames whose maps another engine made
MIN_TRANSLATION_PX = 5.0  # no specimen that is left alone moves so far
STRAIN_SIGMA_FLOOR = 1e-12  # no strain is known better
MAX_LOAD_STEPS_LIVE = (
    32  # with more load steps the constants are fitted anew only where choices are due: their covariance joins each with each
)

_NOTHING_TAKEN = EffectCorrection(0)

ElasticResult = tuple[ElasticConstants | None, StrainGageComparison | None]


@dataclass(frozen=True, slots=True, eq=False)
class ReportedFrame:
    """What was said of a frame.

    Attributes:
        summary: its mean strain.
        correction_strain: what its correction gave to that, in the method's own words; None for frame 0.
        model_strain: mean strain of what a model's effects moved, which was taken out of its map.
    """

    summary: StrainSummary
    correction_strain: Any
    model_strain: Tensor2


@dataclass(frozen=True, slots=True, eq=False)
class PrecorrelatedFrame:
    """What a pair will ask of a frame, made before the pair is whole.

    Attributes:
        prepared_reference: the frame as reference of the one after it; None if it is not expected to be one.
        from_frame_0: the map from frame 0; None where that hangs on the whole pair.
    """

    prepared_reference: dic.Reference | None
    from_frame_0: DisparityMap | None


NOT_PRECORRELATED = PrecorrelatedFrame(None, None)
NO_PRECORRELATION: Mapping[int, PrecorrelatedFrame] = MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class AnalysisState:
    """A run that has its reference frame, and what its pairs gave so far.

    Attributes:
        settings: how.
        grid: the POI, in frame 0.
        reference: frame 0 made ready for correlation; None where disparity maps come from elsewhere.
        estimator_state: what drift, distortion and motion are known from: the state of the method that the settings name.
        pairs: the pairs so far.
        maps_from_reference: disparity from frame 0 to every later frame.
        solution: the method's after the newest pair that was asked for one; None before.
        reported: what was said last of every frame, by its number; empty unless the run is followed pair by pair.
        elastic: constants and comparison with the strain gage, as they were said last.
        storage: where all that grows with the pairs is kept.
        loaded_pairs: places in `pairs` of those under load.
        revision: counts the estimates that were said.
        raw_maps: the pairs' maps as they came, where the settings have a model.
        model_correction: what its effects moved, which `estimator_state` and `maps_from_reference` then are without.
    """

    settings: AnalysisSettings
    grid: Grid
    reference: dic.Reference | None
    estimator_state: Any
    pairs: Sequence[PairDecision]
    maps_from_reference: Sequence[DisparityMap]
    solution: Any = None
    reported: Mapping[int, ReportedFrame] = field(default_factory=dict)
    elastic: ElasticResult = (None, None)
    storage: Storage = IN_MEMORY
    loaded_pairs: tuple[int, ...] = ()
    revision: int = 0
    raw_maps: tuple[tuple[DisparityMap, ...], ...] = ()
    model_correction: EffectCorrection = _NOTHING_TAKEN

    @property
    def method(self) -> Method:
        """The method of estimation."""
        return METHODS[self.settings.estimate.method]


def analyse(
    settings: AnalysisSettings, begun: AnalysisState | None, pair: Pair, foreseen: Mapping[int, PrecorrelatedFrame] = NO_PRECORRELATION
) -> tuple[AnalysisState, PairResult]:
    """Correlate one pair, update the estimate, correct the pair's frames.

    Args:
        settings: how.
        begun: what the pairs before gave, None before the first.
        pair: the next pair; the first pair's first frame is frame 0, the reference of the run.
        foreseen: what was made of its frames before, by number of export: the same result, sooner.

    Raises:
        BadInput: the pair does not fit the ones before it, or no point of interest fits the frame.
    """
    begun = begun or start(settings, pair.first)
    maps = tuple(begun.storage.store_map(one) for one in correlate(begun, pair, foreseen))
    return add_pair(begun, pair.decision, maps)


def start(settings: AnalysisSettings, first: Frame) -> AnalysisState:
    """A run that has its reference frame and nothing else."""
    grid = dic.grid_for(settings.dic, first.info.width_px, first.info.height_px)
    return replace(start_from_maps(settings, first.info, grid), reference=dic.prepare(first.image, grid, settings.dic))


def start_from_maps(settings: AnalysisSettings, first: FrameInfo, grid: Grid) -> AnalysisState:
    """A run whose disparity maps come from a log or from another DIC engine."""
    estimator = METHODS[settings.estimate.method].init(settings.estimate, grid, first.width_px, first.height_px)
    return AnalysisState(settings, grid, None, estimator, (), ())


def precorrelate(begun: AnalysisState, frame: Frame, *, first: bool) -> PrecorrelatedFrame:
    """What the next pair will ask of a frame, which may be its first; how drift smeared integrated scans only the whole pair tells."""
    settings, from_frame_0 = begun.settings.dic, None
    if begun.reference is not None and frame.info.timing.integrations.value < 2:
        from_frame_0 = dic.correlate(begun.reference, frame.image, settings, reference_frame=0, current_frame=frame.info.export)
    return PrecorrelatedFrame(dic.prepare(frame.image, begun.grid, settings) if first else None, from_frame_0)


def correlate(begun: AnalysisState, pair: Pair, foreseen: Mapping[int, PrecorrelatedFrame] = NO_PRECORRELATION) -> tuple[DisparityMap, ...]:
    """Disparity within the pair, and from frame 0 to each of its frames (frame 0 itself left out)."""
    settings, reference, k = begun.settings.dic, begun.reference, pair.decision.pair
    if reference is None:
        raise IllPosed("this run was begun from disparity maps, without the pixels of frame 0; correlate with the images' own log")
    if not begun.pairs:
        return (dic.correlate(reference, pair.second.image, settings, reference_frame=0, current_frame=1),)
    first, second = (foreseen.get(one.info.export, NOT_PRECORRELATED) for one in (pair.first, pair.second))
    own = first.prepared_reference or dic.prepare(pair.first.image, begun.grid, settings)
    within = dic.correlate(own, pair.second.image, settings, reference_frame=2 * k, current_frame=2 * k + 1)
    as_measured = begun.raw_maps[0][0] if begun.raw_maps else begun.maps_from_reference[0]
    smear = dic.missing_blur(dic.blur_of_pair(begun.pairs[0], as_measured), dic.blur_of_pair(pair.decision, within))

    def from_frame_0(frame: Frame, known: PrecorrelatedFrame, number: int) -> DisparityMap:
        if smear is None and known.from_frame_0 is not None:
            return replace(known.from_frame_0, current=number)
        return dic.correlate_with_matched_blur(reference, frame.image, settings, smear, reference_frame=0, current_frame=number)

    return within, from_frame_0(pair.first, first, 2 * k), from_frame_0(pair.second, second, 2 * k + 1)


def add_pair(begun: AnalysisState, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> tuple[AnalysisState, PairResult]:
    """Everything after correlation: take the maps in, estimate, correct the pair's frames, and earlier ones that moved.

    What the data choose stays as it was chosen before, so this costs the same after a thousand pairs as after fifty.
    """
    begun = apply_effect_model(accumulate(begun, decision, maps))
    begun = _solved(begun, begun.method.solve_live(begun.estimator_state, begun.solution))
    begun, frames = _told(begun, (2 * decision.pair, 2 * decision.pair + 1))
    begun, revised = _told(begun, _moved(begun, begun.pairs[-LIVE_WINDOW_PAIRS:])[:MAX_REVISIONS_PER_PAIR])
    if len(begun.loaded_pairs) <= MAX_LOAD_STEPS_LIVE and (revised or decision.step.phase is Phase.TENSION):
        begun = replace(begun, elastic=_elastic(begun, begun.solution, _as_known_now(begun, _loaded(begun))))
    newest = _estimate(begun, begun.solution, checked=False, lately=True)
    return begun, PairResult(decision, len(begun.pairs), maps, newest, frames, *begun.elastic, revised)


def review_hyperparameters(begun: AnalysisState) -> tuple[AnalysisState, PairResult | None]:
    """What is due when a pair has been told: noise, smoothness and terms chosen anew, the checks, and all frames that this moved.

    Nobody waits for it: the pair's own result was said before. The result has no maps, and None where nothing is due.
    """
    if not selection_due(len(begun.pairs)):
        return begun, None
    begun = _solved(begun, begun.method.solve_incremental(begun.estimator_state, begun.solution))
    begun, revised = _told(begun, _moved(begun, begun.pairs)[:MAX_REVISIONS_PER_REVIEW])
    begun = replace(begun, elastic=_elastic(begun, begun.solution, _as_known_now(begun, _loaded(begun))))
    anew = _estimate(begun, begun.solution, checked=True)
    return begun, PairResult(begun.pairs[-1], len(begun.pairs), (), anew, (), *begun.elastic, revised)


def residual_warning(begun: AnalysisState) -> tuple[str, ...]:
    """Whether what the newest solution leaves of the maps is noise; a sentence that warns where it is not. Nobody waits for it either."""
    found = whiteness_test(begun.solution, begun.pairs) if begun.settings.estimate.method == "joint" else None
    return () if found is None else found.messages()


def _solved(begun: AnalysisState, solution: Any) -> AnalysisState:
    return replace(begun, solution=solution, revision=begun.revision + 1)


def _loaded(begun: AnalysisState) -> list[PairDecision]:
    return [begun.pairs[at] for at in begun.loaded_pairs]


def _told(begun: AnalysisState, frames: Iterable[int]) -> tuple[AnalysisState, tuple[FrameResult, ...]]:
    """Frames corrected with the newest solution, and what is said of them kept."""
    results, told = [], {}
    for frame in frames:
        result, correction = _corrected(begun, begun.solution, frame)
        results.append(result)
        told[frame] = ReportedFrame(result.summary, correction, begun.model_correction.strain_of(frame))
    return replace(begun, reported=begun.storage.update(begun.reported, told)), tuple(results)


def _moved(begun: AnalysisState, looked_at: Iterable[PairDecision]) -> tuple[int, ...]:
    """Frames of pairs whose mean strain would move by more than its uncertainty, in any component, those that would most at the head."""
    found: list[tuple[float, int]] = []
    for frame in (2 * one.pair + member for one in looked_at for member in (0, 1)):
        told = begun.reported.get(frame)
        if told and told.correction_strain is not None:
            moved, sigma = _strain_moved(begun, frame), told.summary.mean_sigma
            found.append(
                (max(abs(getattr(moved, one)) / max(getattr(sigma, one), STRAIN_SIGMA_FLOOR) for one in ("exx", "eyy", "exy")), frame)
            )
    by_size = sorted((-ratio, frame) for ratio, frame in found if ratio > 1.0)
    return tuple(frame for _, frame in by_size)


def _strain_moved(begun: AnalysisState, frame: int) -> Tensor2:
    """How far a frame's mean strain moves if it is corrected as solution and effects are known now."""
    told, now = begun.reported[frame], begun.model_correction.strain_of(frame)
    moved = begun.method.strain_change(begun.solution, told.correction_strain)
    return Tensor2(*(getattr(moved, one) - getattr(now, one) + getattr(told.model_strain, one) for one in ("exx", "eyy", "exy")))


def _as_known_now(begun: AnalysisState, pairs: Iterable[PairDecision]) -> dict[int, StrainSummary]:
    """Summaries of pairs' frames, their means as if they had all been corrected with the newest solution, by number.

    An error of the distortion that all load steps share does no harm to a slope; steps corrected with different ones would.
    """
    found: dict[int, StrainSummary] = {}
    for frame in (2 * one.pair + member for one in pairs for member in (0, 1)):
        told = begun.reported[frame]
        summary = told.summary
        if told.correction_strain is not None:
            moved = _strain_moved(begun, frame)
            mean = Tensor2(*(getattr(summary.mean, one) + getattr(moved, one) for one in ("exx", "eyy", "exy")))
            summary = replace(summary, mean=mean)
        found[frame] = summary
    return found


def accumulate(begun: AnalysisState, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> AnalysisState:
    """Take a pair's maps in, from images or from a log, without asking what follows."""
    if begun.pairs:
        decision = _sharing(decision, begun.pairs[-1])
    pairs = begun.storage.append(begun.pairs, (decision,))
    loaded = (*begun.loaded_pairs, len(begun.pairs)) if decision.step.phase is Phase.TENSION else begun.loaded_pairs
    estimator = begun.method.update(begun.estimator_state, decision.pair, decision.step.phase, frame_times(pairs[0], decision), maps)
    new = (one if one in maps else begun.storage.store_map(one) for one in maps_from_reference(decision.pair, maps))
    from_frame_0 = begun.storage.append(begun.maps_from_reference, new)
    measured = (*begun.raw_maps, maps) if begun.settings.model.effects and len(begun.pairs) <= MAX_PAIRS else ()
    return replace(begun, estimator_state=estimator, pairs=pairs, loaded_pairs=loaded, maps_from_reference=from_frame_0, raw_maps=measured)


def apply_effect_model(begun: AnalysisState) -> AnalysisState:
    """The run with what its model's effects moved, fitted to all of its pairs, taken out of all maps; itself where it has no model.

    Ask for it before `solve`, `correct_frame` and `finalise` where pairs were only absorbed.
    """
    settings, pairs = begun.settings, begun.pairs
    if not settings.model.effects or begun.model_correction.pairs == len(pairs):
        return begun
    if len(pairs) > MAX_PAIRS and not begun.model_correction.displacement_by_frame:
        return replace(begun, model_correction=unavailable_for_long_run(len(pairs)))
    seen = []
    for decision, maps in zip(pairs, begun.raw_maps, strict=True):
        within = (one for one in maps if one.reference != 0)
        seen.append(MeasuredPair(decision, frame_times(pairs[0], decision), (*within, *maps_from_reference(decision.pair, maps))))
    taken = fit_effect_correction(settings.model, settings.estimate, settings.specimen.loading_axis, seen)
    if not taken.displacement_by_frame and not begun.model_correction.displacement_by_frame:
        return replace(begun, model_correction=taken)
    fresh = start_from_maps(settings, pairs[0].first, begun.grid)
    for decision, maps in zip(pairs, begun.raw_maps, strict=True):
        fresh = accumulate(fresh, decision, tuple(taken.apply(one) for one in maps))
    return replace(
        begun, estimator_state=fresh.estimator_state, maps_from_reference=fresh.maps_from_reference, solution=None, model_correction=taken
    )


def _sharing(decision: PairDecision, before: PairDecision) -> PairDecision:
    """The same, with what its frames have in common with those of another pair held once: half of what a pair takes."""

    def alike(one: FrameInfo, other: FrameInfo) -> FrameInfo:
        shared = {name: getattr(other, name) for name in ("timing", "pixel_size_m", "column") if getattr(one, name) == getattr(other, name)}
        return replace(one, **shared)

    first = alike(decision.first, before.first)
    return replace(decision, first=first, second=alike(decision.second, first))


def maps_from_reference(pair: int, maps: tuple[DisparityMap, ...]) -> tuple[DisparityMap, ...]:
    """The maps from frame 0; where another engine made none to a pair's second frame, it is that to the first and the one within."""
    found = tuple(one for one in maps if one.reference == 0)
    within = next((one for one in maps if one.reference == 2 * pair), None)
    first = next((one for one in found if one.current == 2 * pair), None)
    if first is None or within is None or any(one.current == 2 * pair + 1 for one in found):
        return found
    return (*found, dic.compose_maps(first, within))


def solve(begun: AnalysisState) -> Any:
    """What all pairs together say, in the method's own words; everything that the data choose is chosen anew."""
    return begun.method.solve(begun.estimator_state)


def correct_frame(begun: AnalysisState, solution: Any, frame: int) -> FrameResult:
    """One frame, corrected with what `solve` gave.

    Args:
        begun: the run.
        solution: of it.
        frame: number of the frame; its pair is one of the run's.
    """
    return _corrected(begun, solution, frame)[0]


def finalise(
    begun: AnalysisState,
    each: Callable[[FrameResult], None] | None = None,
    solution: Any = None,
    looked_at: Callable[[int], None] | None = None,
    point_sigma: bool = False,
) -> RunResult:
    """The whole run, every frame corrected with the newest estimate.

    Args:
        begun: the run.
        each: given every frame in turn, which the result then does not keep; without it the result has all of them.
        solution: what `solve` gave, if it was asked before.
        looked_at: told every frame after its map was looked at for the first time, before any is corrected.
        point_sigma: also say how uncertain the correction is at every point: 0.02 s a frame.
    """
    solution = solution or solve(begun)
    kept: list[FrameResult] = []
    summaries: list[StrainSummary] = []
    for result in _all_corrected(begun, solution, looked_at, point_sigma):
        summaries.append(result.summary)
        (each or kept.append)(result)
    newest = _estimate(begun, solution, checked=True)
    elastic, gage = _elastic(begun, solution, {one.frame: one for one in summaries})
    notes = (*newest.notes, *residual_warning(replace(begun, solution=solution)), *mechanics.gage_notes(gage))
    return RunResult(tuple(begun.pairs), newest, tuple(kept), elastic, notes, gage, tuple(summaries))


def calibration_refusal(result: RunResult, settings: AnalysisSettings) -> str | None:
    """Why nothing under load is to be believed of a run: its translations do not determine the distortion; None where they do.

    A run without translations asks for no distortion, and is warned of alone. What another engine's table left open is told by how far
    the specimen moved.
    """
    quality = result.estimate.calibration
    loaded = any(one.step.phase is Phase.TENSION for one in result.decisions)
    if not loaded or quality is None or not quality.refused or settings.estimate.accept_poor_calibration:
        return None
    unloaded = [one for one in result.decisions if one.step.phase is not Phase.TENSION]
    asked = any(one.step.shift_px != (0.0, 0.0) for one in unloaded)
    if not asked and result.decisions[0].first.vendor == IMPORTED:
        numbers = {one.pair for one in unloaded}
        moved = [one.shift_px for one in result.estimate.motions if one.pair in numbers]
        asked = len(moved) > 1 and float(np.ptp(moved, axis=0).max()) > MIN_TRANSLATION_PX
    return quality.refused if asked else None


def _estimate(begun: AnalysisState, solution: Any, *, checked: bool, lately: bool = False) -> EstimateRevision:
    """What is known, with what the stage's commands and, where due, the halves of the data say of it."""
    found = begun.method.to_estimate(solution, revision=max(begun.revision, len(begun.pairs)), newest_only=lately)
    checks = begun.method.consistency_messages(solution) if checked else ()
    whole = begun.pairs if len(found.motions) == len(begun.pairs) else ()
    path = stage_path_messages(((one.pair, one.step.shift_um) for one in whole if one.step.phase is not Phase.TENSION), found.motions)
    return replace(found, notes=(*found.notes, *path, *checks, *begun.model_correction.notes))


def frame_times(reference: PairDecision, decision: PairDecision) -> tuple[FrameTime, FrameTime]:
    """When a pair's frames were scanned, seconds after the start of frame 0."""
    zero_ns = reference.first.start_time_ns.value
    infos = (decision.first, decision.second)
    first, second = (
        FrameTime(2 * decision.pair + member, (info.start_time_ns.value - zero_ns) / 1e9, info.timing, info.start_sigma_s)
        for member, info in enumerate(infos)
    )
    return first, second


def _corrected(begun: AnalysisState, solution: Any, frame: int) -> tuple[FrameResult, Any]:
    """A frame, and what its correction gave to its mean strain; frame 0 has none."""
    correction = begun.method.correction_strains(solution, (_map_to(begun, frame),))[0] if frame else None
    return _as_corrected(begun, solution, frame, correction), correction


def _all_corrected(
    begun: AnalysisState, solution: Any, looked_at: Callable[[int], None] | None, point_sigma: bool
) -> Iterator[FrameResult]:
    """Every frame in turn; what concerns their uncertainty is asked of the method for all at once."""
    frames = [2 * decision.pair + member for decision in begun.pairs for member in (0, 1)]

    def maps() -> Iterator[DisparityMap]:
        for frame in filter(None, frames):
            yield _map_to(begun, frame)
            if looked_at is not None:
                looked_at(frame)

    corrections = iter(begun.method.correction_strains(solution, maps()))
    again = (_map_to(begun, frame) for frame in frames if frame)
    sigmas = iter(begun.method.correction_sigmas(solution, again)) if point_sigma else itertools.repeat(None)
    for frame in frames:
        found = _as_corrected(begun, solution, frame, next(corrections) if frame else None)
        sigma = next(sigmas) if frame else (np.zeros(begun.grid.shape),) * 2 if point_sigma else None
        if sigma is not None:
            found = replace(found, displacement=replace(found.displacement, systematic_u_px=sigma[0], systematic_v_px=sigma[1]))
        yield found


def _map_to(begun: AnalysisState, frame: int) -> DisparityMap:
    usual = begun.maps_from_reference[frame - 1 : frame]  # where every pair came in its turn
    return next(one for one in itertools.chain(usual, begun.maps_from_reference) if one.current == frame)


def _as_corrected(begun: AnalysisState, solution: Any, frame: int, correction: Any) -> FrameResult:
    points, settings = begun.settings.estimate.window_points, begun.settings.estimate.strain
    if frame == 0:
        still = zero_displacement(begun.grid)
        strain = mechanics.strain_field(still, points, settings)
        return FrameResult(still, strain, mechanics.summary(still, strain))
    disparity = _map_to(begun, frame)
    displacement = mechanics.displacement(disparity, begun.method.correction(solution, disparity))
    strain = mechanics.strain_field(displacement, points, settings)
    return FrameResult(displacement, strain, mechanics.summary(displacement, strain, solution.noise_floor_px, correction.sigma, settings))


def _elastic(begun: AnalysisState, solution: Any, summaries: Mapping[int, StrainSummary]) -> ElasticResult:
    """From one point for each load step: the frames of a pair share their gradient, their difference says nothing of stiffness."""
    specimen, steps = begun.settings.specimen, _load_steps(begun, summaries)
    if specimen.area_mm2 is None or not steps:
        return None, None
    area_mm2, axis = specimen.area_mm2, specimen.loading_axis
    elastic, gage, count = None, None, len(steps)

    def covariance(functions: NDArray[np.float64]) -> NDArray[np.float64]:
        return begun.method.mean_strain_covariance(solution, [one.frame for *_, one in steps], functions)

    with suppress(IllPosed):
        elastic = mechanics.elastic_constants([(load_n, one) for _, load_n, _, one in steps], area_mm2, axis, covariance=covariance)
    said = [(pair, load_n, by_gage, one) for pair, load_n, by_gage, one in steps if by_gage is not None]
    if said:
        at = np.array([step for step, (_, _, by_gage, _) in enumerate(steps) if by_gage is not None])
        both = np.concatenate((at, at + count))

        def of_said(functions: NDArray[np.float64]) -> NDArray[np.float64]:
            whole = np.zeros((len(functions), 2 * count))
            whole[:, both] = functions
            return covariance(whole)

        with suppress(IllPosed):
            gage = mechanics.compare_with_gage(said, area_mm2, axis, specimen.gage_factor_sigma, of_said)
    return elastic, gage


def _load_steps(
    begun: AnalysisState, summaries: Mapping[int, StrainSummary]
) -> list[tuple[int, float, MeasuredValue | None, StrainSummary]]:
    """(pair, mean load in N, mean of the strain gage if there is one, mean strain) of every load step."""
    return [
        (
            one.pair,
            0.5 * (one.loads[0].mean_n + one.loads[1].mean_n) - begun.model_correction.load_of(one.pair),
            mean_gage_strain(*one.loads),
            mechanics.average_of_pair(summaries[2 * one.pair], summaries[2 * one.pair + 1]),
        )
        for one in _loaded(begun)
        if one.loads is not None
    ]
