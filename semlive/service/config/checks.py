"""Consistency checks of a configuration; applied to files only, so that logs of earlier runs stay readable."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from semlive.data.experiment import Limits
from semlive.inputs.kinds import Place

if TYPE_CHECKING:
    from semlive.service.config.configuration import Config

_SIGNED = ("force_min_n", "force_max_n", "extension_min_mm", "extension_max_mm")
"""Limits that may be negative or 0."""
_MAY_BE_ZERO = ("force_rate_max_n_s", "force_step_max_n", "stage_travel_um", "unloaded_max_n")
"""0 forbids a motion, or a preload beyond the load tolerance."""
CONFIRMABLE = (
    "specimen.area_mm2",
    "specimen.yield_strength_mpa",
    "sem.pixel_size_um",
    "sem.profile",
    "sem.scan_profiles",
    "protocol.ramp_rate_n_s",
    "load_frame.approach.stiffness_n_mm",
    "limits.extension_min_mm",
    "limits.extension_max_mm",
    "limits.force_min_n",
    "limits.force_max_n",
)
"""Keys whose implausible values can be confirmed (`semlive.service.config.plausibility`)."""
_MAX_TIME_S = 1e7
"""Longer than any run; a larger time has a wrong unit."""
_MAX_STOP_S = 3600.0
"""Longer than any machine takes to stop; a larger time has a wrong unit."""


@dataclass(frozen=True, slots=True)
class Contradiction:
    """An inconsistent value.

    Attributes:
        place: path of keys of the value.
        what: the error and its remedy, without the key.
    """

    place: Place
    what: str


def contradictions(config: Config) -> Iterator[Contradiction]:
    """Return the inconsistent values, the most severe first."""
    if config.limits is not None:
        yield from _limits(config.limits, loaded=config.load_frame is not None)
        yield from _loads(config, config.limits)
    yield from _times(config)
    yield from _confirmed(config)
    yield from _ramps(config)
    yield from _tolerances(config)
    yield from _scan(config)
    yield from _correlation(config)


def _limits(limits: Limits, *, loaded: bool) -> Iterator[Contradiction]:
    for low, high, unit in (("force_min_n", "force_max_n", "N"), ("extension_min_mm", "extension_max_mm", "mm")):
        minimum, maximum = getattr(limits, low), getattr(limits, high)
        if not minimum < maximum and (loaded or (minimum, maximum) != (0.0, 0.0)):  # both are 0 where nothing loads
            yield Contradiction(("limits", low), f"{minimum:g} {unit} is not below {high}, {maximum:g} {unit}; correct one of the two")
    for field in dataclasses.fields(limits):
        value = getattr(limits, field.name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if not math.isfinite(value):
            yield Contradiction(("limits", field.name), f"{value} is not a finite number; correct it")
        elif field.name in _SIGNED:
            continue
        elif value < 0 or (value == 0 != field.default and field.name not in _MAY_BE_ZERO):
            yield Contradiction(("limits", field.name), f"{value:g} is not more than 0; correct it, or leave the key out")
    if limits.lost_after_s < limits.stale_after_s:
        yield Contradiction(
            ("limits", "lost_after_s"),
            f"{limits.lost_after_s:g} s is less than stale_after_s, {limits.stale_after_s:g} s: a link is lost after its readings are "
            "stale; correct one of the two",
        )
    if limits.stop_timeout_s > _MAX_STOP_S:
        yield Contradiction(("limits", "stop_timeout_s"), f"{limits.stop_timeout_s:g} s is more than {_MAX_STOP_S:g} s; write less")


def _loads(config: Config, limits: Limits) -> Iterator[Contradiction]:
    loads = config.protocol.loads_n
    for index, load_n in enumerate(loads):
        if not limits.force_min_n <= load_n <= limits.force_max_n:
            yield Contradiction(
                ("protocol", "loads_n", index),
                f"a load of {load_n:g} N is outside limits.force_min_n to force_max_n, {limits.force_min_n:g} to {limits.force_max_n:g} N; "
                "correct it",
            )
    for index, (before_n, after_n) in enumerate(pairwise(loads), start=1):
        if abs(after_n - before_n) > limits.force_step_max_n:
            yield Contradiction(
                ("protocol", "loads_n", index),
                f"a change of load from {before_n:g} to {after_n:g} N is more than limits.force_step_max_n, {limits.force_step_max_n:g} N; "
                "plan smaller steps",
            )
    if loads and config.protocol.ramp_rate_n_s > limits.force_rate_max_n_s:
        yield Contradiction(
            ("protocol", "ramp_rate_n_s"),
            f"{config.protocol.ramp_rate_n_s:g} N/s is more than limits.force_rate_max_n_s, {limits.force_rate_max_n_s:g} N/s; ramp slower",
        )


def largest_step_n(config: Config) -> float:
    """Largest change of load of the plan, N, starting without load; 0 without loads."""
    loads = [0.0, *config.protocol.loads_n]
    return max((abs(after - before) for before, after in pairwise(loads)), default=0.0)


def _times(config: Config) -> Iterator[Contradiction]:
    """Times whose arithmetic in nanoseconds would overflow."""
    protocol = config.protocol
    sections = (
        (("protocol",), protocol),
        (("protocol", "warm_up"), protocol.warm_up),
        (("protocol", "adaptive_hold"), protocol.adaptive_hold),
        (("sem",), config.sem),
        (("limits",), config.limits),
    )
    for place, section in sections:
        for name in () if section is None else _names(section):
            value = getattr(section, name)
            if name.endswith("_s") and not name.endswith("_n_s") and isinstance(value, int | float) and value > _MAX_TIME_S:
                yield Contradiction((*place, name), f"{value:g} s is more than {_MAX_TIME_S:g} s, 115 days; write less")


def _names(section: object) -> tuple[str, ...]:
    fields = getattr(type(section), "model_fields", None)
    return tuple(fields) if fields is not None else tuple(getattr(type(section), "__dataclass_fields__", ()))


def _confirmed(config: Config) -> Iterator[Contradiction]:
    for index, key in enumerate(config.confirmed_unusual):
        if key not in CONFIRMABLE:
            close = difflib.get_close_matches(key, CONFIRMABLE, n=1, cutoff=0.4)
            hint = f"did you mean {close[0]}?" if close else f"the keys are {', '.join(CONFIRMABLE)}"
            yield Contradiction(("confirmed_unusual", index), f"{key} is not a key that can be confirmed; {hint}")


def _ramps(config: Config) -> Iterator[Contradiction]:
    protocol, step_n = config.protocol, largest_step_n(config)
    if step_n > protocol.ramp_rate_n_s * protocol.motion_timeout_s:
        yield Contradiction(
            ("protocol", "ramp_rate_n_s"),
            f"at {protocol.ramp_rate_n_s:g} N/s the step of {step_n:g} N takes {step_n / protocol.ramp_rate_n_s:.3g} s, and "
            f"protocol.motion_timeout_s is shorter, {protocol.motion_timeout_s:g} s; raise one of the two",
        )


def _tolerances(config: Config) -> Iterator[Contradiction]:
    """Load tolerances as large as a step: the load would count as reached without any motion."""
    protocol, step_n = config.protocol, largest_step_n(config)
    if step_n <= 0:
        return
    if protocol.load_tolerance_n >= step_n:
        yield Contradiction(
            ("protocol", "load_tolerance_n"),
            f"{protocol.load_tolerance_n:g} N is as large as the largest step of load, {step_n:g} N, which would count as reached before "
            "anything moved; write less",
        )
    largest_n = max(abs(load_n) for load_n in protocol.loads_n)
    if protocol.load_tolerance_fraction * largest_n >= step_n:
        yield Contradiction(
            ("protocol", "load_tolerance_fraction"),
            f"{protocol.load_tolerance_fraction:g} of {largest_n:g} N is as large as the largest step of load, {step_n:g} N; write less",
        )
    limits = config.limits
    if limits is not None and protocol.load_tolerance_n >= max(abs(limits.force_min_n), abs(limits.force_max_n)):
        yield Contradiction(
            ("protocol", "load_tolerance_n"), f"{protocol.load_tolerance_n:g} N is as large as the force limits; write less"
        )


def _scan(config: Config) -> Iterator[Contradiction]:
    """Times and lengths of a scan that are not more than 0."""
    names = ("dwell_time_s", "row_time_s", "frame_time_s", "pixel_size_m", "field_width_mm_at_1x")
    rows = [(("sem", "profile"), config.sem.profile)]
    rows += [(("sem", "scan_profiles", index), speed) for index, speed in enumerate(config.sem.scan_profiles)]
    for place, row in rows:
        for name in names:
            value = getattr(row, name, None)
            if value is not None and not value > 0:
                yield Contradiction((*place, name), f"{value:g} is not more than 0; correct it, or leave the key out")


def _correlation(config: Config) -> Iterator[Contradiction]:
    dic, estimate = config.dic, config.estimate
    for section, name, value in (
        ("dic", "max_iterations", dic.max_iterations),
        ("dic", "tolerance_px", dic.tolerance_px),
        ("estimate", "drift_knots_per_frame", estimate.drift_knots_per_frame),
        ("estimate", "distortion_knot_px", estimate.distortion_knot_px),
    ):
        if not value > 0:
            yield Contradiction((section, name), f"{value:g} is not more than 0; correct it")
    if not -1.0 <= dic.min_zncc < 1.0:
        yield Contradiction(("dic", "min_zncc"), f"{dic.min_zncc:g} is not from -1 to below 1, the range of ZNCC; correct it")
