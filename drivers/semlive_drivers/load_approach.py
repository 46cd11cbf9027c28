"""Going to a load with a machine that only knows displacement: pure decisions from reading to reading.

Each motion that is ordered ends by itself after a bounded way, so that nothing runs on when nobody looks any more. The machine goes
at the speed that its stiffness turns into the wanted rate, slower near the target, and never beyond a way that the ramp can need.

The stated stiffness may be wrong, by a factor of 1000 where units were mistaken. Every ramp therefore begins with a very short way, and
each way is at most twice the one before; a load that answers more strongly than the stated stiffness allows ends the ramp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydantic import BaseModel, ConfigDict, Field

from semlive_drivers.device_part import OrderBook, PartCommand
from semlive_drivers.order_exactness import towards_zero

SPEED_TOLERANCE = 0.1
"""Relative difference of a speed from the one that the rate asks for; the stiffness is known no better."""

STIFFER = 1.5
"""The load may answer so many times more strongly than the stated stiffness, besides the noise of the readings."""
_STRIKES = 2
"""Readings in turn that must show it: one alone may be a disturbance."""


class ApproachSettings(BaseModel):
    """How a load is approached in displacement control."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stiffness_n_mm: float = Field(gt=0)
    """Of specimen, grips and machine in series, the largest that can be meant: too large makes a ramp slow, too small ends it."""
    speed_max_mm_s: float = Field(gt=0)
    speed_min_mm_s: float = Field(default=0.0, ge=0)
    """The slowest that the drive can go."""
    arrived_n: float = Field(default=1.0, gt=0)
    """The ramp is over this close to its target."""
    ahead_s: float = Field(default=0.5, gt=0, le=10)
    """The way that is ordered at once is what is covered in this time; the next reading orders on."""
    travel_max_mm: float = Field(default=1.0, gt=0)
    """Most way in one ramp, whatever the load says: a specimen that has failed is not followed."""
    wrong_way_n: float = Field(default=20.0, gt=0)
    """A load that goes this far in the wrong direction ends the ramp: wrong sign, slipping grips, or a broken specimen."""
    first_travel_mm: float = Field(default=0.0005, gt=0)
    """The first way of a ramp; the next ones are at most twice as long as the one before each, until the load has answered as stated."""


@dataclass(frozen=True, slots=True)
class JogOrder:
    """A motion to order.

    Attributes:
        in_tension: towards tension.
        travel_mm: at most so far.
        speed_mm_s: how fast.
    """

    in_tension: bool
    travel_mm: float
    speed_mm_s: float


@dataclass(frozen=True, slots=True)
class ApproachState:
    """A ramp under way.

    Attributes:
        target_n: where to.
        rate_n_s: how fast.
        in_tension: the direction, decided once: a ramp never turns round.
        best_n: the load nearest to the target so far, in the ramp's direction.
        travelled_mm: way so far.
        extension_mm: at the last reading.
        trouble: why it was given up, or nothing.
        finished: nothing is to be ordered any more.
        start_n: load at its beginning.
        start_mm: extension at its beginning.
        noise_n: by how much readings at rest differ from each other.
        ordered: the last way; None before the first.
        ordered_mm: how far the ways so far can have moved the machine, by speed and time.
        strikes: readings in turn in which the load answered too strongly.
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
    strikes: int = 0


def start(target_n: float, rate_n_s: float, force_n: float, extension_mm: float, noise_n: float = 0.0) -> ApproachState:
    """A ramp from where the machine is.

    Args:
        target_n: where to.
        rate_n_s: how fast.
        force_n: load now.
        extension_mm: crosshead now.
        noise_n: by how much readings at rest differ from each other.
    """
    pull = target_n > force_n
    return ApproachState(target_n, rate_n_s, pull, force_n, 0.0, extension_mm, start_n=force_n, start_mm=extension_mm, noise_n=noise_n)


def step(
    ramp: ApproachState, settings: ApproachSettings, force_n: float, extension_mm: float, since_s: float, least_mm: float = 0.0
) -> tuple[ApproachState, JogOrder | None]:
    """One reading later.

    Args:
        ramp: as it was.
        settings: how to approach.
        force_n: load now.
        extension_mm: crosshead now.
        since_s: time since the last order, for machines that do not tell their extension.
        least_mm: the shortest way that the drive can be ordered; a target nearer than that is reached.

    Returns:
        The ramp, and what to order; None with a ramp that is over means stop.
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
    now = replace(now, strikes=ramp.strikes + 1 if _too_stiff(now, settings, force_n) else 0)
    missing_n = sign * (ramp.target_n - force_n)
    left_mm = settings.travel_max_mm - now.travelled_mm
    if trouble := _trouble(now, settings, force_n):
        return replace(now, finished=True, trouble=trouble), None
    if missing_n <= max(settings.arrived_n, least_mm * settings.stiffness_n_mm):
        return replace(now, finished=True), None
    if left_mm <= least_mm:
        what = f"{now.travelled_mm:.3f} mm of travel brought the load to {force_n:.1f} N only, not to {ramp.target_n:g} N"
        return replace(now, finished=True, trouble=f"{what}; check grips, specimen, stiffness_n_mm and travel_max_mm"), None
    grown_mm = settings.first_travel_mm if ramp.ordered is None or now.strikes else 2.0 * ramp.ordered.travel_mm
    way_mm = min(left_mm, speed * settings.ahead_s, missing_n / settings.stiffness_n_mm, max(grown_mm, settings.first_travel_mm))
    go = JogOrder(ramp.in_tension, max(way_mm, least_mm), speed)
    return replace(now, ordered=go), go


