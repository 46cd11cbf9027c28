"""Pairs of a log with their images and the maps that were made of them: what rows and grey levels are read from, each image once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.disparity import DisparityMap
from semlive.data.frame import ExportedFile, Frame
from semlive.data.pair import PairDecision
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import read_frame
from semlive.formats.log import conversions as values
from semlive.formats.log.maps import decode_map
from semlive.formats.log.messages import DIC_MAP, SEM_ORIGINAL, SEM_SIDECAR, FileMessage, PairMessage, from_json
from semlive.formats.log.writer import LogMessage
from semlive.service.log.files import messages


@dataclass(frozen=True, slots=True, eq=False)
class ImagedPair:
    """A pair with all that the log holds of it.

    Attributes:
        decision: on it.
        maps: that were made of its frames.
        first: its first frame.
        second: its second frame.
    """

    decision: PairDecision
    maps: tuple[DisparityMap, ...]
    first: Frame
    second: Frame

    @property
    def within(self) -> DisparityMap | None:
        """From its first to its second frame."""
        return self.map_of(2 * self.decision.pair, 2 * self.decision.pair + 1)

    def map_of(self, reference: int, current: int) -> DisparityMap | None:
        """From one frame to another."""
        return next((one for one in self.maps if (one.reference, one.current) == (reference, current)), None)


def imaged_pairs(log: Path, settings: ScanProfile, every: int = 1) -> Iterator[ImagedPair]:
    """Pairs in their order, those whose number is a multiple of `every`; only their frames are decoded.

    Args:
        log: one file, or a run folder.
        settings: how scan timing is told.
        every: of so many pairs one.

    Raises:
        BadLog: the log cannot be read.
    """
    files = _Files()
    waiting: dict[int, tuple[PairDecision, ExportedFile, ExportedFile]] = {}
    maps: list[DisparityMap] = []
    for message in messages(log):
        files.note(message)
        if message.topic == "/pair":
            decision = _decision(message.payload)
            both = files.taken(decision)
            if both is not None and decision.pair % every == 0:
                waiting[decision.pair] = (decision, *both)
        elif message.topic == DIC_MAP and waiting:
            one = decode_map(message.payload)
            if maps and one.current // 2 != maps[0].current // 2:
                yield from _whole(waiting, maps, settings)
                maps = []
            if one.current // 2 in waiting:
                maps.append(one)
    yield from _whole(waiting, maps, settings)


def _whole(
    waiting: dict[int, tuple[PairDecision, ExportedFile, ExportedFile]], maps: list[DisparityMap], settings: ScanProfile
) -> Iterator[ImagedPair]:
    """The pair that the maps are of, if its images can be read."""
    if maps:
        decision, *both = waiting.pop(maps[0].current // 2)
        try:
            first, second = (read_frame(one, settings) for one in both)
        except BadImage:
            return
        yield ImagedPair(decision, tuple(maps), first, second)


@dataclass(slots=True)
class _Files:
    """Exported files as they come along, until a pair asks for them."""

    announced: FileMessage | None = None
    sidecar: bytes | None = None
    held: dict[int, ExportedFile] = field(default_factory=dict)

    def note(self, message: LogMessage) -> None:
        """A message about a file."""
        if message.topic == SEM_SIDECAR:
            self.sidecar = message.payload
        elif message.topic == "/sem/file":
            told = from_json(message.topic, message.payload)
            if isinstance(told, FileMessage) and told.decision == "arrived":
                self.announced, self.sidecar = told, None
        elif message.topic == SEM_ORIGINAL:
            told = self.announced
            if told is not None and told.export == message.sequence:
                self.held[message.sequence] = ExportedFile(
                    message.sequence, told.name, message.payload, told.sha256, told.mtime_ns, told.arrival_time_ns, self.sidecar,
                    told.settled_time_ns,
                )  # fmt: skip
            self.announced, self.sidecar = None, None

    def taken(self, decision: PairDecision) -> tuple[ExportedFile, ExportedFile] | None:
        """Both files of a pair; what came before them is forgotten."""
        first, second = decision.first.export, decision.second.export
        found = (self.held[first], self.held[second]) if first in self.held and second in self.held else None
        self.held = {number: one for number, one in self.held.items() if number > second}
        return found


def _decision(payload: bytes) -> PairDecision:
    told = from_json("/pair", payload)
    assert isinstance(told, PairMessage)  # by its topic
    return values.pair_decision(told)
