"""Files of a qualification: JSON, and the recommended protocol as a configuration."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

from pydantic import TypeAdapter, ValidationError

from semlive.errors import BadInput
from semlive.inputs.files import read_regular
from semlive.qualify.values import FORMAT_VERSION, Qualification

_ADAPTER = TypeAdapter(Qualification)
_MAX_BYTES = 10**7


def to_json(qualification: Qualification) -> str:
    """The qualification as one JSON object."""
    return _ADAPTER.dump_json(qualification, indent=1).decode()


def json_schema() -> Mapping[str, object]:
    """JSON schema of the file."""
    return cast(Mapping[str, object], _ADAPTER.json_schema(mode="serialization"))


def read_qualification(path: Path) -> Qualification:
    """Read a file that `semlive qualify` wrote.

    Raises:
        BadInput: the file cannot be read, or is no qualification.
    """
    try:
        found = _ADAPTER.validate_json(read_regular(path, _MAX_BYTES))
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give a file that semlive qualify wrote") from error
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise BadInput(f"{path}: is no qualification ({where or 'no JSON object'}); give a file that semlive qualify wrote") from error
    if found.format > FORMAT_VERSION:
        raise BadInput(f"{path}: has format {found.format}, which is newer than this program; update semlive")
    return found


def configuration_text(qualification: Qualification, folder: Path) -> str:
    """The recommended protocol as YAML for `semlive run`, without a load frame; the operator moves the specimen.

    Args:
        qualification: the result.
        folder: export folder of the microscope.
    """
    protocol, conditions = qualification.protocol, qualification.conditions
    day = datetime.fromtimestamp(conditions.time_ns * 1e-9, UTC).date().isoformat()
    pixel_um = 1e-3 * conditions.pixel_nm or 1.0
    shifts = ", ".join(f"[{x:g}, {y:g}]" for x, y in protocol.shifts_px)
    lines = [
        f"# Protocol that semlive qualify recommends from the frames of {day} in {conditions.source}.",
        f"# Dwell time: {protocol.dwell_factor:g} times that of these frames. Waiting time: {protocol.warm_up_s / 60.0:.0f} minutes.",
        "run: {name: qualified}",
        "sem:",
        f"  folder: {_quoted(str(folder))}",
        f"  pixel_size_um: {pixel_um:.6g}" + ("" if conditions.pixel_nm else "  # not in the files: give it here"),
        *_times(qualification),
        "stage:",
        "  driver: operator",
        f"  settings: {{um_per_px: {pixel_um:.6g}}}",
        "protocol:",
        f"  calibration_shifts_px: [{shifts}]",
        f"  hold_s: {protocol.hold_s:.3g}",
    ]
    if protocol.max_rate_px_s is not None:
        lines.append(f"  warm_up: {{max_rate_px_s: {protocol.max_rate_px_s:.3g}, before: calibration}}")
    lines += [
        f"dic: {{subset_px: {protocol.subset_px}, step_px: {protocol.step_px}, roi_px: null}}",
        f"estimate: {{window_points: {protocol.window_points}}}",
    ]
    return "\n".join(lines) + "\n"


def _times(qualification: Qualification) -> list[str]:
    """Scan times at the recommended dwell time, for files that lack them; none if those of the frames are unknown."""
    conditions, factor = qualification.conditions, qualification.protocol.dwell_factor
    if not conditions.timed:
        return []
    dwell_s = factor * conditions.dwell_s
    row_s = conditions.row_s + (factor - 1.0) * conditions.dwell_s * conditions.width_px
    frame_s = row_s * conditions.height_px
    return [f"  profile: {{dwell_time_s: {dwell_s:.6g}, row_time_s: {row_s:.6g}, frame_time_s: {frame_s:.6g}}}"]


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
