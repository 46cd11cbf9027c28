"""All checks, in their order."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np

from semlive.data.checks import Finding, Verdict
from semlive.errors import BadConfig
from semlive.inputs.mask_file import mask_text, read_mask
from semlive.service.alerts.targets import read_targets
from semlive.service.checks import computer, instrument
from semlive.service.config.configuration import Config
from semlive.service.config.mask import usable_points
from semlive.service.config.plausibility import questions
from semlive.service.planning.stop_distances import StopPlan, stop_advice, stop_plan

# The size of the frames is unknown before the first frame: this assumes 8 bit and 2048 x 1768 px. A pair of 1024 x 884 px with its maps,
# fields and pictures takes about 10 MB.
_BYTES_PER_PAIR = 40_000_000


def run_checks(config: Config | None) -> Iterator[Finding]:
    """Run the checks one by one; nothing is moved, and no byte is sent to a device that moves.

    A trigger that can report the settings of its microscope reads them, and changes nothing.

    Args:
        config: configuration of the run; None: only the computer is checked.
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
        yield from _mask(config)
        yield from instrument.check_device_endpoints(config)
        yield from _unusual(config)
        yield from _alerts(config)
        stops = stop_plan(config)
        if stops is not None:
            yield _stops(stops)


def _mask(config: Config) -> Iterator[Finding]:
    """What the mask excludes; a configuration whose mask excludes every point is not loaded."""
    if config.dic.mask is not None:
        points = usable_points(read_mask(config.dic.mask), config.dic)
        observation = f"{mask_text(config.dic.mask)}; excludes {np.count_nonzero(~points)} of {points.size} points"
        yield Finding("mask", observation, Verdict.OK, "a run refuses frames of another size")


def _unusual(config: Config) -> Iterator[Finding]:
    """Implausible values; a run rejects those that the file does not confirm."""
    for question in questions(config):
        yield Finding(question.key, question.what, Verdict.UNKNOWN if question.confirmed else Verdict.FAILED, question.advice)


def _alerts(config: Config) -> Iterator[Finding]:
    """Whether the file with the addresses of alerts can be read; nothing is sent."""
    if config.alerts is None:
        return
    try:
        targets = read_targets(config.alerts.file)
    except BadConfig as error:
        yield Finding("alerts", str(error), Verdict.FAILED, "correct the section alerts or its file")
        return
    labels = ", ".join(target.label for target in targets)
    yield Finding("alerts", f"{labels} of {config.alerts.file}; nothing was sent", Verdict.OK, "semlive doctor --send-alert sends a test")


def _stops(stops: StopPlan) -> Finding:
    """The fault with the largest load before the stop, without the noise of the force reading, because no device is read."""
    case, worst = stops.case, stops.worst
    if worst is None or worst.worst_n is None:
        observation = f"the load is not bounded on the ramp to {case.target_n:g} N"
    else:
        after = "" if worst.seconds is None else f" within {worst.seconds:.1f} s"
        observation = (
            f"worst: if {worst.fault}, the load reaches at most {worst.worst_n:.0f} N{after}; the force limit is {case.limit_n:g} N"
        )
    remedies = list(stop_advice(stops))
    advice = remedies[0] if remedies else "semlive plan shows every fault; keep the emergency stop of the machine at hand"
    return Finding("stops", observation, Verdict.UNKNOWN if remedies else Verdict.OK, advice)
