"""The runs that qualify a microscope without a load frame: pairs in place until the drift has settled, a cross, then further steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from semlive.engine.schedule import TimingAssumptions, schedule
from semlive.errors import BadImage
from semlive.formats import read_info
from semlive.qualify.figures.drift import MIN_PAIRS_DECAY
from semlive.qualify.further import CROSS, FurtherStep, StepName, further_step
from semlive.qualify.protocol import STEPS
from semlive.service.config.configuration import Config, parse_config
from semlive.service.qualification.frames import exported
from semlive.service.qualification.instrument import Sections, instrument_of, operator_stage, run_text
from semlive.service.watch.sidecars import IMAGE_SUFFIXES

USUAL_SHIFT_PX = 24.0
"""Largest shift without calibration shifts in the configuration: 3 % of a frame of 884 rows, rounded to the cross of the paper."""
MAX_BEAM_S = 1800.0
"""Beam time of the first run that the number of its pairs is chosen for, s."""
SETTLED_PX = 0.02
"""Change of the drift in a frame from pair to pair below which it has settled, px: the decaying part is then about 0.1 px in a frame, as at
the end of the stated waiting time, if it decays within five pairs.
"""
SHORTEST = (*CROSS, (0, 0))
"""Shifts of the shortest run, in halves of the largest. It does not determine the backlash of the stage."""
_SCAN_TIMES = ("row_time_s", "dwell_time_s", "frame_time_s")


@dataclass(frozen=True, slots=True)
class WrittenPlan:
    """A qualifying run.

    Attributes:
        text: configuration, YAML.
        pairs: number of its pairs.
        beam_s: expected beam time of these pairs, s; None if the duration of a frame is not known before the first one.
        warm_up_s: longest time of additional pairs in place until the drift has settled, s; 0 without.
        change: what is set at the microscope before the run, an imperative; empty if nothing is.
    """

    text: str
    pairs: int
    beam_s: float | None
    warm_up_s: float
    change: str

    def duration_text(self) -> str:
        """Pairs and beam time for the operator."""
        time = "" if self.beam_s is None else f", about {self.beam_s / 60.0:.0f} min of beam time"
        warm_up = f", and further pairs for up to {self.warm_up_s / 60.0:.0f} min until the drift has settled" if self.warm_up_s else ""
        return f"{self.pairs} pairs{time}{warm_up}"


def plan_of(path: Path, name: StepName | None = None) -> WrittenPlan:
    """The qualifying run for an instrument.

    Devices, export folder and correlation are those of the instrument's configuration. The shifts are as large as those of the
    configuration's own calibration. Without a stage in the configuration an operator moves the specimen. The first run has pairs in place
    until the drift has settled, and a cross of shifts; fewer pairs, if frames are so slow that it would take more than half an hour. If the
    duration of a frame is not known, a fixed number of pairs in place shows the decay of the drift.

    Args:
        path: configuration of the instrument, or the log of its first run.
        name: a further step; None for the first run.

    Raises:
        BadConfig: the configuration is invalid.
    """
    instrument = instrument_of(path, "qualify" if name is None else name.value)
    frame_s, half_px = _frame_s(instrument.config), 0.5 * _largest_px(instrument.config)
    sections: Sections = {"stage": operator_stage(instrument.config.sem.pixel_size_um), **instrument.sections}
    step = None if name is None else further_step(name, frame_s or 0.0)
    scan_s = frame_s if frame_s is None or step is None else step.time_factor * frame_s
    sections = sections if step is None else _changed(sections, step)
    shifts: Sequence[tuple[int, int]] = ()
    beam_s: float | None = None
    for shifts in _first_runs(scan_s) if step is None else [step.shifts]:  # the first that is short enough, else the last
        sections["protocol"] = {**sections["protocol"], "calibration_shifts_px": [[half_px * x, half_px * y] for x, y in shifts]}
        beam_s = None if scan_s is None else _beam_s(parse_config(sections, str(path)), scan_s)
        if beam_s is None or beam_s <= MAX_BEAM_S:
            break
    warm_up_s = 0.0
    if step is None and beam_s is not None and scan_s is not None and MAX_BEAM_S - beam_s > beam_s / len(shifts):
        warm_up_s = MAX_BEAM_S - beam_s
        # A pair that begins within the waiting time ends after it.
        sections = _warming_up(sections, scan_s, warm_up_s - beam_s / len(shifts))
    text = run_text(_head(step), sections, instrument.confirmed, str(path))
    return WrittenPlan(text, len(shifts), beam_s, warm_up_s, "" if step is None else step.change)


def _warming_up(sections: Sections, scan_s: float, longest_s: float) -> Sections:
    """Sections with additional pairs after the first one until the drift has settled. Only the joint estimate forecasts the drift."""
    rule = {
        "max_change_px_s": _rounded(SETTLED_PX / scan_s),
        "max_wait_s": max(round(longest_s), 1),
        "after_wait": "continue",
        "before": "calibration",
    }
    protocol, estimate = {**sections["protocol"], "warm_up": rule}, {**sections.get("estimate", {}), "method": "joint"}
    return {**sections, "protocol": protocol, "estimate": estimate}


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _head(step: FurtherStep | None) -> str:
    if step is None:
        return "# Run that qualifies the microscope; evaluate it with `semlive qualify --from LOG`.\n"
    return f"# Before this run: {step.change}. Evaluate it with that of the first run:\n# `semlive qualify --from LOG --from THIS_LOG`.\n"


def _first_runs(scan_s: float | None) -> list[Sequence[tuple[int, int]]]:
    """Shifts of the first run in halves of the largest, with all pairs first, then with fewer.

    The pair in place before the cross is the one that the warm-up pairs are compared with.
    """
    if scan_s is None:
        return [(*((0, 0),) * MIN_PAIRS_DECAY, *STEPS)]
    return [((0, 0), *STEPS), STEPS, (*CROSS, (1, 0), (0, 1), (0, 0)), SHORTEST]


def _changed(sections: Sections, step: FurtherStep) -> Sections:
    """Sections for a step with another scan. Region and mask are those of another field; times that files lack are those of the step."""
    sem = dict(sections["sem"])
    sem["pixel_size_um"] = step.pixel_factor * float(str(sem["pixel_size_um"]))
    times = ("frame_time_s",) if step.name is StepName.ROWS else _SCAN_TIMES
    if "profile" in sem:
        sem["profile"] = _scaled(sem["profile"], {"pixel_size_m": step.pixel_factor, **dict.fromkeys(times, step.time_factor)})
    stage = dict(sections["stage"])
    if "settings" in stage:
        stage["settings"] = _scaled(stage["settings"], {"um_per_px": step.pixel_factor})
    correlation = {**sections.get("dic", {}), "roi_px": None, "mask": None}
    return {**sections, "sem": sem, "stage": stage, "dic": correlation}


def _scaled(given: object, factors: Mapping[str, float]) -> dict[str, object]:
    """A section in which some values are multiplied."""
    section = cast(Mapping[str, object], given)
    return {key: factors[key] * float(str(value)) if key in factors and value is not None else value for key, value in section.items()}


def _beam_s(config: Config, scan_s: float) -> float:
    """Expected beam time of a run, s."""
    return schedule(config.plan(), TimingAssumptions(scan_s, config.sem.stable_for_s + config.sem.poll_s)).duration_s


def _frame_s(config: Config) -> float | None:
    """Duration of a frame, s: that of the newest image in the export folder, else of the scan profile; None without both."""
    folder = config.sem.folder
    images = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES] if folder.is_dir() else []
    try:
        newest = max(images, key=lambda path: path.stat().st_mtime_ns, default=None)
        if newest is not None:
            return read_info(exported(newest, 0), config.sem.scan_profile).timing.duration_s
    except (BadImage, OSError):  # another file of the folder, or a scan without times
        pass
    return config.sem.profile.frame_time_s


def _largest_px(config: Config) -> float:
    """Largest calibration shift of a configuration along one axis, px."""
    return max((abs(value) for shift in config.protocol.calibration_shifts_px for value in shift), default=0.0) or USUAL_SHIFT_PX
