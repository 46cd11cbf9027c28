"""Going to a load with a machine that only knows displacement: pure decisions from reading to reading.

Each motion that is ordered ends by itself after a bounded way, so that nothing runs on when nobody looks any more. The machine goes
at the speed that its stiffness turns into the wanted rate, slower near the target, and never beyond a way that the ramp can need.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydantic import BaseModel, ConfigDict, Field

from semlive_drivers.exactness import towards_zero

SPEED_TOLERANCE = 0.1
"""Relative difference of a speed from the one that the rate asks for; the stiffness is known no better."""


class ApproachSettings(BaseModel):
    """How a load is approached in displacement control."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stiffness_n_mm: float = Field(gt=0)
    """Of specimen, grips and machine in series; the stiffest that can be meant: too large makes a ramp slow, too small makes it fast."""
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


@dataclass(frozen=True, slots=True)
class Go:
    """A motion to order.

    Attributes:
        pull: towards tension.
        travel_mm: at most so far.
        speed_mm_s: how fast.
    """

    pull: bool
    travel_mm: float
    speed_mm_s: float


@dataclass(frozen=True, slots=True)
class Approach:
    """A ramp under way.

    Attributes:
        target_n: where to.
        rate_n_s: how fast.
        pull: the direction, decided once: a ramp never turns round.
        best_n: the load nearest to the target so far, in the ramp's direction.
        travelled_mm: way so far.
        extension_mm: at the last reading.
        trouble: why it was given up, or nothing.
        over: nothing is to be ordered any more.
    """

    target_n: float
    rate_n_s: float
    pull: bool
    best_n: float
    travelled_mm: float
    extension_mm: float
    trouble: str = ""
    over: bool = False


def begin(target_n: float, rate_n_s: float, force_n: float, extension_mm: float) -> Approach:
    """A ramp from where the machine is."""
    return Approach(target_n, rate_n_s, target_n > force_n, force_n, 0.0, extension_mm)


def step(
    ramp: Approach, settings: ApproachSettings, force_n: float, extension_mm: float, since_s: float, least_mm: float = 0.0
) -> tuple[Approach, Go | None]:
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
    if ramp.over:
        return ramp, None
    sign = 1.0 if ramp.pull else -1.0
    speed = _speed(ramp, settings, force_n)
    moved_mm = abs(extension_mm - ramp.extension_mm) or speed * since_s
    best_n = max(ramp.best_n * sign, force_n * sign) * sign
    now = replace(ramp, best_n=best_n, travelled_mm=ramp.travelled_mm + moved_mm, extension_mm=extension_mm)
    missing_n = sign * (ramp.target_n - force_n)
    if missing_n <= max(settings.arrived_n, least_mm * settings.stiffness_n_mm):
        return replace(now, over=True), None
    if sign * (best_n - force_n) > settings.wrong_way_n:
        what = f"the load went from {best_n:.1f} to {force_n:.1f} N on its way to {ramp.target_n:g} N"
        return replace(now, over=True, trouble=f"{what}; check sign and direction, grips and specimen"), None
    left_mm = settings.travel_max_mm - now.travelled_mm
    if left_mm <= least_mm:
        what = f"{now.travelled_mm:.3f} mm of travel brought the load to {force_n:.1f} N only, not to {ramp.target_n:g} N"
        return replace(now, over=True, trouble=f"{what}; check grips, specimen, stiffness_n_mm and travel_max_mm"), None
    return now, Go(ramp.pull, min(left_mm, speed * settings.ahead_s, missing_n / settings.stiffness_n_mm), speed)


def _speed(ramp: Approach, settings: ApproachSettings, force_n: float) -> float:
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
