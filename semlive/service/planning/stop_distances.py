"""Largest load before each stop, for the most demanding ramp of a configuration; no device is opened."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode
from semlive.engine.supervision.stop_distance import ANSWER_S, EXCESS, RampCase, StopDistance, exceeds, noticeable_n, stop_distances, worst
from semlive.service.config.configuration import Config

_BY_HAND = ("operator", "null")
"""Drivers of load frames that semlive does not move."""


@dataclass(frozen=True, slots=True)
class StopPlan:
    """The stops of one ramp.

    Attributes:
        case: ramp to the largest load, and properties of device and link.
        rows: largest load of each fault.
    """

    case: RampCase
    rows: tuple[StopDistance, ...]

    @property
    def worst(self) -> StopDistance | None:
        """The row with the largest true load."""
        return worst(self.rows, self.case)

    @property
    def exceeding(self) -> tuple[StopDistance, ...]:
        """Rows beyond the force limit by more than 5 %, the largest load first."""
        case = self.case
        far = [row for row in self.rows if exceeds(row, case)]
        return tuple(sorted(far, key=lambda row: case.sign * (row.worst_n or 0.0), reverse=True))

    @property
    def open(self) -> tuple[StopDistance, ...]:
        """Rows without a bound in this configuration; a device that does not obey is never bounded, and not included."""
        return tuple(row for row in self.rows if row.worst_n is None and row.code is not FaultCode.STOP_NOT_OBEYED)


def stop_plan(config: Config, force_noise_n: float = 0.0, force_resolution_n: float = 0.0) -> StopPlan | None:
    """The stops of the ramp to the largest load.

    Args:
        config: configuration of the run.
        force_noise_n: standard deviation of the force reading under constant load, N.
        force_resolution_n: resolution of the force reading, N.

    Returns:
        None if semlive does not move the load frame.
    """
    frame, limits, protocol = config.load_frame, config.limits, config.protocol
    ramps = [(before, after) for before, after in pairwise((0.0, *protocol.loads_n)) if before != after]
    if frame is None or limits is None or not ramps or frame.driver in _BY_HAND:
        return None
    start_n, target_n = max(ramps, key=lambda ramp: (abs(ramp[1]), abs(ramp[1] - ramp[0])))
    approach = frame.settings.get("approach")
    travels = approach if isinstance(approach, Mapping) else None
    ahead_s = None if travels is None else _number(travels.get("ahead_s"))
    repeated = 2.0 if any(isinstance(section.get("serial"), Mapping) for section in _sections(frame.settings)) else 1.0
    case = RampCase(
        limits,
        start_n,
        target_n,
        protocol.ramp_rate_n_s,
        config.plan().hold.load_tolerance(target_n),
        frame.poll_s,
        noticeable_n=noticeable_n(force_noise_n, force_resolution_n),
        settle_s=protocol.settle_s,
        control=ControlMode.LOAD if travels is None else ControlMode.DISPLACEMENT,
        stiffness_n_mm=None if travels is None else _number(travels.get("stiffness_n_mm")),
        answer_s=repeated * max(_numbers(frame.settings, "timeout_s"), default=ANSWER_S),
        watchdog_s=max(_numbers(frame.settings, "watchdog_s"), default=None),
        ahead_s=0.5 if ahead_s is None else ahead_s,
    )
    return StopPlan(case, stop_distances(case))


def stop_advice(stops: StopPlan | None) -> Iterator[str]:
    """Advice for faults in which the load can exceed its limit by more than 5 %."""
    if stops is None:
        return
    limit_n = stops.case.limit_n
    for row in stops.exceeding[:1]:
        assert row.worst_n is not None
        over = 100.0 * (row.worst_n / limit_n - 1.0) if limit_n else 100.0
        further = len(stops.exceeding) - 1
        more = f" ({further} more {'fault exceeds' if further == 1 else 'faults exceed'} it by more than {100 * (EXCESS - 1):.0f} %)"
        yield (
            f"if {row.fault}, the load can reach {row.worst_n:.0f} N before the stop, {over:.0f} % beyond the force limit of {limit_n:g} N"
            f"{more if further else ''}: reduce protocol.ramp_rate_n_s, load_frame.poll_s or limits.force_max_n; check that "
            "--force-noise-n and --force-resolution-n are those of the load cell"
        )
    for row in stops.open:
        yield f"if {row.fault}, the force limit does not bound the load: {row.remark}"


def _sections(settings: Mapping[str, object]) -> Iterator[Mapping[str, object]]:
    """Settings of a driver and of its parts."""
    yield settings
    for value in settings.values():
        if isinstance(value, Mapping):
            yield from _sections(value)


def _numbers(settings: Mapping[str, object], key: str) -> list[float]:
    numbers = (_number(section.get(key)) for section in _sections(settings))
    return [section for section in numbers if section is not None]


def _number(value: object) -> float | None:
    """A number more than 0; None for other values, which the driver rejects."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and value > 0 else None
