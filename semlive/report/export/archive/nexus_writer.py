"""NeXus with the application definition NXem: microscope, scan timing, load, corrected fields with uncertainties, provenance.

Definition: https://fairmat-nfdi.github.io/nexus_definitions/classes/applications/NXem.html
"""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np

from semlive.data.results import FrameResult
from semlive.data.settings import MEASURES
from semlive.report.export import fields
from semlive.report.export.archive.deposit import UNKNOWN
from semlive.report.export.archive.nexus_fields import FieldStacks
from semlive.report.export.archive.nexus_microscope import SAMPLE, add_measurement, frame_infos
from semlive.report.export.archive.nexus_nodes import Value, add_data, add_field, add_group, iso_time
from semlive.report.export.archive.provenance import ExportProvenance
from semlive.report.export.fields import PartFile, RunMetadata, storable

_IDENTIFIER_TYPES = frozenset(("ARK", "DOI", "Hdl", "IGSN", "ISNI", "ISSN", "ISSN-L", "ORCID", "PURL", "ROR", "URL", "URN"))
"""Kinds of identifiers that NeXus lists; others are marked as custom."""


class NexusWriter:
    """One file.

    ``/entry/measurement`` is the microscope with one event for each frame; ``/entry/roi1`` holds the fields: groups NXdata ``u``, ``v``,
    ``exx``, ``eyy``, ``exy`` over (frame, y, x), NaN where not measured, ``drift``, ``distortion``, ``series`` and ``elastic``.
    """

    def __init__(self, out: Path) -> None:
        self._part = PartFile(out)
        self._part.path.unlink(missing_ok=True)
        self._file = h5py.File(self._part.path, "w")
        self._file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": "semlive", "creator_version": version("semlive")})
        self._entry = add_group(self._file, "entry", "NXentry")
        self._roi = add_group(
            self._entry, "roi1", "NXroi_process", program="semlive", version=version("semlive"), sequence_index=np.int64(1)
        )
        self._stacks = FieldStacks(self._roi)

    def write_frame(self, frame: FrameResult) -> None:
        """Append one frame to the stacks."""
        self._stacks.append(frame.summary.frame, fields.frame_fields(frame))

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write axes, series, estimate, microscope and provenance."""
        provenance = metadata.provenance
        if provenance is None:
            raise ValueError("an export to NeXus needs the provenance")
        self._add_axes(metadata)
        self._add_estimate(metadata)
        self._add_run(metadata, provenance)
        add_measurement(self._entry, metadata, provenance)
        add_group(
            self._entry,
            "semlive",
            "NXcollection",
            format_version=np.int64(fields.FORMAT_VERSION),
            configuration=json.dumps(metadata.configuration),
            settings=json.dumps(metadata.settings),
            result=json.dumps(metadata.result_json),
        )

    def close(self, complete: bool) -> None:
        """Rename the complete file to its final name, or remove an incomplete one."""
        self._file.close()
        self._part.finish(complete)

    def _add_axes(self, metadata: RunMetadata) -> None:
        """Add the axes of the stacks, and choose the default plot: the strain along the load."""
        infos, grid = frame_infos(metadata), metadata.result.estimate.distortion.grid
        size_um = 1e6 * infos[min(infos)].pixel_size_m.value
        self._stacks.finish(grid.x_px, grid.y_px, size_um if size_um > 0 else None)
        axis = metadata.settings["specimen.loading_axis"]
        self._roi.attrs["default"] = f"e{axis}{axis}"
        self._entry.attrs["default"] = "roi1"

    def _add_estimate(self, metadata: RunMetadata) -> None:
        """Add drift, distortion, series of the frames and elastic constants."""
        drift = fields.drift_series(metadata.result)
        add_data(
            self._roi,
            "drift",
            ("time",),
            {
                "dx": (drift["dx_px"], "px"),
                "dx_errors": (drift["sigma_dx_px"], "px"),
                "dy": (drift["dy_px"], "px"),
                "dy_errors": (drift["sigma_dy_px"], "px"),
                "frame": (drift["frame"], ""),
            },
            {"time": (drift["time_s"], "s")},
        )
        bent = fields.distortion_fields(metadata.result)
        add_data(
            self._roi,
            "distortion",
            ("y", "x"),
            {
                "dx": (bent["dx_px"], "px"),
                "dx_errors": (bent["sigma_px"], "px"),
                "dy": (bent["dy_px"], "px"),
                "dy_errors": (bent["sigma_px"], "px"),
                "valid": (storable(bent["valid"]), ""),
            },
            {"y": (bent["y"][:, 0].astype(np.float64), "px"), "x": (bent["x"][0, :].astype(np.float64), "px")},
        )
        series = fields.frame_series(metadata)
        numbers = series.pop("frame")
        signals = {_series_name(name): (values, fields.UNITS.get(name, "1")) for name, values in series.items()}
        axis = metadata.settings["specimen.loading_axis"]
        default = f"e{axis}{axis}_mean"
        ordered: dict[str, tuple[Value, str]] = {default: signals.pop(default), **signals}
        group = add_data(self._roi, "series", ("frame",), ordered, {"frame": (numbers, "")})
        add_field(group, "phase", fields.phases(metadata))
        _add_elastic(self._roi, fields.constants(metadata))
        measure = MEASURES[metadata.settings["estimate.strain.measure"]]
        add_group(
            self._roi,
            "conventions",
            "NXparameters",
            coordinates="x right, y down, pixels of frame 0; displacement from frame 0; NaN where not measured",
            strain=f"{measure}, tension positive; exy is the tensor shear",
            uncertainties="u_errors and v_errors are standard uncertainties; u_systematic and v_systematic are their common part",
            noise_floor=(float(metadata.result_json["noise_floor_px"]), "px"),
        )

    def _add_run(self, metadata: RunMetadata, provenance: ExportProvenance) -> None:
        """Add times, persons, specimen and programs."""
        entry, deposit = self._entry, provenance.deposit
        definition = add_field(entry, "definition", "NXem")
        assert definition is not None
        definition.attrs["URL"] = "https://fairmat-nfdi.github.io/nexus_definitions/classes/applications/NXem.html"
        infos = frame_infos(metadata).values()
        add_field(entry, "start_time", iso_time(min(info.start_time_ns.value for info in infos)))
        add_field(entry, "end_time", iso_time(max(info.end_time_ns for info in infos)))
        add_field(entry, "experiment_alias", metadata.name)
        add_field(entry, "experiment_description", deposit.description)
        profiling = add_group(entry, "profiling", "NXcs_profiling")
        program = add_group(profiling, "program1", "NXprogram", program="semlive export")
        program["program"].attrs["version"] = provenance.semlive
        for number, file in enumerate(provenance.log, 1):
            note = add_group(entry, f"note{number}", "NXnote", type="application/x-mcap", file_name=file.name, algorithm="sha256")
            add_field(note, "checksum", file.sha256)
        for number, person in enumerate(deposit.people, 1):
            user = add_group(entry, f"user{number}", "NXuser", **person.model_dump(exclude={"orcid", "affiliation_address"}))
            identifier = add_field(user, "identifier_orcid", person.orcid)
            if identifier is not None:
                identifier.attrs["type"] = "ORCID"
        sample = deposit.sample
        group = add_group(
            entry,
            SAMPLE,
            "NXsample",
            is_simulation=bool((metadata.configuration.get("run") or {}).get("clock_file")),
            name=sample.name or metadata.settings["specimen.name"] or None,
            atom_types=sample.atom_types or UNKNOWN,
            preparation_date=sample.preparation_date and sample.preparation_date.isoformat(),
            physical_form=sample.physical_form,
            description=sample.description,
        )
        identifier = add_field(group, "identifier_sample", sample.identifier)
        if identifier is not None:
            identifier.attrs["type"] = sample.identifier_type
            if sample.identifier_type not in _IDENTIFIER_TYPES:
                identifier.attrs["type_custom"] = True


def _add_elastic(roi: h5py.Group, constants: dict[str, float]) -> None:
    units = {"youngs_modulus_gpa": ("youngs_modulus", "GPa"), "poissons_ratio": ("poissons_ratio", "1")}
    present = {key: name for key, name in units.items() if key in constants}
    if present:
        group = add_group(roi, "elastic", "NXparameters", **{name: (constants[key], unit) for key, (name, unit) in present.items()})
        for key, (name, _) in present.items():
            group[name].attrs["error"] = constants[f"{key}_sigma"]


def _series_name(name: str) -> str:
    """Name of a series: uncertainties end in `_errors`, as NeXus names them, and units are attributes."""
    for suffix in ("_n", "_s", "_px"):
        name = name.removesuffix(suffix)
    return name.replace("_sigma", "_errors")
