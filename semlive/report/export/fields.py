"""Exported fields, series and units, equal in every format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from semlive.data.loading import LoadSeries
from semlive.data.results import FrameResult, RunResult
from semlive.report.export.archive.provenance import ExportProvenance

Array = NDArray[Any]
FORMAT_VERSION = 1
UNITS: Mapping[str, str] = {
    "x": "px",
    "y": "px",
    "u": "px",
    "v": "px",
    "sigma_u": "px",
    "sigma_v": "px",
    "systematic_u": "px",
    "systematic_v": "px",
    "exx": "1",
    "eyy": "1",
    "exy": "1",
    "valid": "1",
    "strain_valid": "1",
    "time_s": "s",
    "time_ns": "ns",
    "start_s": "s",
    "dx_px": "px",
    "dy_px": "px",
    "sigma_px": "px",
    "sigma_dx_px": "px",
    "sigma_dy_px": "px",
    "force_n": "N",
    "load_n": "N",
    "extension_mm": "mm",
    "shift_x_px": "px",
    "shift_y_px": "px",
}
"""Units by name; other quantities are dimensionless."""


@dataclass(frozen=True, slots=True)
class PartFile:
    """A file that is written under another name until it is complete.

    Attributes:
        out: its finished name.
    """

    out: Path

    @property
    def path(self) -> Path:
        """Its name while it is written."""
        return self.out.with_name(self.out.name + ".part")

    def finish(self, complete: bool) -> None:
        """Rename the complete file, or delete an incomplete one."""
        if complete:
            self.path.replace(self.out)
        else:
            self.path.unlink(missing_ok=True)


def storable(array: Array) -> Array:
    """Return an array of a type that all formats store: masks as 0 and 1."""
    return array.astype(np.uint8) if array.dtype == np.bool_ else array


class Format(StrEnum):
    """Formats of an export."""

    HDF5 = "hdf5"
    CSV = "csv"
    MAT = "mat"
    VTK = "vtk"
    VTU = "vtu"
    PNG = "png"
    NEXUS = "nexus"
    RO_CRATE = "ro-crate"


@dataclass(frozen=True, slots=True, eq=False)
class RunMetadata:
    """Metadata of a run.

    Attributes:
        name: name of the log.
        result: estimate, decisions and summaries.
        result_json: the result as `semlive replay --json` prints it.
        settings: every setting by its full name.
        configuration: configuration of the run from the log.
        load: load as sampled, None without a load frame.
        provenance: files, versions and description, for formats that archive a run; None for the others.
    """

    name: str
    result: RunResult
    result_json: Mapping[str, Any]
    settings: Mapping[str, Any]
    configuration: Mapping[str, Any]
    load: LoadSeries | None
    provenance: ExportProvenance | None = None


class Writer(Protocol):
    """Writer of one export: every frame in turn, then the metadata."""

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame."""
        ...

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write series, estimate and configuration."""
        ...

    def close(self, complete: bool) -> None:
        """Finish the export; an incomplete file is removed."""
        ...


def frame_fields(frame: FrameResult) -> dict[str, Array]:
    """(ny, nx) fields of a frame by name; zero and meaningless where not `valid`, strain where not `strain_valid`."""
    moved, strain = frame.displacement, frame.strain
    x, y = moved.grid.mesh()
    systematic_fields = {"systematic_u": moved.systematic_u_px, "systematic_v": moved.systematic_v_px}
    return {
        "x": x,
        "y": y,
        "u": moved.u_px,
        "v": moved.v_px,
        "exx": strain.exx,
        "eyy": strain.eyy,
        "exy": strain.exy,
        "sigma_u": np.where(moved.valid, moved.sigma_u_px, 0.0),
        "sigma_v": np.where(moved.valid, moved.sigma_v_px, 0.0),
        "valid": moved.valid,
        "strain_valid": strain.valid,
        **{name: np.where(moved.valid, sigma, 0.0) for name, sigma in systematic_fields.items() if sigma is not None},
    }


def drift_series(result: RunResult) -> dict[str, Array]:
    """Drift over scan time; `sigma_px` is the larger of the two components'."""
    drift = result.estimate.drift
    return {
        "time_s": drift.time_s,
        "frame": drift.frame,
        "dx_px": drift.drift_px[:, 0],
        "dy_px": drift.drift_px[:, 1],
        "sigma_px": drift.sigma_px.max(axis=1),
        "sigma_dx_px": drift.sigma_px[:, 0],
        "sigma_dy_px": drift.sigma_px[:, 1],
    }


def distortion_fields(result: RunResult) -> dict[str, Array]:
    """(ny, nx) distortion over the scan address."""
    field = result.estimate.distortion
    x, y = field.grid.mesh()
    return {"x": x, "y": y, "dx_px": field.ex_px, "dy_px": field.ey_px, "sigma_px": field.sigma_px, "valid": field.valid}


def load_series(load: LoadSeries) -> dict[str, Array]:
    """Load as sampled."""
    fields: dict[str, Array] = {"time_ns": load.time_ns, "force_n": load.force_n, "extension_mm": load.extension_mm}
    return fields if load.gage_strain is None else {**fields, "gage_strain": load.gage_strain}


def frame_series(metadata: RunMetadata) -> dict[str, Array]:
    """(frames,) series by name: scan time, load, shift, mean strain with its uncertainty; NaN without a value."""
    decisions = {decision.pair: decision for decision in metadata.result.decisions}
    infos = [
        (decisions[entry["pair"]].first, decisions[entry["pair"]].second)[entry["frame"] % 2] for entry in metadata.result_json["frames"]
    ]
    zero_ns = infos[0].start_time_ns.value
    frames = metadata.result_json["frames"]
    series: dict[str, Array] = {
        "frame": np.array([frame["frame"] for frame in frames]),
        "pair": np.array([frame["pair"] for frame in frames]),
        "start_s": np.array([(info.start_time_ns.value - zero_ns) / 1e9 for info in infos]),
        "load_n": np.array([np.nan if frame["load_n"] is None else frame["load_n"] for frame in frames]),
        "gage_strain": np.array([np.nan if frame["gage_strain"] is None else frame["gage_strain"] for frame in frames]),
        "shift_x_px": np.array([frame["shift_px"][0] for frame in frames]),
        "shift_y_px": np.array([frame["shift_px"][1] for frame in frames]),
    }
    for key, name in (("strain_mean", "{}_mean"), ("strain_mean_sigma", "{}_mean_sigma"), ("strain_sd", "{}_sd")):
        for component in ("exx", "eyy", "exy"):
            series[name.format(component)] = np.array([frame[key][component] for frame in frames])
    for component in ("exx", "eyy", "exy"):
        systematic = ((frame["strain_mean_systematic"] or {}).get(component, np.nan) for frame in frames)
        series[f"{component}_mean_systematic"] = np.fromiter(systematic, dtype=np.float64)
    return series


def phases(metadata: RunMetadata) -> list[str]:
    """The phase of each frame."""
    return [entry["phase"] for entry in metadata.result_json["frames"]]


def constants(metadata: RunMetadata) -> dict[str, float]:
    """Elastic constants and their standard uncertainties; empty where they are not known."""
    elastic = metadata.result_json["elastic"] or {}
    return {name if part == "value" else f"{name}_sigma": value[part] for name, value in elastic.items() for part in ("value", "sigma")}
