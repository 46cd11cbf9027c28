"""Values of a configuration that are possible but implausible: mostly a wrong unit or a wrong number of digits.

`plan` and `doctor` show them; `run` refuses them until they are corrected, or confirmed in the file by `confirmed_unusual: [KEY, ...]`.
The log contains the configuration and with it the confirmation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from semlive.errors import BadConfig
from semlive.service.config.checks import largest_step_n
from semlive.service.config.configuration import Config

_MAX_STRESS_MPA = 4000.0
"""Cold-drawn steel wire and maraging steel break at 2500 to 4000 MPa; an area given in cm^2 makes the stress 100 times too large."""
_MIN_STRESS_MPA = 1e-3
"""1 kPa strains a rubber of 1 MPa by 1e-3, and a metal by less than can be measured; an area in um^2 makes it 1e6 times too small."""
_AREA_MM2 = (1e-5, 1000.0)
"""From a wire of 3.6 um to a bar of 32 x 32 mm, more than fits into a stage in a chamber; 10 mm^2 in m^2 are exactly 1e-5."""
_PIXEL_UM = (2e-4, 10.0)
"""From 0.2 nm, below the resolution of any SEM, to a field of 10 mm in 1024 px; 25 nm typed as 25 um lies outside."""
_PIXEL_RATIO = 2.0
"""Two values of the pixel size that differ by more have different units or magnifications."""
_DWELL_S = (1e-8, 1e-2)
"""Scan generators have 20 ns to some ms per pixel; microseconds typed as seconds lie above."""
_ROW_S = (1e-6, 30.0)
"""1000 px of 20 ns are 2e-5 s; 2048 px of 10 ms are 20 s."""
_FRAME_S = (1e-2, 7200.0)
"""Television rate is 0.04 s; a scan of one frame takes less than two hours."""
_MIN_READINGS_PER_RAMP = 4
"""A ramp with fewer readings cannot be supervised: it ends before a wrong direction or rate can be detected."""
_MAX_RAMP_S = 86_400.0
"""A ramp of more than a day is creep testing; detects kN/s typed as N/s, but not N/min or N/h."""
_TRAVEL_MM = 100.0
"""A stage inside a chamber travels 10 to 50 mm; micrometres typed as millimetres lie above."""
_MIN_EXTENSION_LIMIT_MM = 1e-3
"""1 um is less than the deformation of any load frame under load; metres typed as millimetres lie below."""
_MIN_STRETCH_MM = 1e-4
"""Encoders of small frames resolve 0.05 to 0.1 um: a stiffness at which the largest load stretches less was given in N/m."""
_MAX_FORCE_RATIO = 100.0
"""A limit this many times above every load has two digits too many; `plan` advises a lower one from 1.5 on."""
_DEFAULT_TRAVEL_MAX_MM = 1.0  # of `approach`, docs/reference/configuration.md


@dataclass(frozen=True, slots=True)
class Question:
    """An implausible value.

    Attributes:
        key: key of the value in `confirmed_unusual`.
        what: reason why it is implausible, with the figures.
        confirmed: whether the file confirms it.
    """

    key: str
    what: str
    confirmed: bool

    @property
    def advice(self) -> str:
        """Remedy."""
        return "confirmed in the file" if self.confirmed else f"correct it, or confirm it by confirmed_unusual: [{self.key}]"


def questions(config: Config) -> tuple[Question, ...]:
    """Return all implausible values, confirmed or not, one for each key."""
    reasons: dict[str, str] = {}
    for key, what in _implausible_values(config):
        reasons.setdefault(key, what)
    return tuple(Question(key, what, key in config.confirmed_unusual) for key, what in reasons.items())


def refuse_unusual(config: Config, where: str) -> None:
    """Reject a configuration with an implausible value that the file does not confirm.

    Raises:
        BadConfig: the message names the first one.
    """
    unconfirmed = [question for question in questions(config) if not question.confirmed]
    if unconfirmed:
        first, more = unconfirmed[0], len(unconfirmed) - 1
        further = f" ({more} more: {', '.join(question.key for question in unconfirmed[1:])})" if more else ""
        raise BadConfig(f"{where}: {first.key}: {first.what}; {first.advice}{further}")


def _implausible_values(config: Config) -> Iterator[tuple[str, str]]:
    yield from _specimen(config)
    yield from _scan(config)
    yield from _ramp(config)
    yield from _stiffness(config)
    yield from _limits(config)


def _largest_n(config: Config) -> float:
    return max((abs(load_n) for load_n in config.protocol.loads_n), default=0.0)


def _outside(value: float, bounds: tuple[float, float]) -> bool:
    return not bounds[0] <= value <= bounds[1]


def _specimen(config: Config) -> Iterator[tuple[str, str]]:
    area_mm2, load_n = config.specimen.area_mm2, _largest_n(config)
    if area_mm2 is None:
        return
    if not _AREA_MM2[0] < area_mm2 <= _AREA_MM2[1]:
        yield "specimen.area_mm2", f"a cross-section of {area_mm2:g} mm^2 is unusual; is it in another unit?"
    if load_n == 0.0:
        return
    stress_mpa = load_n / area_mm2
    if stress_mpa > _MAX_STRESS_MPA:
        yield (
            "specimen.area_mm2",
            f"{load_n:g} N on {area_mm2:g} mm^2 are {stress_mpa:.3g} MPa, more than the strength of any metal; is it in cm^2 or m^2?",
        )
    elif stress_mpa < _MIN_STRESS_MPA:
        yield (
            "specimen.area_mm2",
            f"{load_n:g} N on {area_mm2:g} mm^2 are {stress_mpa:.3g} MPa, which causes no measurable strain; is it in um^2?",
        )
    yield_mpa = config.specimen.yield_strength_mpa
    if yield_mpa is not None and stress_mpa > yield_mpa:
        yield (
            "specimen.yield_strength_mpa",
            f"{load_n:g} N on {area_mm2:g} mm^2 are {stress_mpa:.4g} MPa, above the yield strength of {yield_mpa:g} MPa",
        )


def _scan(config: Config) -> Iterator[tuple[str, str]]:
    sem, profile = config.sem, config.sem.profile
    if _outside(sem.pixel_size_um, _PIXEL_UM):
        yield "sem.pixel_size_um", f"pixels of {sem.pixel_size_um:g} um are unusual; is it in nm or m?"
    if profile.pixel_size_m is not None:
        ratio = 1e6 * profile.pixel_size_m / sem.pixel_size_um
        if not 1.0 / _PIXEL_RATIO <= ratio <= _PIXEL_RATIO:
            yield (
                "sem.pixel_size_um",
                f"{sem.pixel_size_um:g} um, and sem.profile.pixel_size_m is {profile.pixel_size_m:g} m: one of them has another unit",
            )
    for key, rows in (("sem.profile", (profile,)), ("sem.scan_profiles", sem.scan_profiles)):
        for row in rows:
            for name, bounds in (("dwell_time_s", _DWELL_S), ("row_time_s", _ROW_S), ("frame_time_s", _FRAME_S)):
                value = getattr(row, name)
                if value is not None and _outside(value, bounds):
                    yield key, f"{name} of {value:g} s is unusual; is it in us, ms or ns?"


def _ramp(config: Config) -> Iterator[tuple[str, str]]:
    step_n, rate_n_s = largest_step_n(config), config.protocol.ramp_rate_n_s
    if config.load_frame is None or step_n == 0.0:
        return
    ramp_s, shortest_s = step_n / rate_n_s, _MIN_READINGS_PER_RAMP * config.load_frame.poll_s
    if ramp_s < shortest_s:
        yield (
            "protocol.ramp_rate_n_s",
            f"at {rate_n_s:g} N/s the step of {step_n:g} N takes {ramp_s:.2g} s, less than {_MIN_READINGS_PER_RAMP} readings",
        )
    if ramp_s > _MAX_RAMP_S:
        yield "protocol.ramp_rate_n_s", f"at {rate_n_s:g} N/s the step of {step_n:g} N takes {ramp_s / 3600:.3g} h"


def _stiffness(config: Config) -> Iterator[tuple[str, str]]:
    """A stiffness that is too small makes the first motions too fast and too long, one that is too large makes them too slow."""
    approach = None if config.load_frame is None else config.load_frame.settings.get("approach")
    stiffness = approach.get("stiffness_n_mm") if isinstance(approach, dict) else None
    if isinstance(stiffness, bool) or not isinstance(stiffness, int | float) or stiffness <= 0 or config.limits is None:
        return  # the driver rejects it
    key, load_n, step_n = "load_frame.approach.stiffness_n_mm", _largest_n(config), largest_step_n(config)
    if load_n == 0.0:
        return
    travel_max_mm = approach.get("travel_max_mm", _DEFAULT_TRAVEL_MAX_MM) if isinstance(approach, dict) else _DEFAULT_TRAVEL_MAX_MM
    stretch_mm, step_mm, limit_mm = load_n / stiffness, step_n / stiffness, config.limits.extension_max_mm
    pull_n = max(config.protocol.loads_n)
    if pull_n > 0 and pull_n / stiffness > limit_mm:
        travel = f"at {stiffness:g} N/mm {pull_n:g} N need {pull_n / stiffness:.3g} mm"
        yield key, f"{travel}, beyond limits.extension_max_mm, {limit_mm:g} mm; is it in kN/mm?"
    elif isinstance(travel_max_mm, int | float) and step_mm > travel_max_mm:
        yield (
            key,
            f"at {stiffness:g} N/mm a step of {step_n:g} N needs {step_mm:.3g} mm, "
            f"beyond travel_max_mm, {travel_max_mm:g} mm; is it in kN/mm?",
        )
    elif stretch_mm < _MIN_STRETCH_MM:
        yield key, f"at {stiffness:g} N/mm {load_n:g} N need {1e6 * stretch_mm:.3g} nm, less than a drive can resolve; is it in N/m?"


def _limits(config: Config) -> Iterator[tuple[str, str]]:
    limits, load_n = config.limits, _largest_n(config)
    if limits is None or config.load_frame is None:
        return
    for name in ("extension_min_mm", "extension_max_mm"):
        value = getattr(limits, name)
        if abs(value) > _TRAVEL_MM:
            yield f"limits.{name}", f"{value:g} mm is more than the travel of a stage in a chamber; is it in um?"
    if max(abs(limits.extension_min_mm), abs(limits.extension_max_mm)) < _MIN_EXTENSION_LIMIT_MM:
        yield (
            "limits.extension_max_mm",
            f"{limits.extension_max_mm:g} mm is less than the deformation of a load frame under load; is it in m?",
        )
    for name in ("force_min_n", "force_max_n"):
        value = getattr(limits, name)
        if load_n > 0.0 and abs(value) >= _MAX_FORCE_RATIO * load_n:
            yield f"limits.{name}", f"{value:g} N is {abs(value) / load_n:.0f} times the largest load of the plan, {load_n:g} N"
