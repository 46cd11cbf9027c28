"""Qualification from a folder of frames or a log, one pair in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.experiment import Phase, Step
from semlive.data.frame import Frame
from semlive.data.pair import Pair, PairDecision
from semlive.data.settings import AnalysisSettings, ScanProfile
from semlive.errors import BadInput, IllPosed
from semlive.qualify.assess import assess
from semlive.qualify.evidence import MAX_NOISE_PAIRS, PairMeasurement, conclude, first_settings, measure_pair
from semlive.qualify.pairing import frame_step, pair_frames
from semlive.qualify.values import Qualification
from semlive.service.log.opened_log import OpenedLog
from semlive.service.log.settings import settings_of
from semlive.service.qualification.frames import FolderFrame, list_frames, load_frame
from semlive.service.qualification.log_pairs import is_log, unloaded_count, unloaded_pairs
from semlive.service.runtime.blas import limit_blas_threads

Watch = Callable[[str, int, int], None]
NOT_PAIRED = "the next frame shows another place, or another scan"


@dataclass(frozen=True, slots=True, eq=False)
class QualifyRequest:
    """What to qualify.

    Attributes:
        source: folder of frames, or a log.
        profile: values for metadata that the files lack; a log has its own.
        search_effects: search the maps for effects beyond drift and distortion, which takes the longest.
    """

    source: Path
    profile: ScanProfile = field(default_factory=ScanProfile)
    search_effects: bool = True


@dataclass(frozen=True, slots=True)
class _Input:
    """Pairs of a source.

    Attributes:
        pairs: the pairs, each decoded when it is reached.
        count: expected number of pairs.
        not_paired: frames without a pair, each with the reason; those of a log are known after its pairs were read.
        shifted: whether the steps of the pairs contain commanded shifts, px.
    """

    pairs: Iterator[Pair]
    count: int
    not_paired: Sequence[str]
    shifted: bool


def qualify_source(request: QualifyRequest, watch: Watch | None = None) -> Qualification:
    """Qualify a microscope by the frames of a folder or of a log.

    Args:
        request: what to qualify.
        watch: called with the name of the task, the finished part and the total.

    Raises:
        BadInput: the source cannot be read, or its frames form no pair.
    """
    limit_blas_threads()
    watch = watch or _ignore
    given = _of_log(request.source) if is_log(request.source) else _of_folder(request, watch)
    # Every n-th pair is enough for the noise of other subsets.
    every = max(1, -(-given.count // MAX_NOISE_PAIRS))
    settings, choice, first, state = AnalysisSettings(scan=request.profile), None, None, None
    measured, commands = list[PairMeasurement](), list[tuple[float, float] | None]()
    for number, pair in enumerate(given.pairs):
        if choice is None:
            first = pair.first
            settings, choice = first_settings(first, settings)
        try:
            state, found = measure_pair(settings, state, pair, number % every == 0)
        except IllPosed as error:
            raise BadInput(f"{request.source}: {pair.first.info.name}: {error}") from error
        measured.append(found)
        commands.append(pair.decision.step.shift_px if given.shifted else None)
        watch("pair", number + 1, max(given.count, number + 1))
    assert state is not None  # there is a pair
    assert choice is not None
    assert first is not None
    try:
        evidence = conclude(first, choice, state, measured, search_effects=request.search_effects)
    except IllPosed as error:
        raise BadInput(f"{request.source}: {error}") from error
    return assess(evidence, request.source.resolve().name, given.not_paired, commands)


def _of_log(path: Path) -> _Input:
    log, not_paired = OpenedLog(path), list[str]()
    count, profile = unloaded_count(log), settings_of(log.run).scan
    return _Input(unloaded_pairs(log, profile, not_paired), count, not_paired, True)


def _of_folder(request: QualifyRequest, watch: Watch) -> _Input:
    frames = list_frames(request.source, request.profile)
    indices = _pairs(frames, watch)
    if not indices:
        raise BadInput(
            f"{request.source}: no two consecutive frames show the same place with the same scan; "
            "take two frames one right after the other at each place"
        )
    paired = {at for pair in indices for at in pair}
    names = tuple(f"{frame.path.name}: {NOT_PAIRED}" for at, frame in enumerate(frames) if at not in paired)
    shifted = all(frame.row is not None and frame.row.shift_px is not None for frame in frames)
    return _Input(_loaded(frames, indices), len(indices), names, shifted)


def _ignore(task: str, done: int, total: int) -> None:
    del task, done, total


def _pairs(frames: Sequence[FolderFrame], watch: Watch) -> tuple[tuple[int, int], ...]:
    """Indices of the frames of each pair: by ``frames.csv``, or by the shifts between the frames; two frames alone are a pair."""
    if len(frames) == 2 or all(frame.row is not None for frame in frames):
        return tuple((at, at + 1) for at in range(0, len(frames) - 1, 2))
    steps, before = [], load_frame(frames[0], 0)
    for number, frame in enumerate(frames[1:], 1):
        after = load_frame(frame, number)
        steps.append(frame_step(before, after))
        before = after
        watch("frame", number + 1, len(frames))
    return pair_frames(steps)


def _loaded(frames: Sequence[FolderFrame], indices: Sequence[tuple[int, int]]) -> Iterator[Pair]:
    for number, pair in enumerate(indices):
        first, second = (load_frame(frames[at], 2 * number + member) for member, at in enumerate(pair))
        row = frames[pair[0]].row
        shift = (0.0, 0.0) if row is None or row.shift_px is None else row.shift_px
        yield _pair(number, first, second, shift)


def _pair(number: int, first: Frame, second: Frame, shift_px: tuple[float, float]) -> Pair:
    step = Step(number, Phase.CALIBRATION, (0.0, 0.0), shift_px, None)
    return Pair(PairDecision(number, step, first.info, second.info, None), first, second)
