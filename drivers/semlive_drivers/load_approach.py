"""Ramps to a load on a machine with displacement control only: pure decisions from reading to reading.

A ramp is a sequence of jogs. Each jog ends by itself after a limited travel, so that the machine stops if the program or the link fails.
The speed is the load rate divided by the stiffness, less near the target. The travel of a ramp is limited.

The stated stiffness may be wrong, by a factor of 1000 if units were mistaken. Every ramp therefore begins with a very short jog, and each
jog is at most twice as long as the one before. If the load changes more than the stated stiffness allows, the ramp ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydantic import BaseModel, ConfigDict, Field

from semlive_drivers.device_part import OrderBook, PartCommand
from semlive_drivers.order_exactness import towards_zero

SPEED_TOLERANCE = 0.1
"""Largest relative difference of a speed from the speed of the rate; the stiffness is not known more accurately."""

MAX_STIFFNESS_RATIO = 1.5
"""Largest ratio of the observed to the stated stiffness, in addition to the noise of the readings."""
_MIN_STIFF_READINGS = 2
"""Consecutive readings that must show a larger stiffness, because a single one may be a disturbance."""


class ApproachSettings(BaseModel):
    """Settings for loads in displacement control."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stiffness_n_mm: float = Field(gt=0)
    """Largest possible stiffness of specimen, grips and machine in series: too large makes a ramp slow, too small ends it."""
    speed_max_mm_s: float = Field(gt=0)
    """Largest speed of the drive."""
    speed_min_mm_s: float = Field(default=0.0, ge=0)
    """Smallest speed of the drive."""
    arrived_n: float = Field(default=1.0, gt=0)
    """Distance from the target load at which the ramp ends."""
    ahead_s: float = Field(default=0.5, gt=0, le=10)
    """Duration of one jog; the next reading orders the next one."""
    travel_max_mm: float = Field(default=1.0, gt=0)
    """Largest travel of one ramp at any load, so that the drive does not follow a broken specimen."""
    wrong_way_n: float = Field(default=20.0, gt=0)
    """Change of the load in the wrong direction that ends the ramp: wrong sign, slipping grips, or a broken specimen."""
    first_travel_mm: float = Field(default=0.0005, gt=0)
    """Travel of the first jog of a ramp. Each next jog is at most twice as long as the one before."""


@dataclass(frozen=True, slots=True)
class JogOrder:
    """A motion to order.

    Attributes:
        in_tension: whether the motion is in the direction of tension.
        travel_mm: largest travel, mm.
        speed_mm_s: speed, mm/s.
    """

    in_tension: bool
    travel_mm: float
    speed_mm_s: float


@dataclass(frozen=True, slots=True)
class ApproachState:
    """A ramp under way.

    Attributes:
        target_n: target load, N.
        rate_n_s: load rate, N/s.
        in_tension: direction, which does not change during a ramp.
        best_n: load nearest to the target so far, in the direction of the ramp, N.
        travelled_mm: travel so far, mm.
        extension_mm: extension at the last reading, mm.
        trouble: why the ramp was aborted; empty otherwise.
        finished: whether no further jog is ordered.
        start_n: load at the start, N.
        start_mm: extension at the start, mm.
        noise_n: largest difference of readings at rest, N.
        ordered: the last jog; None before the first.
        ordered_mm: largest possible travel of all jogs so far, by speed and time, mm.
        stiff_readings: consecutive readings with a larger change of load than the stated stiffness allows.
    """

    target_n: float
    rate_n_s: float
    in_tension: bool
    best_n: float
    travelled_mm: float
    extension_mm: float
    trouble: str = ""
    finished: bool = False
    start_n: float = 0.0
    start_mm: float = 0.0
    noise_n: float = 0.0
    ordered: JogOrder | None = None
    ordered_mm: float = 0.0
    stiff_readings: int = 0


