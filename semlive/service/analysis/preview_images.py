"""Pictures for whoever opens the log: made of what analysis says, after it was said."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from semlive.data.pair import Pair
from semlive.formats.log import conversions as values
from semlive.formats.log.foxglove import FIELD_IMAGE_TOPICS, SEM_IMAGE, compressed_image, raw_image
from semlive.formats.log.maps import decode_map, decode_strain
from semlive.formats.log.messages import DIC_MAP, STRAIN_FIELD, DistortionMessage, from_json
from semlive.formats.log.writer import LogMessage


def preview_images(pair: Pair, outputs: Iterable[LogMessage]) -> Iterator[LogMessage]:
    """Pictures of a pair and of what was made of it, one by one: none is worked out before it is asked for.

    Args:
        pair: with its frames.
        outputs: what analysis said of it. Frames of earlier pairs that were corrected anew are not shown again.

    Raises:
        BadLog: an output is not what its topic promises.
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
        told = from_json(output.topic, output.payload)
        if not isinstance(told, DistortionMessage):
            return
        distortion = values.distortion_field(told)
        of, name, fields, valid, number = "/distortion/image", "", (distortion.ex_px, distortion.ey_px), distortion.valid, told.revision
    else:
        return
    for component, field in zip(FIELD_IMAGE_TOPICS[of], fields, strict=True):
        frame_id = f"frame {number} {name}".strip() if of != "/distortion/image" else f"revision {number}"
        yield LogMessage(f"{of}/{component}", time_ns, time_ns, number, raw_image(field, valid, time_ns, frame_id))
