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
from semlive.data.drift import Estimate, FrameTime
from semlive.data.experiment import Phase
from semlive.data.frame import Frame, FrameInfo
from semlive.data.grid import Grid
from semlive.data.keep import IN_MEMORY, Keep
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import FrameResult, PairResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import ElasticConstants, GageComparison, Measured, StrainSummary, Tensor2
from semlive.diagnose.light import whiteness
from semlive.diagnose.taken_out import MOST_PAIRS, SeenPair, TakenOut, taken_out, too_many
from semlive.errors import IllPosed
from semlive.estimate.method import METHODS, Method
from semlive.estimate.sequence import chosen_anew
from semlive.estimate.smooth import LATELY
from semlive.estimate.stage_path import stage_path_notes
from semlive.mechanics.gage import mean_gage
from semlive.mechanics.reference import at_rest

AT_ONCE, ON_SCHEDULE = 2, 64  # earlier frames corrected again, at most: with a pair, and where choices were made anew
IMPORTED = "imported"  # vendor of frames whose maps another engine made
MOVED_PX = 5.0  # no specimen that is left alone moves so far
EXACT = 1e-12  # no strain is known better
STEPS_AT_ONCE = 32  # with more load steps the constants are fitted anew only where choices are due: their covariance joins each with each

_NOTHING_TAKEN = TakenOut(0)

