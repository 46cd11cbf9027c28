"""What the application definition NXem requires of the groups that semlive writes, and the rules of NXdata.

Transcribed from ``applications/NXem.nxdl.xml`` and ``base_classes/NXdata.nxdl.xml`` of the NeXus definitions v2026.01
(https://github.com/FAIRmat-NFDI/nexus_definitions). `tests/benchmarks/validate_archive.py` runs the public validator.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime

import h5py

FABRICATION = ("vendor", "model")
REQUIRED: dict[str, tuple[str, tuple[str, ...]]] = {
    r"entry": ("NXentry", ("definition", "start_time", "sample1")),
    r"entry/profiling": ("NXcs_profiling", ()),
    r"entry/(profiling|measurement/instrument)/program\d+": ("NXprogram", ("program", "program@version")),
    r"entry/note\d+": ("NXnote", ("file_name",)),
    r"entry/user\d+": ("NXuser", ()),
    r"entry/sample\d+": ("NXsample", ("is_simulation", "preparation_date", "atom_types")),
    r"entry/measurement": ("NXem_measurement", ("instrument",)),
    r"entry/measurement/instrument": ("NXem_instrument", ("fabrication", "ebeam_column")),
    r"entry/measurement/instrument/fabrication": ("NXfabrication", FABRICATION),
    r"entry/measurement/instrument/ebeam_column": ("NXebeam_column", ()),
    r"entry/measurement/instrument/ebeam_column/electron_source": ("NXsource", ("emitter_type",)),
    r"entry/measurement/instrument/detector\d+": ("NXdetector", ("name",)),
    r"entry/measurement/instrument/sensor_\w+": ("NXsensor", ("value_log",)),
    r"entry/measurement/instrument/sensor_\w+/value_log": ("NXlog", ("time", "value", "time@start", "time@units", "value@units")),
    r"entry/measurement/event_\d+": ("NXem_event_data", ("start_time", "end_time")),
    r"entry/measurement/event_\d+/scan": ("NXcollection", ()),
    r"entry/measurement/event_\d+/instrument": ("NXem_instrument", ("ebeam_column",)),
    r"entry/measurement/event_\d+/instrument/ebeam_column": ("NXebeam_column", ()),
    r"entry/measurement/event_\d+/instrument/ebeam_column/electron_source": ("NXsource", ("voltage", "voltage@units")),
    r"entry/measurement/event_\d+/instrument/ebeam_column/scan_controller": (
        "NXscan_controller",
        ("scan_schema", "dwell_time", "dwell_time@units", "flyback_time@units"),
    ),
    r"entry/measurement/event_\d+/instrument/optics": ("NXem_optical_system", ()),
    r"entry/measurement/event_\d+/image\d+": ("NXimage", ("process",)),
    r"entry/measurement/event_\d+/image\d+/process": ("NXprocess", ("detector_identifier",)),
    r"entry/measurement/event_\d+/image\d+/process/input": ("NXnote", ("type", "file_name", "checksum", "algorithm", "context")),
    r"entry/roi\d+": ("NXroi_process", ()),
    r"entry/roi\d+/(elastic|conventions)": ("NXparameters", ()),
    r"entry/roi\d+/(u|v|exx|eyy|exy|drift|distortion|series)": ("NXdata", ()),
    r"entry/semlive": ("NXcollection", ()),
}
"""Class and required members of each group by the pattern of its path; ``name@attribute`` is an attribute."""
TIMES = ("start_time", "end_time", "preparation_date")


def problems(file: h5py.File) -> Iterator[str]:
    """Yield what a NeXus file lacks, one sentence each."""
    groups: list[h5py.Group] = []
    file.visititems(lambda _, node: groups.append(node) if isinstance(node, h5py.Group) else None)
    for group in groups:
        path = group.name.strip("/")
        rules = [rule for pattern, rule in REQUIRED.items() if re.fullmatch(pattern, path)]
        if len(rules) != 1:
            yield f"{path}: NXem has no such group"
            continue
        expected, members = rules[0]
        if group.attrs["NX_class"] != expected:
            yield f"{path}: is {group.attrs['NX_class']}, not {expected}"
        for member in members:
            name, _, attribute = member.partition("@")
            if name not in group or (attribute and attribute not in group[name].attrs):
                yield f"{path}: {member} is missing"
        for name in TIMES:
            if name in group and datetime.fromisoformat(group[name].asstr()[()]).tzinfo is None:
                yield f"{path}: {name} has no time zone"
        if expected == "NXdata":
            yield from _data_problems(group)


def _data_problems(group: h5py.Group) -> Iterator[str]:
    signal, axes = group[group.attrs["signal"]], list(group.attrs["axes"])
    if len(axes) != signal.ndim:
        yield f"{group.name}: {len(axes)} axes for {signal.ndim} dimensions"
    for name in group:
        dimension = group.attrs.get(f"{name}_indices")
        if dimension is not None and group[name].shape != (signal.shape[int(dimension)],):
            yield f"{group.name}: axis {name} has another length than the signal"
        if name.endswith("_errors") and group[name].shape != group[name.removesuffix("_errors")].shape:
            yield f"{group.name}: {name} has another shape than its field"
    for name in axes:
        if f"{name}_indices" not in group.attrs:
            yield f"{group.name}: {name}_indices is missing"
    for name in group.attrs.get("auxiliary_signals", ()):
        if group[name].shape != signal.shape:
            yield f"{group.name}: {name} has another shape than the signal"
