"""Preview images in the log, made from the results of a pair after its other outputs were written."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from semlive.data.pair import Pair
from semlive.data.results import PairResult
from semlive.formats.log.foxglove import FIELD_IMAGE_TOPICS, SEM_IMAGE, compressed_image, raw_image
from semlive.formats.log.reader import LogMessage

Fields = tuple[NDArray[np.float64], ...]


def preview_images(pair: Pair, result: PairResult | None) -> Iterator[LogMessage]:
    """Yield the preview images of a pair and of its results, each computed on demand.

    Args:
        pair: the pair with its frames.
        result: results of the pair; None if it could not be analysed. Corrected frames of earlier pairs are not shown again.
    """
    numbers = (2 * pair.decision.pair, 2 * pair.decision.pair + 1)
    if result is not None:
        yield from _result_images(result, numbers)
    for number, frame in zip(numbers, (pair.first, pair.second), strict=True):
        info = frame.info
        payload = compressed_image(frame.image, info.end_time_ns, f"frame {number}")
        yield LogMessage(SEM_IMAGE, info.end_time_ns, info.end_time_ns, info.export, payload)


def _result_images(result: PairResult, numbers: tuple[int, int]) -> Iterator[LogMessage]:
    """Yield the images of disparity, distortion and strain; a distortion has the number of its revision, a frame its own."""
    time_ns = result.decision.second.end_time_ns
    for disparity in result.maps:
        topic = "/dic/image" if disparity.reference == 0 and disparity.current != 1 else "/dic/pair_image"
        title = f"frame {disparity.current} from frame {disparity.reference}"
        yield from _images(topic, title, disparity.current, (disparity.u_px, disparity.v_px), disparity.valid, time_ns)
    distortion, revision = result.estimate.distortion, result.estimate.drift.revision
    fields = (distortion.ex_px, distortion.ey_px)
    yield from _images("/distortion/image", f"revision {revision}", revision, fields, distortion.valid, time_ns)
    for frame in (*result.frames, *result.revised_frames):
        strain = frame.strain
        if strain.frame in numbers:
            components = (strain.exx, strain.eyy, strain.exy)
            yield from _images("/strain/image", f"frame {strain.frame}", strain.frame, components, strain.valid, time_ns)


def _images(topic: str, title: str, number: int, fields: Fields, valid: NDArray[np.bool_], time_ns: int) -> Iterator[LogMessage]:
    for component, field in zip(FIELD_IMAGE_TOPICS[topic], fields, strict=True):
        yield LogMessage(f"{topic}/{component}", time_ns, time_ns, number, raw_image(field, valid, time_ns, title))
