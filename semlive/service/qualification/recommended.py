"""The recommended protocol as a configuration for `semlive run`, without a load frame."""

from __future__ import annotations

from pathlib import Path

from semlive.qualify.values import Qualification
from semlive.service.qualification.instrument import Sections, instrument_of, operator_stage, run_text


def configuration_text(qualification: Qualification, folder: Path, instrument: Path | None = None) -> str:
    """The recommended protocol as YAML.

    Args:
        qualification: the result.
        folder: export folder of the microscope, if there is no configuration of the instrument.
        instrument: configuration, or log of a run, of the instrument whose devices take the frames; without it, or without a stage in it,
            the operator moves the specimen.

    Raises:
        BadInput: the configuration of the instrument is invalid.
    """
    protocol, conditions = qualification.protocol, qualification.conditions
    day = f" of {conditions.day}" if conditions.dated else ""
    head = [
        f"# Protocol that semlive qualify recommends from the frames{day} in {conditions.source}.",
        f"# Dwell time: {protocol.dwell_factor:g} times that of these frames. Waiting time: {protocol.warm_up_s / 60.0:.0f} minutes.",
    ]
    devices, confirmed = _operated(qualification, folder), ()
    if instrument is not None:
        found = instrument_of(instrument, "calibrate")
        devices, confirmed = {"stage": devices["stage"], **found.sections}, found.confirmed
    elif not conditions.pixel_nm:
        head.append("# The pixel size is not in the files: give it in sem and stage.")
    sections = _with_protocol(devices, qualification)
    return run_text("\n".join(head) + "\n", sections, confirmed, str(instrument or "the recommended protocol"))


def _operated(qualification: Qualification, folder: Path) -> Sections:
    """Sections of an instrument without drivers: an export folder, and an operator who moves the specimen."""
    pixel_um = float(f"{1e-3 * qualification.conditions.pixel_nm or 1.0:.6g}")
    sem: dict[str, object] = {"folder": str(folder), "pixel_size_um": pixel_um}
    return {"run": {"name": "qualified"}, "sem": sem, "stage": operator_stage(pixel_um)}


def _with_protocol(devices: Sections, qualification: Qualification) -> Sections:
    """Sections of an instrument with the recommended times of the scan, calibration and correlation."""
    found, sections = qualification.protocol, dict(devices)
    profile = sections["sem"].get("profile")
    times = {**(profile if isinstance(profile, dict) else {}), **_times(qualification)}
    if times:
        sections["sem"] = {**sections["sem"], "profile": times}
    protocol: dict[str, object] = {
        **sections.get("protocol", {}),
        "calibration_shifts_px": [list(shift) for shift in found.shifts_px],
        "hold_s": _short(found.hold_s),
    }
    estimate: dict[str, object] = {**sections.get("estimate", {}), "window_points": found.window_points}
    if found.max_rate_px_s is not None:
        protocol["warm_up"] = {"max_rate_px_s": _short(found.max_rate_px_s), "before": "calibration"}
        estimate["method"] = "joint"  # the other method does not forecast the drift
    correlation = {"subset_px": found.subset_px, "step_px": found.step_px, "roi_px": None}
    return {
        **sections,
        "protocol": protocol,
        "dic": {**sections.get("dic", {}), **correlation},
        "estimate": estimate,
    }


def _times(qualification: Qualification) -> dict[str, object]:
    """Scan times at the recommended dwell time, for files that lack them; none if those of the frames are unknown."""
    conditions, factor = qualification.conditions, qualification.protocol.dwell_factor
    if not conditions.timed:
        return {}
    dwell_s = factor * conditions.dwell_s
    row_s = conditions.row_s + (factor - 1.0) * conditions.dwell_s * conditions.width_px
    times = {"dwell_time_s": dwell_s, "row_time_s": row_s, "frame_time_s": row_s * conditions.height_px}
    return {name: float(f"{value:.6g}") for name, value in times.items()}


def _short(value: float) -> float:
    return float(f"{value:.3g}")