def start(target_n: float, rate_n_s: float, force_n: float, extension_mm: float, noise_n: float = 0.0) -> ApproachState:
    """The state at the start of a ramp.

    Args:
        target_n: target load, N.
        rate_n_s: load rate, N/s.
        force_n: present load, N.
        extension_mm: present extension, mm.
        noise_n: largest difference of readings at rest, N.
    """
    in_tension = target_n > force_n
    return ApproachState(
        target_n, rate_n_s, in_tension, force_n, 0.0, extension_mm, start_n=force_n, start_mm=extension_mm, noise_n=noise_n
    )


def step(
    ramp: ApproachState, settings: ApproachSettings, force_n: float, extension_mm: float, since_s: float, min_travel_mm: float = 0.0
) -> tuple[ApproachState, JogOrder | None]:
    """The state of a ramp after a reading.

    Args:
        ramp: state before the reading.
        settings: settings of the ramp.
        force_n: load of the reading, N.
        extension_mm: extension of the reading, mm.
        since_s: time since the last order, s, for machines that do not measure their extension.
        min_travel_mm: shortest jog of the drive, mm; a target within this travel counts as reached.

    Returns:
        The state, and the next jog; None with a finished ramp means stop.
    """
    if ramp.finished:
        return ramp, None
    sign = 1.0 if ramp.in_tension else -1.0
    speed = _speed(ramp, settings, force_n)
    by_time_mm = 0.0 if ramp.ordered is None else min(ramp.ordered.speed_mm_s * since_s, ramp.ordered.travel_mm)
    moved_mm = abs(extension_mm - ramp.extension_mm) or by_time_mm
    best_n = max(ramp.best_n * sign, force_n * sign) * sign
    travelled_mm, ordered_mm = ramp.travelled_mm + moved_mm, ramp.ordered_mm + by_time_mm
    now = replace(ramp, best_n=best_n, travelled_mm=travelled_mm, extension_mm=extension_mm, ordered_mm=ordered_mm)
    now = replace(now, stiff_readings=ramp.stiff_readings + 1 if _too_stiff(now, settings, force_n) else 0)
    missing_n = sign * (ramp.target_n - force_n)
    remaining_mm = settings.travel_max_mm - now.travelled_mm
    if trouble := _trouble(now, settings, force_n):
        return replace(now, finished=True, trouble=trouble), None
    if missing_n <= max(settings.arrived_n, min_travel_mm * settings.stiffness_n_mm):
        return replace(now, finished=True), None
    if remaining_mm <= min_travel_mm:
        problem = f"{now.travelled_mm:.3f} mm of travel brought the load to {force_n:.1f} N only, not to {ramp.target_n:g} N"
        return replace(now, finished=True, trouble=f"{problem}; check grips, specimen, stiffness_n_mm and travel_max_mm"), None
    grown_mm = settings.first_travel_mm if ramp.ordered is None or now.stiff_readings else 2.0 * ramp.ordered.travel_mm
    travel_mm = min(remaining_mm, speed * settings.ahead_s, missing_n / settings.stiffness_n_mm, max(grown_mm, settings.first_travel_mm))
    jog = JogOrder(ramp.in_tension, max(travel_mm, min_travel_mm), speed)
    return replace(now, ordered=jog), jog


def _trouble(ramp: ApproachState, settings: ApproachSettings, force_n: float) -> str:
    """Why a ramp must be aborted; empty otherwise."""
    sign = 1.0 if ramp.in_tension else -1.0
    if ramp.stiff_readings >= _MIN_STIFF_READINGS:
        problem = f"the load went from {ramp.start_n:.1f} to {force_n:.1f} N within {_travel_mm(ramp) * 1e3:.3g} um"
        return f"{problem}: the specimen is stiffer than stiffness_n_mm {settings.stiffness_n_mm:g}; correct it (N/mm)"
    if sign * (ramp.best_n - force_n) > settings.wrong_way_n:
        problem = f"the load went from {ramp.best_n:.1f} to {force_n:.1f} N on its way to {ramp.target_n:g} N"
        return f"{problem}; check sign and direction, grips and specimen"
    return ""


def _travel_mm(ramp: ApproachState) -> float:
    """Largest possible travel since the start of the ramp, mm: by the extension or by speed and time, whichever is larger."""
    return max(abs(ramp.extension_mm - ramp.start_mm), ramp.ordered_mm)


