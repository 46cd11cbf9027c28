"""From images to disparity maps: within a pair, and from frame 0 to its frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.frame import Frame
from semlive.data.notes import Note, NoteCode, warning
from semlive.data.pair import Pair
from semlive.data.settings import DicSettings
from semlive.errors import IllPosed
from semlive.pipeline.state import NO_PRECORRELATION, NOT_PRECORRELATED, AnalysisState, PrecorrelatedFrame


def precorrelate(state: AnalysisState, frame: Frame, *, first: bool) -> PrecorrelatedFrame:
    """Correlate a frame of the next pair before the pair is complete.

    Integrated scans are excluded: their blur by drift is known from the complete pair only.

    Args:
        state: of the run.
        frame: of the next pair.
        first: whether it may be the pair's first frame, the reference of the second.
    """
    settings, from_frame_0 = state.settings.dic, None
    if state.reference is not None and frame.info.timing.integrations.value < 2:
        from_frame_0 = dic.correlate(state.reference, frame.image, settings, reference_frame=0, current_frame=frame.info.export)
    return PrecorrelatedFrame(_prepared(state, frame) if first else None, from_frame_0)


def correlate(
    state: AnalysisState, pair: Pair, precorrelated: Mapping[int, PrecorrelatedFrame] = NO_PRECORRELATION
) -> tuple[DisparityMap, ...]:
    """Disparity within the pair, and from frame 0 to each of its frames other than frame 0.

    Args:
        state: of the run; without pairs, the pair's first frame is frame 0.
        pair: the next pair.
        precorrelated: results of `precorrelate` by number of export; the maps are the same without them.

    Raises:
        IllPosed: the run has no reference image, or no point of the pair was found; the message states the cause.
    """
    maps = _correlate(state, pair, precorrelated)
    if not any(disparity.valid.any() for disparity in maps):
        mask = frame_mask(state.settings.dic, state.reference, pair.first)
        reason = dic.explain_no_points(pair.first.image, pair.second.image, maps[0], state.settings.dic, mask=mask)
        raise IllPosed(f"no point of pair {pair.decision.pair} was correlated, so it has no information: {reason}")
    return maps


def frame_mask(settings: DicSettings, reference: dic.Reference | None, frame: Frame) -> NDArray[np.bool_] | None:
    """The mask of the settings at the place of the specimen in a frame; None without a mask.

    Args:
        settings: of the correlation.
        reference: frame 0, prepared; None before it, or if the frame is frame 0: the mask stays.
        frame: frame of the run.

    Raises:
        BadInput: the mask has another size than the frame.
    """
    height, width = frame.image.shape
    mask = dic.mask_of(settings, (height, width))
    return mask if mask is None or reference is None else dic.moved_mask(mask, reference, frame.image)


def _prepared(state: AnalysisState, frame: Frame) -> dic.Reference:
    """A frame of the run as reference of the next one."""
    return dic.prepare(frame.image, state.grid, state.settings.dic, frame_mask(state.settings.dic, state.reference, frame))


def _correlate(state: AnalysisState, pair: Pair, precorrelated: Mapping[int, PrecorrelatedFrame]) -> tuple[DisparityMap, ...]:
    settings, reference, k = state.settings.dic, state.reference, pair.decision.pair
    if reference is None:
        raise IllPosed("this run was begun from disparity maps, without the pixels of frame 0; correlate with the images' own log")
    if not state.pairs:
        return (dic.correlate(reference, pair.second.image, settings, reference_frame=0, current_frame=1),)
    first, second = (precorrelated.get(frame.info.export, NOT_PRECORRELATED) for frame in (pair.first, pair.second))
    own = first.prepared_reference or _prepared(state, pair.first)
    within = dic.correlate(own, pair.second.image, settings, reference_frame=2 * k, current_frame=2 * k + 1)
    as_measured = state.raw_maps[0][0] if state.raw_maps else state.maps_from_reference[0]
    blur = dic.missing_blur(dic.blur_of_pair(state.pairs[0], as_measured), dic.blur_of_pair(pair.decision, within))

    def from_frame_0(frame: Frame, given: PrecorrelatedFrame, number: int) -> DisparityMap:
        if blur is None and given.from_frame_0 is not None:
            return replace(given.from_frame_0, current=number)
        return dic.correlate_with_matched_blur(reference, frame.image, settings, blur, reference_frame=0, current_frame=number)

    return within, from_frame_0(pair.first, first, 2 * k), from_frame_0(pair.second, second, 2 * k + 1)


def correlation_notes(maps: tuple[DisparityMap, ...], settings: DicSettings) -> tuple[Note, ...]:
    """A warning if the method ``auto`` measured a map with the global method."""
    chosen = [disparity for disparity in maps if disparity.method == "global"]
    if settings.method != "auto" or not chosen:
        return ()
    shares = [disparity.neighbour_share[disparity.valid] for disparity in chosen if disparity.neighbour_share is not None]
    values = np.concatenate(shares)
    share = float(np.median(values)) if len(values) else 1.0
    text = (
        "subsets measure too few points of this texture, so the global method with a smooth field measures the maps; "
        f"neighbours and smoothness determine {100.0 * share:.0f} % of a value (median); use a finer pattern, "
        "or set dic.method to subset to refuse such points"
    )
    return (warning(NoteCode.GLOBAL_CORRELATION, text),)


def maps_from_reference(pair: int, maps: tuple[DisparityMap, ...]) -> tuple[DisparityMap, ...]:
    """The maps from frame 0 among a pair's maps.

    Another engine may have made no map from frame 0 to the second frame. The maps to the first frame and within the
    pair are then composed.
    """
    found = tuple(disparity for disparity in maps if disparity.reference == 0)
    within = next((disparity for disparity in maps if disparity.reference == 2 * pair), None)
    first = next((disparity for disparity in found if disparity.current == 2 * pair), None)
    if first is None or within is None or any(disparity.current == 2 * pair + 1 for disparity in found):
        return found
    return (*found, dic.compose_maps(first, within))


def complete_maps(pair: int, maps: tuple[DisparityMap, ...]) -> tuple[DisparityMap, ...]:
    """The map within a pair, if frame 0 is not in it, and those from frame 0 to its frames."""
    return (*(disparity for disparity in maps if disparity.reference != 0), *maps_from_reference(pair, maps))