Elastic = tuple[ElasticConstants | None, GageComparison | None]


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What was said of a frame.

    Attributes:
        summary: its mean strain.
        correction: what its correction gave to that, in the method's own words; None for frame 0.
        effects: mean strain of what a model's effects moved, which was taken out of its map.
    """

    summary: StrainSummary
    correction: Any
    effects: Tensor2


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """What a pair will ask of a frame, made before the pair is whole.

    Attributes:
        made_ready: the frame as reference of the one after it; None if it is not expected to be one.
        from_frame_0: the map from frame 0; None where that hangs on the whole pair.
    """

    made_ready: dic.Reference | None
    from_frame_0: DisparityMap | None


UNFORESEEN = Foreseen(None, None)
NOTHING_FORESEEN: Mapping[int, Foreseen] = MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class Begun:
    """A run that has its reference frame, and what its pairs gave so far.

    Attributes:
        settings: how.
        grid: the POI, in frame 0.
        reference: frame 0 made ready for correlation; None where disparity maps come from elsewhere.
        estimator: what drift, distortion and motion are known from: the state of the method that the settings name.
        pairs: the pairs so far.
        from_frame_0: disparity from frame 0 to every later frame.
        solution: the method's after the newest pair that was asked for one; None before.
        told: what was said last of every frame, by its number; empty unless the run is followed pair by pair.
        elastic: constants and comparison with the strain gage, as they were said last.
        keep: where all that grows with the pairs is kept.
        loaded: places in `pairs` of those under load.
        revision: counts the estimates that were said.
        measured: the pairs' maps as they came, where the settings have a model.
        taken: what its effects moved, which `estimator` and `from_frame_0` then are without.
    """

    settings: AnalysisSettings
    grid: Grid
    reference: dic.Reference | None
    estimator: Any
    pairs: Sequence[PairDecision]
    from_frame_0: Sequence[DisparityMap]
    solution: Any = None
    told: Mapping[int, Told] = field(default_factory=dict)
    elastic: Elastic = (None, None)
    keep: Keep = IN_MEMORY
    loaded: tuple[int, ...] = ()
    revision: int = 0
    measured: tuple[tuple[DisparityMap, ...], ...] = ()
    taken: TakenOut = _NOTHING_TAKEN

    @property
    def method(self) -> Method:
        """The method of estimation."""
        return METHODS[self.settings.estimate.method]


def analyse(
    settings: AnalysisSettings, begun: Begun | None, pair: Pair, foreseen: Mapping[int, Foreseen] = NOTHING_FORESEEN
) -> tuple[Begun, PairResult]:
    """Correlate one pair, update the estimate, correct the pair's frames.

    Args:
        settings: how.
        begun: what the pairs before gave, None before the first.
        pair: the next pair; the first pair's first frame is frame 0, the reference of the run.
        foreseen: what was made of its frames before, by number of export: the same result, sooner.

    Raises:
        BadInput: the pair does not fit the ones before it, or no point of interest fits the frame.
    """
    begun = begun or begin(settings, pair.first)
    maps = tuple(begun.keep.map(one) for one in correlate(begun, pair, foreseen))
    return update(begun, pair.decision, maps)


def begin(settings: AnalysisSettings, first: Frame) -> Begun:
    """A run that has its reference frame and nothing else."""
    grid = dic.grid_for(settings.dic, first.info.width_px, first.info.height_px)
    return replace(begin_from_maps(settings, first.info, grid), reference=dic.prepare(first.image, grid, settings.dic))


def begin_from_maps(settings: AnalysisSettings, first: FrameInfo, grid: Grid) -> Begun:
    """A run whose disparity maps come from a log or from another DIC engine."""
    estimator = METHODS[settings.estimate.method].init(settings.estimate, grid, first.width_px, first.height_px)
    return Begun(settings, grid, None, estimator, (), ())


def foresee(begun: Begun, frame: Frame, *, first: bool) -> Foreseen:
    """What the next pair will ask of a frame, which may be its first; how drift smeared integrated scans only the whole pair tells."""
    settings, from_frame_0 = begun.settings.dic, None
    if begun.reference is not None and frame.info.timing.integrations.value < 2:
        from_frame_0 = dic.correlate(begun.reference, frame.image, settings, reference_frame=0, current_frame=frame.info.export)
    return Foreseen(dic.prepare(frame.image, begun.grid, settings) if first else None, from_frame_0)


def correlate(begun: Begun, pair: Pair, foreseen: Mapping[int, Foreseen] = NOTHING_FORESEEN) -> tuple[DisparityMap, ...]:
    """Disparity within the pair, and from frame 0 to each of its frames (frame 0 itself left out)."""
    settings, reference, k = begun.settings.dic, begun.reference, pair.decision.pair
    if reference is None:
        raise IllPosed("this run was begun from disparity maps, without the pixels of frame 0; correlate with the images' own log")
    if not begun.pairs:
        return (dic.correlate(reference, pair.second.image, settings, reference_frame=0, current_frame=1),)
    first, second = (foreseen.get(one.info.export, UNFORESEEN) for one in (pair.first, pair.second))
    own = first.made_ready or dic.prepare(pair.first.image, begun.grid, settings)
    within = dic.correlate(own, pair.second.image, settings, reference_frame=2 * k, current_frame=2 * k + 1)
    as_measured = begun.measured[0][0] if begun.measured else begun.from_frame_0[0]
    smear = dic.lacking(dic.smear_of(begun.pairs[0], as_measured), dic.smear_of(pair.decision, within))

    def from_frame_0(frame: Frame, known: Foreseen, number: int) -> DisparityMap:
        if smear is None and known.from_frame_0 is not None:
            return replace(known.from_frame_0, current=number)
        return dic.correlate_alike(reference, frame.image, settings, smear, reference_frame=0, current_frame=number)

    return within, from_frame_0(pair.first, first, 2 * k), from_frame_0(pair.second, second, 2 * k + 1)


def update(begun: Begun, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> tuple[Begun, PairResult]:
    """Everything after correlation: take the maps in, estimate, correct the pair's frames, and earlier ones that moved.

    What the data choose stays as it was chosen before, so this costs the same after a thousand pairs as after fifty.
    """
    begun = without_effects(absorb(begun, decision, maps))
    begun = _solved(begun, begun.method.live(begun.estimator, begun.solution))
    begun, frames = _told(begun, (2 * decision.pair, 2 * decision.pair + 1))
    begun, revised = _told(begun, _moved(begun, begun.pairs[-LATELY:])[:AT_ONCE])
    if len(begun.loaded) <= STEPS_AT_ONCE and (revised or decision.step.phase is Phase.TENSION):
        begun = replace(begun, elastic=_elastic(begun, begun.solution, _as_known_now(begun, _loaded(begun))))
    newest = _estimate(begun, begun.solution, checked=False, lately=True)
    return begun, PairResult(decision, len(begun.pairs), maps, newest, frames, *begun.elastic, revised)


def reconsider(begun: Begun) -> tuple[Begun, PairResult | None]:
    """What is due when a pair has been told: noise, smoothness and terms chosen anew, the checks, and all frames that this moved.

    Nobody waits for it: the pair's own result was said before. The result has no maps, and None where nothing is due.
    """
    if not chosen_anew(len(begun.pairs)):
        return begun, None
    begun = _solved(begun, begun.method.follow(begun.estimator, begun.solution))
    begun, revised = _told(begun, _moved(begun, begun.pairs)[:ON_SCHEDULE])
    begun = replace(begun, elastic=_elastic(begun, begun.solution, _as_known_now(begun, _loaded(begun))))
    anew = _estimate(begun, begun.solution, checked=True)
    return begun, PairResult(begun.pairs[-1], len(begun.pairs), (), anew, (), *begun.elastic, revised)


def still_white(begun: Begun) -> tuple[str, ...]:
    """Whether what the newest solution leaves of the maps is noise; a sentence that warns where it is not. Nobody waits for it either."""
    found = whiteness(begun.solution, begun.pairs) if begun.settings.estimate.method == "joint" else None
    return () if found is None else found.told()


def _solved(begun: Begun, solution: Any) -> Begun:
    return replace(begun, solution=solution, revision=begun.revision + 1)


def _loaded(begun: Begun) -> list[PairDecision]:
    return [begun.pairs[at] for at in begun.loaded]


def _told(begun: Begun, frames: Iterable[int]) -> tuple[Begun, tuple[FrameResult, ...]]:
    """Frames corrected with the newest solution, and what is said of them kept."""
    results, told = [], {}
    for frame in frames:
        result, correction = _corrected(begun, begun.solution, frame)
        results.append(result)
        told[frame] = Told(result.summary, correction, begun.taken.strain_of(frame))
    return replace(begun, told=begun.keep.updated(begun.told, told)), tuple(results)


def _moved(begun: Begun, looked_at: Iterable[PairDecision]) -> tuple[int, ...]:
    """Frames of pairs whose mean strain would move by more than its uncertainty, in any component, those that would most at the head."""
    found: list[tuple[float, int]] = []
    for frame in (2 * one.pair + member for one in looked_at for member in (0, 1)):
        told = begun.told.get(frame)
        if told and told.correction is not None:
            moved, sigma = _strain_moved(begun, frame), told.summary.mean_sigma
            found.append((max(abs(getattr(moved, one)) / max(getattr(sigma, one), EXACT) for one in ("exx", "eyy", "exy")), frame))
    by_size = sorted((-ratio, frame) for ratio, frame in found if ratio > 1.0)
    return tuple(frame for _, frame in by_size)


def _strain_moved(begun: Begun, frame: int) -> Tensor2:
    """How far a frame's mean strain moves if it is corrected as solution and effects are known now."""
    told, now = begun.told[frame], begun.taken.strain_of(frame)
    moved = begun.method.strain_moved(begun.solution, told.correction)
    return Tensor2(*(getattr(moved, one) - getattr(now, one) + getattr(told.effects, one) for one in ("exx", "eyy", "exy")))


