"""Qualification from a folder of frames or a log, one pair in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from semlive.data.experiment import Phase, Step
from semlive.data.frame import Frame
from semlive.data.pair import Pair, PairDecision
from semlive.data.settings import AnalysisSettings, ScanProfile
from semlive.dic import CorrelationChoice
from semlive.errors import BadInput, IllPosed
from semlive.formats.log.messages import RunMessage, from_json
from semlive.pipeline import AnalysisState
from semlive.qualify.assess import assess
from semlive.qualify.evidence import MAX_NOISE_PAIRS, PairMeasurement, conclude, first_settings, measure_pair
from semlive.qualify.figures.setups import SetupMeasurement, joined, setup_of
from semlive.qualify.needs import Need, needs, remaining_pairs
from semlive.qualify.pairing import frame_step, pair_frames
from semlive.qualify.values import Qualification, ScanSetup
from semlive.service.log.opened_log import OpenedLog
from semlive.service.log.settings import settings_of
from semlive.service.log.tail import follow
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
        further: folders or logs of the further steps of the same qualification.
        profile: values for metadata that the files lack; a log has its own.
        search_effects: search the maps for effects beyond drift and distortion, which takes the longest.
        follow: the source is the log of a run in progress, which need not exist yet; its pairs are read as they are taken.
    """

    source: Path
    profile: ScanProfile = field(default_factory=ScanProfile)
    search_effects: bool = True
    follow: bool = False
    further: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a qualification in progress is.

    Attributes:
        pairs: number of pairs so far.
        planned: number of planned pairs, with the additional ones of the warm-up so far.
        needs: figures that are not known well enough.
        left_s: time until they are, or until the last planned pair, s.
    """

    pairs: int
    planned: int
    needs: tuple[Need, ...]
    left_s: float


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


def qualify_source(request: QualifyRequest, watch: Watch | None = None, report: Callable[[Progress], None] | None = None) -> Qualification:
    """Qualify a microscope by the frames of a folder or of a log.

    Args:
        request: what to qualify.
        watch: called with the name of the task, the finished part and the total.
        report: called after each pair of a log that is followed. The log is read until no figure needs further pairs, or to its end.

    Raises:
        BadInput: the source cannot be read, or its frames form no pair.
    """
    limit_blas_threads()
    watch = watch or _ignore
    setups = [one for part in _parts(request) for one in _measured(part, watch, report)]
    main = max(setups, key=lambda one: len(one.pairs))
    others = [_assessed(one, search_effects=False) for one in setups if one is not main]
    return joined(_assessed(main, search_effects=request.search_effects), others)


def _parts(request: QualifyRequest) -> Iterator[QualifyRequest]:
    """One request for each folder or log."""
    for source in (request.source, *request.further):
        yield replace(request, source=source, further=())


def _measured(request: QualifyRequest, watch: Watch, report: Callable[[Progress], None] | None) -> list[_Measured]:
    """Measurements of one folder or log by setup and size of the frames."""
    given = _of_log(request) if request.follow or is_log(request.source) else _of_folder(request, watch)
    # Every n-th pair is enough for the noise of other subsets.
    every = max(1, -(-given.count // MAX_NOISE_PAIRS))
    setups: list[_Measured] = []
    for number, pair in enumerate(given.pairs):
        measured = next((one for one in setups if one.is_of(pair.first)), None)
        try:
            if measured is None:
                measured = _begin(request, given, pair.first)
                setups.append(measured)
            count = len(measured.pairs)
            measured.state, found = measure_pair(measured.settings, measured.state, _numbered(pair, count), number % every == 0)
        except IllPosed as error:
            raise BadInput(f"{request.source}: {pair.first.info.name}: {error}") from error
        measured.pairs.append(found)
        measured.commands.append(pair.decision.step.shift_px if given.shifted else None)
        watch("pair", number + 1, max(given.count, number + 1))
        if request.follow:
            progress = _progress(_assessed(measured, search_effects=False, in_progress=True).found, measured.pairs, given.count)
            if report is not None:
                report(progress)
            if not progress.needs:
                break
    return setups


@dataclass(slots=True, eq=False)
class _Measured:
    """The pairs of one setup of a folder or log that were measured so far, with the state after the last one."""

    source: Path
    given: _Input
    setup: ScanSetup
    first: Frame
    settings: AnalysisSettings
    choice: CorrelationChoice
    state: AnalysisState | None = None
    pairs: list[PairMeasurement] = field(default_factory=list)
    commands: list[tuple[float, float] | None] = field(default_factory=list)

    def is_of(self, frame: Frame) -> bool:
        """Whether a frame has this setup and size."""
        return self.setup.is_same(setup_of(frame.info)) and self.first.image.shape == frame.image.shape

    def intervals_s(self) -> tuple[float, ...]:
        """From the start of the first frame of each pair to that of the second, s."""
        decisions = [pair.decision for pair in self.pairs]
        return tuple(1e-9 * (each.second.start_time_ns.value - each.first.start_time_ns.value) for each in decisions)


def _begin(request: QualifyRequest, given: _Input, first: Frame) -> _Measured:
    return _Measured(request.source, given, setup_of(first.info), first, *first_settings(first, AnalysisSettings(scan=request.profile)))


def _numbered(pair: Pair, number: int) -> Pair:
    """A pair with its number within its setup, from which its frames have their numbers."""
    decision = pair.decision
    return (
        pair
        if decision.pair == number
        else replace(pair, decision=replace(decision, pair=number, step=replace(decision.step, step=number)))
    )


def _assessed(measured: _Measured, *, search_effects: bool, in_progress: bool = False) -> SetupMeasurement:
    assert measured.state is not None  # after a pair
    try:
        evidence = conclude(
            measured.first, measured.choice, measured.state, measured.pairs, search_effects=search_effects, in_progress=in_progress
        )
    except IllPosed as error:
        raise BadInput(f"{measured.source}: {error}") from error
    found = assess(evidence, measured.source.resolve().name, measured.given.not_paired, measured.commands)
    return SetupMeasurement(measured.setup, measured.commands, evidence.estimate.motions, found, measured.intervals_s())


def _progress(found: Qualification, measured: Sequence[PairMeasurement], planned: int) -> Progress:
    found_needs = needs(found)
    begins_ns = [pair.decision.first.start_time_ns.value for pair in measured]
    last = measured[-1].decision
    pair_ns = (begins_ns[-1] - begins_ns[0]) / (len(begins_ns) - 1) if len(begins_ns) > 1 else last.second.end_time_ns - begins_ns[0]
    planned += sum(pair.decision.step.warm_up for pair in measured)
    return Progress(len(measured), planned, found_needs, 1e-9 * pair_ns * remaining_pairs(found_needs, max(planned - len(measured), 0)))


def _of_log(request: QualifyRequest) -> _Input:
    not_paired, path = list[str](), request.source
    if request.follow:
        if path.is_dir() and any(path.iterdir()) and not is_log(path):
            raise BadInput(f"{path}: is not the folder of a log; give the folder that the run in progress writes")
        messages = follow(path)
        begin = next((message for message in messages if message.topic == "/run"), None)
        if begin is None:
            raise BadInput(f"{path}: has no configuration of a run; give the log of a run")
        run = from_json(begin.topic, begin.payload)
        assert isinstance(run, RunMessage)  # by its topic
    else:
        log = OpenedLog(path)
        run, messages = log.run, log.messages()
    pairs = unloaded_pairs(messages, path, settings_of(run).scan, not_paired)
    return _Input(pairs, unloaded_count(run, path), not_paired, True)


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
