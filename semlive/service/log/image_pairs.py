"""Pairs of a log with their images and disparity maps, for row registration and intensity; each image is decoded once."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.disparity import DisparityMap
from semlive.data.frame import ExportedFile, Frame
from semlive.data.pair import PairDecision
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import read_frame
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import SEM_ORIGINAL, SEM_SIDECAR, FileMessage, PairMessage, from_json
from semlive.formats.log.reader import LogMessage
from semlive.service.log.files import messages


@dataclass(frozen=True, slots=True, eq=False)
class ImagedPair:
    """A pair with all its data in the log.

    Attributes:
        decision: decision of the protocol on the pair.
        maps: disparity maps of its frames.
        first: its first frame.
        second: its second frame.
    """

    decision: PairDecision
    maps: tuple[DisparityMap, ...]
    first: Frame
    second: Frame

    @property
    def within(self) -> DisparityMap | None:
        """The map from its first to its second frame."""
        return self.map_of(2 * self.decision.pair, 2 * self.decision.pair + 1)

    def map_of(self, reference: int, current: int) -> DisparityMap | None:
        """Return the map between two frames; None if there is none."""
        return next(
            (disparity_map for disparity_map in self.maps if (disparity_map.reference, disparity_map.current) == (reference, current)), None
        )


@dataclass(slots=True)
class _Files:
    """Exported files of the log, until a pair uses them."""

    announced: FileMessage | None = None
    sidecar: bytes | None = None
    pending: dict[int, ExportedFile] = field(default_factory=dict)

    def note(self, message: LogMessage) -> None:
        """Store a message about a file."""
        if message.topic == SEM_SIDECAR:
            self.sidecar = message.payload
        elif message.topic == "/sem/file":
            announced = from_json(message.topic, message.payload)
            if isinstance(announced, FileMessage) and announced.decision == "arrived":
                self.announced, self.sidecar = announced, None
        elif message.topic == SEM_ORIGINAL:
            announced = self.announced
            if announced is not None and announced.export == message.sequence:
                self.pending[message.sequence] = ExportedFile(
                    message.sequence, announced.name, message.payload, announced.sha256, announced.mtime_ns, announced.arrival_time_ns,
                    self.sidecar, announced.settled_time_ns,
                )  # fmt: skip
            self.announced, self.sidecar = None, None

    def take(self, decision: PairDecision) -> tuple[ExportedFile, ExportedFile] | None:
        """Return both files of a pair and discard earlier files."""
        first, second = decision.first.export, decision.second.export
        files = (self.pending[first], self.pending[second]) if first in self.pending and second in self.pending else None
        self.pending = {number: file for number, file in self.pending.items() if number > second}
        return files


@dataclass(slots=True)
class PairFiles:
    """Exported files of the pairs whose number is a multiple of `every`, until the maps of a pair are complete.

    Attributes:
        settings: analysis settings, for the scan timing.
        every: keep the files of every n-th pair only.
        files: exported files that no pair uses yet.
        pending: files of the pairs whose maps are not complete yet, by number.
    """

    settings: ScanProfile
    every: int = 1
    files: _Files = field(default_factory=_Files)
    pending: dict[int, tuple[ExportedFile, ExportedFile]] = field(default_factory=dict)

    def note(self, message: LogMessage) -> None:
        """Keep what the message of a log contains about files and pairs."""
        self.files.note(message)
        if message.topic == "/pair":
            decision = _decision(message.payload)
            files = self.files.take(decision)
            if files is not None and decision.pair % self.every == 0:
                self.pending[decision.pair] = files

    def imaged_pair(self, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> ImagedPair | None:
        """Decode the frames of a pair with complete maps; None without its files, or if they cannot be read."""
        files = self.pending.pop(decision.pair, None)
        if files is None:
            return None
        try:
            first, second = (read_frame(file, self.settings) for file in files)
        except BadImage:
            return None
        return ImagedPair(decision, maps, first, second)


def frame_of(log: Path, settings: ScanProfile, number: int) -> Frame | None:
    """Return a frame of an accepted pair; None if the log has no such frame or not its image.

    The log is read up to the pair; one file is decoded.

    Args:
        log: one file, or a run folder.
        settings: settings of the scan timing.
        number: number of the frame, 2 * pair + 0 or 1.

    Raises:
        BadLog: the log cannot be read.
        BadImage: the file of the frame cannot be read.
    """
    files = _Files()
    for message in messages(log):
        files.note(message)
        if message.topic == "/pair":
            decision = _decision(message.payload)
            pair_files = files.take(decision)
            if decision.pair == number // 2:
                return None if pair_files is None else read_frame(pair_files[number % 2], settings)
    return None


def _decision(payload: bytes) -> PairDecision:
    message = from_json("/pair", payload)
    assert isinstance(message, PairMessage)  # by its topic
    return values.pair_decision(message)
