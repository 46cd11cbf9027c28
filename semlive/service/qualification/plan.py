"""The run that qualifies a microscope: pairs in place while it warms up, then a cross of shifts, without a load frame."""

from __future__ import annotations

from pathlib import Path

from semlive.qualify.drift import MIN_PAIRS_DECAY
from semlive.qualify.protocol import STEPS
from semlive.service.config.configuration import Config
from semlive.service.qualification.instrument import instrument_of, operator_stage, run_text

USUAL_SHIFT_PX = 24.0
"""Largest shift without calibration shifts in the configuration: 3 % of a frame of 884 rows, rounded to the cross of the paper."""


def plan_text(path: Path) -> str:
    """Configuration of the qualifying run for an instrument, as YAML.

    Devices, export folder and correlation are those of the instrument's configuration. The steps are pairs in place, which show the
    decay of the drift, and a cross of shifts as large as the configuration's own calibration. Without a stage in the configuration an
    operator moves the specimen.

    Args:
        path: configuration of the instrument.

    Raises:
        BadConfig: the configuration is invalid.
    """
    instrument = instrument_of(path, "qualify")
    half_px = 0.5 * _largest_px(instrument.config)
    shifts = [[half_px * x, half_px * y] for x, y in (*([(0, 0)] * MIN_PAIRS_DECAY), *STEPS)]
    stage = operator_stage(instrument.config.sem.pixel_size_um)
    planned = {"stage": stage, **instrument.sections, "protocol": {**instrument.sections["protocol"], "calibration_shifts_px": shifts}}
    head = "# Run that qualifies the microscope; evaluate it with `semlive qualify --from LOG`.\n"
    return run_text(head, planned, instrument.confirmed, str(path))


def _largest_px(config: Config) -> float:
    """Largest calibration shift of a configuration along one axis, px."""
    return max((abs(value) for shift in config.protocol.calibration_shifts_px for value in shift), default=0.0) or USUAL_SHIFT_PX