def _too_stiff(ramp: ApproachState, settings: ApproachSettings, force_n: float) -> bool:
    """Whether the load changed more than the stated stiffness and the noise of the readings allow."""
    sign = 1.0 if ramp.in_tension else -1.0
    allowed_n = max(2.0 * settings.arrived_n, 0.25 * settings.wrong_way_n, 1.5 * ramp.noise_n)
    return sign * (force_n - ramp.start_n) > allowed_n + MAX_STIFFNESS_RATIO * settings.stiffness_n_mm * _travel_mm(ramp)


def _speed(ramp: ApproachState, settings: ApproachSettings, force_n: float) -> float:
    """Speed of the load rate, mm/s, reduced so that one jog does not pass the target, within the limits of the drive."""
    rate_mm_s = ramp.rate_n_s / settings.stiffness_n_mm
    gap_mm_s = abs(ramp.target_n - force_n) / settings.stiffness_n_mm / settings.ahead_s
    return max(min(rate_mm_s, gap_mm_s, settings.speed_max_mm_s), settings.speed_min_mm_s)


def speed_problem(settings: ApproachSettings, rate_n_s: float, step_mm_s: float = 0.0) -> str | None:
    """Why a rate cannot be ordered in displacement control, or None: the drive must have its speed within 10 %.

    Args:
        settings: settings of the ramp.
        rate_n_s: load rate, N/s.
        step_mm_s: smallest step of the speed of the drive, mm/s; speeds are rounded down to multiples of it.
    """
    speed, stiffness = rate_n_s / settings.stiffness_n_mm, settings.stiffness_n_mm
    text = f"{rate_n_s:g} N/s is {speed:.3g} mm/s at stiffness_n_mm {stiffness:g}"
    if speed * (1 + SPEED_TOLERANCE) < settings.speed_min_mm_s:
        advice = f"order at least {settings.speed_min_mm_s * stiffness:.3g} N/s, or correct stiffness_n_mm"
        return f"{text}, slower than speed_min_mm_s {settings.speed_min_mm_s:g}; {advice}"
    if speed > settings.speed_max_mm_s * (1 + SPEED_TOLERANCE):
        advice = f"order at most {settings.speed_max_mm_s * stiffness:.3g} N/s, or correct stiffness_n_mm"
        return f"{text}, faster than speed_max_mm_s {settings.speed_max_mm_s:g}; {advice}"
    stored = towards_zero(speed / step_mm_s) * step_mm_s if step_mm_s else speed
    if speed - stored > SPEED_TOLERANCE * speed:
        return f"{text}, but the drive takes {stored:.3g} mm/s; order a rate that is a multiple of {step_mm_s * stiffness:.3g} N/s"
    return None


def ramp_problem(book: OrderBook, settings: ApproachSettings | None, force_n: float, rate_n_s: float) -> str | None:
    """Why a ramp cannot be ordered exactly, or None.

    Args:
        book: orders that the machine can take.
        settings: settings for displacement control; None without.
        force_n: target load, N.
        rate_n_s: load rate, N/s.
    """
    if PartCommand.RAMP in book.can:
        return book.order_problem(PartCommand.RAMP, {"force_n": force_n, "rate_n_s": rate_n_s})
    if settings is None:
        return None
    problem = speed_problem(settings, rate_n_s, book.step_of("speed_mm_s"))
    if problem is not None:
        return problem
    # The shortest jog of a ramp: its travel when the load differs by arrived_n from the target.
    travel = max(settings.arrived_n / settings.stiffness_n_mm, book.step_of("travel_mm"))
    speed = max(rate_n_s / settings.stiffness_n_mm, settings.speed_min_mm_s)
    values = {"travel_mm": min(travel, settings.travel_max_mm), "speed_mm_s": speed}
    return next(
        (
            problem
            for order in (PartCommand.JOG_TENSION, PartCommand.JOG_COMPRESSION)
            if order in book.can and (problem := book.order_problem(order, values))
        ),
        None,
    )