def _as_known_now(begun: Begun, pairs: Iterable[PairDecision]) -> dict[int, StrainSummary]:
    """Summaries of pairs' frames, their means as if they had all been corrected with the newest solution, by number.

    An error of the distortion that all load steps share does no harm to a slope; steps corrected with different ones would.
    """
    found: dict[int, StrainSummary] = {}
    for frame in (2 * one.pair + member for one in pairs for member in (0, 1)):
        told = begun.told[frame]
        summary = told.summary
        if told.correction is not None:
            moved = _strain_moved(begun, frame)
            mean = Tensor2(*(getattr(summary.mean, one) + getattr(moved, one) for one in ("exx", "eyy", "exy")))
            summary = replace(summary, mean=mean)
        found[frame] = summary
    return found


def absorb(begun: Begun, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> Begun:
    """Take a pair's maps in, from images or from a log, without asking what follows."""
    if begun.pairs:
        decision = _sharing(decision, begun.pairs[-1])
    pairs = begun.keep.longer(begun.pairs, (decision,))
    loaded = (*begun.loaded, len(begun.pairs)) if decision.step.phase is Phase.TENSION else begun.loaded
    estimator = begun.method.update(begun.estimator, decision.pair, decision.step.phase, frame_times(pairs[0], decision), maps)
    new = (one if one in maps else begun.keep.map(one) for one in seen_from_frame_0(decision.pair, maps))
    from_frame_0 = begun.keep.longer(begun.from_frame_0, new)
    measured = (*begun.measured, maps) if begun.settings.model.effects and len(begun.pairs) <= MOST_PAIRS else ()
    return replace(begun, estimator=estimator, pairs=pairs, loaded=loaded, from_frame_0=from_frame_0, measured=measured)


def without_effects(begun: Begun) -> Begun:
    """The run with what its model's effects moved, fitted to all of its pairs, taken out of all maps; itself where it has no model.

    Ask for it before `solve`, `corrected` and `conclude` where pairs were only absorbed.
    """
    settings, pairs = begun.settings, begun.pairs
    if not settings.model.effects or begun.taken.pairs == len(pairs):
        return begun
    if len(pairs) > MOST_PAIRS and not begun.taken.by_frame:
        return replace(begun, taken=too_many(len(pairs)))
    seen = []
    for decision, maps in zip(pairs, begun.measured, strict=True):
        within = (one for one in maps if one.reference != 0)
        seen.append(SeenPair(decision, frame_times(pairs[0], decision), (*within, *seen_from_frame_0(decision.pair, maps))))
    taken = taken_out(settings.model, settings.estimate, settings.specimen.loading_axis, seen)
    if not taken.by_frame and not begun.taken.by_frame:
        return replace(begun, taken=taken)
    fresh = begin_from_maps(settings, pairs[0].first, begun.grid)
    for decision, maps in zip(pairs, begun.measured, strict=True):
        fresh = absorb(fresh, decision, tuple(taken.without(one) for one in maps))
    return replace(begun, estimator=fresh.estimator, from_frame_0=fresh.from_frame_0, solution=None, taken=taken)


def _sharing(decision: PairDecision, before: PairDecision) -> PairDecision:
    """The same, with what its frames have in common with those of another pair held once: half of what a pair takes."""

    def alike(one: FrameInfo, other: FrameInfo) -> FrameInfo:
        shared = {name: getattr(other, name) for name in ("timing", "pixel_size_m", "column") if getattr(one, name) == getattr(other, name)}
        return replace(one, **shared)

    first = alike(decision.first, before.first)
    return replace(decision, first=first, second=alike(decision.second, first))


def seen_from_frame_0(pair: int, maps: tuple[DisparityMap, ...]) -> tuple[DisparityMap, ...]:
    """The maps from frame 0; where another engine made none to a pair's second frame, it is that to the first and the one within."""
    found = tuple(one for one in maps if one.reference == 0)
    within = next((one for one in maps if one.reference == 2 * pair), None)
    first = next((one for one in found if one.current == 2 * pair), None)
    if first is None or within is None or any(one.current == 2 * pair + 1 for one in found):
        return found
    return (*found, dic.composed(first, within))


def solve(begun: Begun) -> Any:
    """What all pairs together say, in the method's own words; everything that the data choose is chosen anew."""
    return begun.method.solve(begun.estimator)


def corrected(begun: Begun, solution: Any, frame: int) -> FrameResult:
    """One frame, corrected with what `solve` gave.

    Args:
        begun: the run.
        solution: of it.
        frame: number of the frame; its pair is one of the run's.
    """
    return _corrected(begun, solution, frame)[0]


def conclude(
    begun: Begun,
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
    notes = (*newest.notes, *still_white(replace(begun, solution=solution)), *mechanics.gage_notes(gage))
    return RunResult(tuple(begun.pairs), newest, tuple(kept), elastic, notes, gage, tuple(summaries))


def refused(result: RunResult, settings: AnalysisSettings) -> str | None:
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
        asked = len(moved) > 1 and float(np.ptp(moved, axis=0).max()) > MOVED_PX
    return quality.refused if asked else None


def _estimate(begun: Begun, solution: Any, *, checked: bool, lately: bool = False) -> Estimate:
    """What is known, with what the stage's commands and, where due, the halves of the data say of it."""
    found = begun.method.estimate(solution, revision=max(begun.revision, len(begun.pairs)), lately=lately)
    checks = begun.method.checks(solution) if checked else ()
    whole = begun.pairs if len(found.motions) == len(begun.pairs) else ()
    path = stage_path_notes(((one.pair, one.step.shift_um) for one in whole if one.step.phase is not Phase.TENSION), found.motions)
    return replace(found, notes=(*found.notes, *path, *checks, *begun.taken.notes))


def frame_times(reference: PairDecision, decision: PairDecision) -> tuple[FrameTime, FrameTime]:
    """When a pair's frames were scanned, seconds after the start of frame 0."""
    zero_ns = reference.first.start_time_ns.value
    infos = (decision.first, decision.second)
    first, second = (
        FrameTime(2 * decision.pair + member, (info.start_time_ns.value - zero_ns) / 1e9, info.timing, info.start_sigma_s)
        for member, info in enumerate(infos)
    )
    return first, second


def _corrected(begun: Begun, solution: Any, frame: int) -> tuple[FrameResult, Any]:
    """A frame, and what its correction gave to its mean strain; frame 0 has none."""
    correction = begun.method.correction_strains(solution, (_map_to(begun, frame),))[0] if frame else None
    return _as_corrected(begun, solution, frame, correction), correction


def _all_corrected(begun: Begun, solution: Any, looked_at: Callable[[int], None] | None, point_sigma: bool) -> Iterator[FrameResult]:
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


def _map_to(begun: Begun, frame: int) -> DisparityMap:
    usual = begun.from_frame_0[frame - 1 : frame]  # where every pair came in its turn
    return next(one for one in itertools.chain(usual, begun.from_frame_0) if one.current == frame)


def _as_corrected(begun: Begun, solution: Any, frame: int, correction: Any) -> FrameResult:
    points, settings = begun.settings.estimate.window_points, begun.settings.estimate.strain
    if frame == 0:
        still = at_rest(begun.grid)
        strain = mechanics.strain_as(still, points, settings)
        return FrameResult(still, strain, mechanics.summary(still, strain))
    disparity = _map_to(begun, frame)
    displacement = mechanics.displacement(disparity, begun.method.correction(solution, disparity))
    strain = mechanics.strain_as(displacement, points, settings)
    return FrameResult(displacement, strain, mechanics.summary(displacement, strain, solution.noise_floor_px, correction.sigma, settings))


def _elastic(begun: Begun, solution: Any, summaries: Mapping[int, StrainSummary]) -> Elastic:
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


def _load_steps(begun: Begun, summaries: Mapping[int, StrainSummary]) -> list[tuple[int, float, Measured | None, StrainSummary]]:
    """(pair, mean load in N, mean of the strain gage if there is one, mean strain) of every load step."""
    return [
        (
            one.pair,
            0.5 * (one.loads[0].mean_n + one.loads[1].mean_n) - begun.taken.load_of(one.pair),
            mean_gage(*one.loads),
            mechanics.pooled(summaries[2 * one.pair], summaries[2 * one.pair + 1]),
        )
        for one in _loaded(begun)
        if one.loads is not None
    ]