def _trouble(ramp: ApproachState, settings: ApproachSettings, force_n: float) -> str:
    """Why a ramp must be given up, or nothing."""
    sign = 1.0 if ramp.in_tension else -1.0
    if ramp.strikes >= _STRIKES:
        what = f"the load went from {ramp.start_n:.1f} to {force_n:.1f} N within {_way_mm(ramp) * 1e3:.3g} um"
        return f"{what}: the specimen is stiffer than stiffness_n_mm {settings.stiffness_n_mm:g}; correct it (N/mm)"
    if sign * (ramp.best_n - force_n) > settings.wrong_way_n:
        what = f"the load went from {ramp.best_n:.1f} to {force_n:.1f} N on its way to {ramp.target_n:g} N"
        return f"{what}; check sign and direction, grips and specimen"
    return ""


def _way_mm(ramp: ApproachState) -> float:
    """How far the machine can have moved since the ramp began, by its own word or by speed and time, whichever is more."""
    return max(abs(ramp.extension_mm - ramp.start_mm), ramp.ordered_mm)


def _too_stiff(ramp: ApproachState, settings: ApproachSettings, force_n: float) -> bool:
    """Whether the load has answered more strongly than the stated stiffness and the noise of the readings allow."""
    sign = 1.0 if ramp.in_tension else -1.0
    allowed_n = max(2.0 * settings.arrived_n, 0.25 * settings.wrong_way_n, 1.5 * ramp.noise_n)
    return sign * (force_n - ramp.start_n) > allowed_n + STIFFER * settings.stiffness_n_mm * _way_mm(ramp)


def _speed(ramp: ApproachState, settings: ApproachSettings, force_n: float) -> float:
    """The wanted rate, and no faster than what closes the gap within the time that is ordered ahead."""
    wanted = ramp.rate_n_s / settings.stiffness_n_mm
    gap = abs(ramp.target_n - force_n) / settings.stiffness_n_mm / settings.ahead_s
    return max(min(wanted, gap, settings.speed_max_mm_s), settings.speed_min_mm_s)


def speed_problem(settings: ApproachSettings, rate_n_s: float, step_mm_s: float = 0.0) -> str | None:
    """Why a rate cannot be kept in displacement control, or None: its speed must be one of the drive's, to 10 %.

    Args:
        settings: how to approach.
        rate_n_s: the wanted rate.
        step_mm_s: smallest step of the drive's speed; speeds are rounded down to whole steps.
    """
    speed, stiffness = rate_n_s / settings.stiffness_n_mm, settings.stiffness_n_mm
    said = f"{rate_n_s:g} N/s is {speed:.3g} mm/s at stiffness_n_mm {stiffness:g}"
    if speed * (1 + SPEED_TOLERANCE) < settings.speed_min_mm_s:
        least = f"order at least {settings.speed_min_mm_s * stiffness:.3g} N/s, or correct stiffness_n_mm"
        return f"{said}, slower than speed_min_mm_s {settings.speed_min_mm_s:g}; {least}"
    if speed > settings.speed_max_mm_s * (1 + SPEED_TOLERANCE):
        most = f"order at most {settings.speed_max_mm_s * stiffness:.3g} N/s, or correct stiffness_n_mm"
        return f"{said}, faster than speed_max_mm_s {settings.speed_max_mm_s:g}; {most}"
    taken = towards_zero(speed / step_mm_s) * step_mm_s if step_mm_s else speed
    if speed - taken > SPEED_TOLERANCE * speed:
        return f"{said}, but the drive takes {taken:.3g} mm/s; order a rate that is a multiple of {step_mm_s * stiffness:.3g} N/s"
    return None


def ramp_problem(book: OrderBook, settings: ApproachSettings | None, force_n: float, rate_n_s: float) -> str | None:
    """Why a ramp cannot be ordered as it is meant, or None.

    Args:
        book: what the machine can be ordered.
        settings: how a load is approached by a machine that only knows displacement.
        force_n: where to.
        rate_n_s: how fast.
    """
    if PartCommand.RAMP in book.can:
        return book.order_problem(PartCommand.RAMP, {"force_n": force_n, "rate_n_s": rate_n_s})
    if settings is None:
        return None
    problem = speed_problem(settings, rate_n_s, book.step_of("speed_mm_s"))
    if problem is not None:
        return problem
    # The shortest way of a ramp: what is missing when the load is just not within arrived_n of its target.
    travel = max(settings.arrived_n / settings.stiffness_n_mm, book.step_of("travel_mm"))
    speed = max(rate_n_s / settings.stiffness_n_mm, settings.speed_min_mm_s)
    values = {"travel_mm": min(travel, settings.travel_max_mm), "speed_mm_s": speed}
    return next(
        (
            found
            for what in (PartCommand.JOG_TENSION, PartCommand.JOG_COMPRESSION)
            if what in book.can and (found := book.order_problem(what, values))
        ),
        None,
    )
