"""Pairs of a log with their images, without those under load."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from semlive.data.experiment import Phase
from semlive.data.frame import Frame
from semlive.data.pair import Pair, PairDecision
from semlive.data.settings import ScanProfile
from semlive.errors import BadInput
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import PairMessage, RunMessage, from_json
from semlive.formats.log.reader import LogMessage
from semlive.service.config.configuration import parse_config
from semlive.service.log.files import PARTIAL_SUFFIX, SUFFIX
from semlive.service.log.image_pairs import PairFiles
from semlive.service.log.settings import is_imported

NO_IMAGE = "its image, or that of the other frame of its pair, is not in the log, or cannot be read"


def unloaded_pairs(messages: Iterable[LogMessage], path: Path, profile: ScanProfile, not_paired: list[str]) -> Iterator[Pair]:
    """Yield the pairs before the first load, numbered from 0, each decoded when it is reached.

    Times, position and pixel size of a frame are those that the run used.

    Args:
        messages: of the log, finished or growing.
        path: the log.
        profile: scan settings of the log.
        not_paired: receives the frames whose images are not in the log, each with the reason.

    Raises:
        BadInput: the log has no image of a pair without load.
    """
    files, count = PairFiles(profile), 0
    for message in messages:
        files.note(message)
        if message.topic != "/pair":
            continue
        found = from_json(message.topic, message.payload)
        assert isinstance(found, PairMessage)  # by its topic
        decision = values.pair_decision(found)
        if decision.step.phase is Phase.TENSION:
            break
        imaged = files.imaged_pair(decision, ())
        if imaged is None:
            not_paired += [f"{info.name}: {NO_IMAGE}" for info in (decision.first, decision.second)]
            continue
        step = replace(decision.step, step=count, shift_px=_commanded_px(decision))
        first, second = Frame(decision.first, imaged.first.image), Frame(decision.second, imaged.second.image)
        yield Pair(replace(decision, pair=count, step=step, loads=None), first, second)
        count += 1
    if not count and not_paired:
        reason = f"the images of its {len(not_paired) // 2} pairs without load are not in it, or cannot be read"
        raise BadInput(f"{path}: {reason}; give the folder of the exported frames")
    if not count:
        raise BadInput(f"{path}: has no pair without load; give the log of a run that took one, or a folder of frames")


def unloaded_count(run: RunMessage, path: Path) -> int:
    """Number of pairs without load that a run planned.

    Args:
        run: first message of the log.
        path: the log.

    Raises:
        BadInput: the log is an import, which has no frames, or its configuration is not one that this version understands.
    """
    if is_imported(run.config):
        raise BadInput(f"{path}: has maps of another program and no frames; give the folder of the exported frames")
    steps = parse_config(run.config, f"{path}: the run's configuration").plan().steps
    return sum(step.phase is not Phase.TENSION for step in steps)


def _commanded_px(decision: PairDecision) -> tuple[float, float]:
    """Commanded position of the stage in pixels of the file, recentring included; of the plan if the pixel size is unknown."""
    pixel_um, (x_um, y_um) = 1e6 * decision.first.pixel_size_m.value, decision.step.shift_um
    return (x_um / pixel_um, y_um / pixel_um) if pixel_um > 0.0 else decision.step.shift_px


def is_log(path: Path) -> bool:
    """Whether a path is a log: an MCAP file, or a run folder of segments, of which the last may not be finished."""
    return path.name.endswith((SUFFIX, SUFFIX + PARTIAL_SUFFIX)) or (path.is_dir() and any(path.glob(f"*{SUFFIX}*")))
