"""Pairs of a log with their images, without those under load."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from semlive.data.experiment import Phase
from semlive.data.pair import Pair, PairDecision
from semlive.data.settings import ScanProfile
from semlive.errors import BadInput
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import PairMessage, from_json
from semlive.service.log.image_pairs import PairFiles
from semlive.service.log.opened_log import OpenedLog


def unloaded_pairs(log: OpenedLog, profile: ScanProfile) -> Iterator[Pair]:
    """Yield the pairs before the first load, numbered from 0, each decoded when it is reached.

    Args:
        log: a log whose messages were not read yet.
        profile: scan settings of the log.

    Raises:
        BadInput: the log has no images.
    """
    files, count = PairFiles(profile), 0
    for message in log.messages():
        files.note(message)
        if message.topic != "/pair":
            continue
        found = from_json(message.topic, message.payload)
        assert isinstance(found, PairMessage)  # by its topic
        decision = values.pair_decision(found)
        if decision.step.phase is Phase.TENSION:
            break
        imaged = files.imaged_pair(decision, ())
        if imaged is not None:
            step = replace(decision.step, step=count, shift_px=_commanded_px(decision))
            yield Pair(replace(decision, pair=count, step=step, loads=None), imaged.first, imaged.second)
            count += 1
    if not count:
        raise BadInput(f"{log.path}: has no images of pairs without load; give a log that a run wrote, or a folder of frames")


def _commanded_px(decision: PairDecision) -> tuple[float, float]:
    """Commanded position of the stage in pixels of the file, recentring included; of the plan if the pixel size is unknown."""
    pixel_um, (x_um, y_um) = 1e6 * decision.first.pixel_size_m.value, decision.step.shift_um
    return (x_um / pixel_um, y_um / pixel_um) if pixel_um > 0.0 else decision.step.shift_px


def is_log(path: Path) -> bool:
    """Whether a path is a log: an MCAP file, or a run folder of segments."""
    return path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap")))
