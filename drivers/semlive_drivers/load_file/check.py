"""Check of a load file before a run."""

from __future__ import annotations

from semlive.data.checks import Finding, Verdict
from semlive.errors import LinkError
from semlive.ports import ClockSource
from semlive_drivers.device_part import PartReading
from semlive_drivers.load_file.part import CsvLoadFile, CsvSettings

_VALUES = {"force_n": "force {:g} N", "extension_mm": "extension {:g} mm", "gage_strain": "gage {:g}"}


def check_load_file(key: str, settings: CsvSettings, clock: ClockSource) -> Finding:
    """Read the newest line of a load file as a run would.

    Args:
        key: place of the file in the settings of the driver.
        settings: settings of the file.
        clock: experiment time.
    """
    try:
        file = CsvLoadFile(settings, clock)
        if not file.holds_numbers():
            return Finding(key, f"{settings.file} holds no line of numbers yet", Verdict.UNKNOWN, "start the recording, then check again")
        return Finding(
            key, f"{settings.file}: the newest line is {_shown(file.read())}", Verdict.OK, "compare it with the machine's display"
        )
    except LinkError as error:
        return Finding(key, str(error), Verdict.FAILED, "correct the file or its settings; a run would stop here")


def _shown(reading: PartReading) -> str:
    values = ((text, getattr(reading, name)) for name, text in _VALUES.items())
    return ", ".join(text.format(value) for text, value in values if value is not None) or "without a value"
