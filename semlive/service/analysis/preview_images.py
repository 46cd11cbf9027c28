"""Preview images in the log, made from the outputs of the analysis after they were written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from semlive.data.pair import Pair
from semlive.formats.log import conversions as values
from semlive.formats.log.foxglove import FIELD_IMAGE_TOPICS, SEM_IMAGE, compressed_image, raw_image
from semlive.formats.log.maps import decode_map, decode_strain
from semlive.formats.log.messages import DIC_MAP, STRAIN_FIELD, DistortionMessage, from_json
from semlive.formats.log.reader import LogMessage


def preview_images(pair: Pair, outputs: Iterable[LogMessage]) -> Iterator[LogMessage]:
    """Yield the preview images of a pair and of its results, each computed on demand.

    Args:
        pair: the pair with its frames.
        outputs: outputs of the analysis for the pair. Frames of earlier pairs that were corrected again are not shown again.

    Raises:
        BadLog: an output does not agree with its topic.
    """
    numbers = (2 * pair.decision.pair, 2 * pair.decision.pair + 1)
    for output in outputs:
        yield from _of_output(output, numbers)
    for number, frame in zip(numbers, (pair.first, pair.second), strict=True):
        info = frame.info
        payload = compressed_image(frame.image, info.end_time_ns, f"frame {number}")
        yield LogMessage(SEM_IMAGE, info.end_time_ns, info.end_time_ns, info.export, payload)


def _of_output(output: LogMessage, numbers: tuple[int, ...]) -> Iterator[LogMessage]:
    time_ns = output.publish_time_ns
    if output.topic == DIC_MAP:
        disparity = decode_map(output.payload)
        of = "/dic/image" if disparity.reference == 0 and disparity.current != 1 else "/dic/pair_image"
        name, fields, valid, number = (
            f"from frame {disparity.reference}",
            (disparity.u_px, disparity.v_px),
            disparity.valid,
            disparity.current,
        )
    elif output.topic == STRAIN_FIELD and output.sequence in numbers:
        strain = decode_strain(output.payload)
        of, name, fields, valid, number = "/strain/image", "", (strain.exx, strain.eyy, strain.exy), strain.valid, strain.frame
    elif output.topic == "/distortion/estimate":
        message = from_json(output.topic, output.payload)
        if not isinstance(message, DistortionMessage):
            return
        distortion = values.distortion_field(message)
        of, name, fields, valid, number = "/distortion/image", "", (distortion.ex_px, distortion.ey_px), distortion.valid, message.revision
    else:
        return
    for component, field in zip(FIELD_IMAGE_TOPICS[of], fields, strict=True):
        frame_id = f"frame {number} {name}".strip() if of != "/distortion/image" else f"revision {number}"
        yield LogMessage(f"{of}/{component}", time_ns, time_ns, number, raw_image(field, valid, time_ns, frame_id))
