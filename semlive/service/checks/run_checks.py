"""All that is looked at, in order."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from semlive.data.checks import Finding, Verdict
from semlive.service.checks import computer, instrument
from semlive.service.config.configuration import Config
from semlive.service.config.plausibility import questions
from semlive.service.planning.stop_distances import StopPlan, stop_advice, stop_plan

# Before the first frame nobody knows its size, which no configuration says: room for 8 bit of 2048 x 1768 px. A pair of 1024 x 884 px,
# with its maps, fields and pictures, takes about 10 MB.
_BYTES_PER_PAIR = 40_000_000


def run_checks(config: Config | None) -> Iterator[Finding]:
    """What a run needs, one by one; nothing is moved, and no byte goes to a device.

    Args:
        config: of the run; None looks at the computer alone.
    """
    yield Finding("semlive", version("semlive"), Verdict.OK)
    yield computer.processor()
    yield computer.jit_cache()
    yield computer.check_clock_rate()
    yield computer.check_time_service()
    folder, needed = Path("runs").resolve(), None
    if config is not None:
        folder, needed = config.run.folder, _BYTES_PER_PAIR * len(config.plan().steps)
    yield from computer.disk(folder, needed)
    yield from instrument.drivers(config)
    yield instrument.page_port()
    if config is not None:
        yield from instrument.export_folder(config)
        yield from instrument.check_device_endpoints(config)
        yield from _unusual(config)
        stops = stop_plan(config)
        if stops is not None:
            yield _stops(stops)


def _unusual(config: Config) -> Iterator[Finding]:
    """Implausible values; a run refuses those that the file does not confirm."""
    for one in questions(config):
        yield Finding(one.key, one.what, Verdict.UNKNOWN if one.confirmed else Verdict.FAILED, one.advice)


def _stops(stops: StopPlan) -> Finding:
    """The fault that can carry the load farthest before it is stopped; the device is not asked, so its noise is left out."""
    case, far = stops.case, stops.worst
    if far is None or far.worst_n is None:
        said = f"nothing bounds the load on the ramp to {case.target_n:g} N"
    else:
        after = "" if far.seconds is None else f" within {far.seconds:.1f} s"
        said = f"worst: if {far.fault}, the load reaches at most {far.worst_n:.0f} N{after}; the force limit is {case.limit_n:g} N"
    wrong = list(stop_advice(stops))
    advice = wrong[0] if wrong else "semlive plan shows every fault; keep the emergency stop of the machine at hand"
    return Finding("stops", said, Verdict.UNKNOWN if wrong else Verdict.OK, advice)
