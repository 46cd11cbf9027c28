"""Microscope, images and load of a run as NeXus groups of NXem (NXem_measurement)."""

from __future__ import annotations

import h5py
import numpy as np

from semlive.data.frame import FrameInfo
from semlive.data.loading import LoadSeries
from semlive.data.scan import Sourced
from semlive.report.export.archive.deposit import UNKNOWN
from semlive.report.export.archive.nexus_nodes import Value, add_field, add_group, iso_time
from semlive.report.export.archive.provenance import ExportProvenance, HashedFile
from semlive.report.export.fields import RunMetadata

_VENDORS = {"fei": "FEI / Thermo Fisher", "zeiss": "Zeiss", "tescan": "TESCAN", "jeol": "JEOL", "hitachi": "Hitachi"}
SAMPLE = "sample1"
_DETECTOR = "detector1"


def frame_infos(metadata: RunMetadata) -> dict[int, FrameInfo]:
    """Return the metadata of every frame of the result, by number."""
    decisions = {decision.pair: decision for decision in metadata.result.decisions}
    numbers = [summary.frame for summary in metadata.result.summaries]
    return {number: (decisions[number // 2].first, decisions[number // 2].second)[number % 2] for number in numbers}


def vendor_name(info: FrameInfo, provenance: ExportProvenance) -> str:
    """Return the maker of the microscope."""
    return provenance.deposit.instrument.vendor or _VENDORS.get(info.vendor, UNKNOWN)


def add_measurement(entry: h5py.Group, metadata: RunMetadata, provenance: ExportProvenance) -> None:
    """Add the instrument, one event for each frame, and the load as sampled."""
    infos = frame_infos(metadata)
    measurement = add_group(entry, "measurement", "NXem_measurement")
    _add_instrument(measurement, infos[min(infos)], metadata.load, provenance)
    for number, info in infos.items():
        _add_event(measurement, number, info, provenance.images.get(info.export))


def flyback_time_s(info: FrameInfo) -> float:
    """Return the time of a row without dwelling, of one pass: row time minus the dwell times of its pixels."""
    timing = info.timing
    return max(timing.row_time_s.value / timing.line_integrations.value - info.width_px * timing.dwell_time_s.value, 0.0)


def _add_instrument(measurement: h5py.Group, info: FrameInfo, load: LoadSeries | None, provenance: ExportProvenance) -> None:
    described = provenance.deposit.instrument
    instrument = add_group(
        measurement,
        "instrument",
        "NXem_instrument",
        name=described.name or provenance.instrument,
        location=described.location,
        type="sem",
    )
    maker = vendor_name(info, provenance)
    add_group(
        instrument,
        "fabrication",
        "NXfabrication",
        vendor=maker,
        model=described.model or provenance.instrument or UNKNOWN,
        serial_number=described.serial_number,
    )
    program = add_group(instrument, "program1", "NXprogram", program="semlive")
    program["program"].attrs["version"] = provenance.versions.get("semlive", UNKNOWN)
    column = add_group(instrument, "ebeam_column", "NXebeam_column")
    add_group(column, "electron_source", "NXsource", emitter_type=described.emitter_type or UNKNOWN, probe="electron")
    if info.column.detector is not None:
        add_group(instrument, _DETECTOR, "NXdetector", name=info.column.detector.value)
    if load is not None and load.time_ns.size:
        _add_load(instrument, load)


def _add_load(instrument: h5py.Group, load: LoadSeries) -> None:
    """Add a sensor for each reading of the load frame, with its readings over time."""
    readings = {
        "sensor_force": ("load cell of the load frame, tension positive", load.force_n, "N"),
        "sensor_extension": ("crosshead extension of the load frame", load.extension_mm, "mm"),
        "sensor_strain_gage": ("strain gage on the specimen, tension positive", load.gage_strain, "1"),
    }
    seconds = (load.time_ns - load.time_ns[0]) / 1e9
    for name, (description, values, unit) in readings.items():
        if values is not None:
            sensor = add_group(instrument, name, "NXsensor", name=name.removeprefix("sensor_").replace("_", " "), description=description)
            log = add_group(sensor, "value_log", "NXlog", time=(seconds, "s"), value=(values, unit))
            log["time"].attrs["start"] = iso_time(int(load.time_ns[0]))


def _add_event(measurement: h5py.Group, number: int, info: FrameInfo, file: HashedFile | None) -> None:
    """Add one frame: times, settings of the column, timing of the scan, and the exported file it was read from."""
    event = add_group(
        measurement,
        f"event_{number}",
        "NXem_event_data",
        start_time=iso_time(info.start_time_ns.value),
        end_time=iso_time(info.end_time_ns),
        identifier_event=(np.int64(number), ""),
        identifier_sample=f"/entry/{SAMPLE}",
    )
    _add_settings(event, info)
    timing, column = info.timing, info.column
    scan: dict[str, tuple[Sourced[float] | Sourced[int] | None, str]] = {
        "dwell_time": (timing.dwell_time_s, "s"),
        "row_time": (timing.row_time_s, "s"),
        "frame_time": (timing.frame_time_s, "s"),
        "frame_integrations": (timing.integrations, "1"),
        "line_integrations": (timing.line_integrations, "1"),
        "scan_rotation": (column.scan_rotation_deg, "deg"),
        "pixel_size": (info.pixel_size_m if info.pixel_size_m.value > 0 else None, "m"),
    }
    group = add_group(
        event,
        "scan",
        "NXcollection",
        flyback_time=(flyback_time_s(info), "s"),
        start_time_uncertainty=(info.start_sigma_s, "s"),
        width=(np.int64(info.width_px), "px"),
        height=(np.int64(info.height_px), "px"),
        **{key: (_plain(value.value), unit) for key, (value, unit) in scan.items() if value is not None},
        **info.geometry.values(),
    )
    for key, (value, _) in scan.items():
        if value is not None:
            group[key].attrs["source"] = value.source.value
    group["flyback_time"].attrs["source"] = "derived"
    if file is not None and info.column.detector is not None:
        _add_image(event, info, file)


def _add_settings(event: h5py.Group, info: FrameInfo) -> None:
    column, geometry = info.column, info.geometry
    instrument = add_group(event, "instrument", "NXem_instrument")
    beam = add_group(instrument, "ebeam_column", "NXebeam_column")
    if column.voltage_v is not None:
        add_group(beam, "electron_source", "NXsource", voltage=(column.voltage_v.value, "V"))
    add_group(
        beam,
        "scan_controller",
        "NXscan_controller",
        scan_schema="raster, row by row",
        dwell_time=(info.timing.dwell_time_s.value, "s"),
        flyback_time=(flyback_time_s(info), "s"),
    )
    optics: dict[str, tuple[Value, str] | Value | None] = {
        "magnification": None if column.magnification is None else (column.magnification.value, ""),
        "working_distance": None if column.working_distance_m is None else (column.working_distance_m.value, "m"),
        "field_of_view": (info.width_px * info.pixel_size_m.value, "m") if info.pixel_size_m.value > 0 else None,
        "tilt_correction": None if geometry.tilt_correction is None else geometry.tilt_correction.value,
        "dynamic_focus_correction": None if geometry.dynamic_focus is None else geometry.dynamic_focus.value,
    }
    add_group(instrument, "optics", "NXem_optical_system", **optics)


def _add_image(event: h5py.Group, info: FrameInfo, file: HashedFile) -> None:
    image = add_group(event, "image1", "NXimage")
    process = add_group(image, "process", "NXprocess", detector_identifier=f"/entry/measurement/instrument/{_DETECTOR}")
    kind = "image/png" if file.name.lower().endswith(".png") else "image/tiff"
    note = add_group(process, "input", "NXnote", type=kind, file_name=file.name, checksum=file.sha256, algorithm="sha256")
    add_field(note, "context", f"file of the microscope ({info.vendor}); its bytes are in the log")


def _plain(value: float | int) -> float | np.int64:
    return value if isinstance(value, float) else np.int64(value)
