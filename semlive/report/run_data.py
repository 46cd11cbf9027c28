"""What a report of a run is made from: the result of a replay, with the facts, loads and the image of its log.

Bounds: frames are corrected when a figure needs them, at most four for the maps, two for the residual of a pair and 24 for the mean
residual; one image is decoded; checksums of log files are computed up to 4 GB.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from semlive import pipeline
from semlive.data.experiment import Phase
from semlive.data.frame import FrameInfo
from semlive.data.loading import LoadSeries
from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadImage, BadInput
from semlive.report.maps import Background, ImageScale, background_of
from semlive.report.paper_figures import spread
from semlive.service.log.files import log_name, segments
from semlive.service.log.image_pairs import frame_of
from semlive.service.log.pairs import load_series
from semlive.service.log.run_facts import LogFacts, log_facts
from semlive.service.replay.replay import ReplayResult

MAX_MAP_FRAMES = 4
"""Largest number of frames whose maps are drawn."""
MAX_HASHED_BYTES = 4_000_000_000
"""Size of a log up to which its checksums are computed."""


@dataclass(frozen=True, slots=True)
class LogFile:
    """A file of the log.

    Attributes:
        name: file name.
        size: bytes.
        sha256: checksum, hexadecimal; empty if the log is larger than `MAX_HASHED_BYTES`.
    """

    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True, eq=False)
class RunData:
    """Data of a report.

    Attributes:
        name: name of the run.
        result: every frame corrected with the newest estimate; its `frames` are not used.
        settings: settings of the analysis.
        frame: gives a corrected frame by its number.
        chosen: numbers of the frames whose maps are drawn.
        series: load as sampled, None without a load frame.
        facts: further facts of the log.
        background: image of frame 0, None if the log has none.
        files: files of the log.
    """

    name: str
    result: RunResult
    settings: AnalysisSettings
    frame: Callable[[int], FrameResult]
    chosen: tuple[int, ...]
    series: LoadSeries | None = None
    facts: LogFacts = field(default_factory=LogFacts)
    background: Background | None = None
    files: tuple[LogFile, ...] = ()

    @property
    def first(self) -> FrameInfo:
        """Metadata of frame 0."""
        return self.result.decisions[0].first

    @property
    def scale(self) -> ImageScale:
        """Unit of lengths on the specimen."""
        size_m = self.first.pixel_size_m.value
        return ImageScale(1e6 * size_m if size_m > 0 else None)

    def load_n(self, frame: int) -> float | None:
        """Mean load during a frame; None without a load frame."""
        decision = next(decision for decision in self.result.decisions if decision.pair == frame // 2)
        return decision.loads[frame % 2].mean_n if decision.loads else None

    def condition(self, frame: int) -> str:
        """Number of a frame with its stress, or its load, or its phase."""
        load_n, area_mm2 = self.load_n(frame), self.settings.specimen.area_mm2
        if load_n is None:
            phase = next(decision.step.phase for decision in self.result.decisions if decision.pair == frame // 2)
            return f"frame {frame}, {phase.value}"
        return f"frame {frame}, {load_n:.0f} N" if area_mm2 is None else f"frame {frame}, {load_n / area_mm2:.1f} MPa"


def run_data(log: Path, done: ReplayResult, frames: Sequence[int] = ()) -> RunData:
    """Collect the data of a report.

    Args:
        log: one file, or a run folder.
        done: its replay.
        frames: numbers of the frames whose maps are drawn; empty chooses up to `MAX_MAP_FRAMES` load steps.

    Raises:
        BadInput: the log cannot be read, there is no such frame, or there are too many.
    """
    return RunData(
        log_name(log),
        done.result,
        done.settings,
        lambda number: pipeline.correct_frame(done.analysis, done.solution, number),
        chosen_frames(done.result, frames),
        load_series(log),
        log_facts(log),
        _background(log, done.settings),
        log_files(log),
    )


def chosen_frames(result: RunResult, requested: Sequence[int] = ()) -> tuple[int, ...]:
    """Frames whose maps are drawn: the requested ones, or the second frame of load steps that are spread evenly over the run.

    Without load steps these are pairs of the calibration. Frame 0 has no displacement and no strain and is never chosen by itself.

    Raises:
        BadInput: there is no such frame, or there are more than `MAX_MAP_FRAMES`.
    """
    numbers = {summary.frame for summary in result.summaries}
    if requested:
        unknown = [number for number in requested if number not in numbers]
        if unknown or len(requested) > MAX_MAP_FRAMES:
            raise BadInput(f"--maps: give at most {MAX_MAP_FRAMES} numbers of frames between {min(numbers)} and {max(numbers)}")
        return tuple(requested)
    loaded = [decision.pair for decision in result.decisions if decision.step.phase is Phase.TENSION]
    pairs = loaded or [decision.pair for decision in result.decisions]
    return tuple(spread([2 * pair + 1 for pair in pairs if 2 * pair + 1 in numbers], MAX_MAP_FRAMES))


def log_files(log: Path) -> tuple[LogFile, ...]:
    """Files of a log with their checksums, which are omitted above `MAX_HASHED_BYTES`.

    Raises:
        BadInput: the log cannot be read.
    """
    try:
        paths = segments(log)
        sizes = [path.stat().st_size for path in paths]
        hashed = sum(sizes) <= MAX_HASHED_BYTES
        return tuple(LogFile(path.name, size, _sha256(path) if hashed else "") for path, size in zip(paths, sizes, strict=True))
    except OSError as error:
        raise BadInput(f"{log}: cannot be read ({error.strerror or error}).") from error


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _background(log: Path, settings: AnalysisSettings) -> Background | None:
    try:
        frame = frame_of(log, settings.scan, 0)
    except BadImage:
        return None
    return None if frame is None else background_of(frame.image)
