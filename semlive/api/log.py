"""The analysis of a log as Python objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from semlive.api.frames import Distortion, Drift, OpenFrames
from semlive.api.html import constant_rows, table_html
from semlive.api.libraries import optional_library
from semlive.api.plots import FigureKind, run_figure
from semlive.data.loading import LoadSeries
from semlive.errors import BadInput
from semlive.report.export.export import run_metadata
from semlive.report.export.fields import UNITS, RunMetadata, constants, distortion_fields, drift_series, frame_series, phases
from semlive.service.log.image_pairs import frame_of
from semlive.service.replay.replay import ReplayResult

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

Array = NDArray[Any]


class OpenLog:
    """The analysis of a log; returned by `open_log`."""

    def __init__(self, path: Path, done: ReplayResult) -> None:
        self._path, self._done = path, done
        self._metadata: RunMetadata = run_metadata(path, done)
        self.configuration: Mapping[str, Any] = self._metadata.configuration
        """The configuration of the run that the log stores."""
        self.settings: Mapping[str, Any] = self._metadata.settings
        """Every analysis setting by its name, as ``--set`` takes it."""
        self.load: LoadSeries | None = self._metadata.load
        """Load as sampled; None without a load frame."""
        self.frames = OpenFrames(done, self._metadata.result_json["frames"])

    def __repr__(self) -> str:
        grid = self._done.analysis.grid
        points = f"{grid.nx} x {grid.ny} points {grid.step_px} px apart"
        return f"<semlive log {self._path.name}: {len(self._done.result.decisions)} pairs, {points}>"

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        grid, drift = self._done.analysis.grid, self.drift
        rows = [
            ("pairs", str(len(self._done.result.decisions))),
            ("points", f"{grid.nx} x {grid.ny}, {grid.step_px} px apart"),
            ("pixel size", "not in the log" if self.pixel_size_um is None else f"{self.pixel_size_um:.4g} µm"),
            ("drift in the run", f"{np.ptp(drift.dx_px):.2f} px along x, {np.ptp(drift.dy_px):.2f} px along y"),
            *constant_rows(self.elastic),
            *(("warning", text) for text in self.warnings),
        ]
        return table_html(self._path.name, rows)

    @property
    def result(self) -> Mapping[str, Any]:
        """The JSON object of `semlive replay --json`."""
        return self._metadata.result_json

    @property
    def elastic(self) -> Mapping[str, float]:
        """Elastic constants and their uncertainties by name; empty without loads or cross-section."""
        return constants(self._metadata)

    @property
    def pixel_size_um(self) -> float | None:
        """Edge of a pixel on the specimen, µm; None if the log does not contain it. Multiply positions and displacements in px by it."""
        size_m = self._done.result.decisions[0].first.pixel_size_m.value
        return 1e6 * size_m if size_m > 0 else None

    @property
    def warnings(self) -> Sequence[str]:
        """Messages for the operator."""
        return self.result["warnings"]

    @cached_property
    def drift(self) -> Drift:
        """Drift over scan time."""
        return Drift(**{name: array for name, array in drift_series(self._done.result).items() if name in Drift.__slots__})

    @cached_property
    def distortion(self) -> Distortion:
        """Distortion of the raster."""
        return Distortion(**distortion_fields(self._done.result))

    @property
    def series(self) -> dict[str, Array]:
        """(frames,) columns: when, phase, load, shift, mean strain with its uncertainty; ``pandas.DataFrame(log.series)``."""
        return {**frame_series(self._metadata), "phase": np.array(phases(self._metadata))}

    def image(self, frame: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """The SEM image of a frame: (height, width) grey levels as exported, without databar, read-only.

        The log is read up to this frame.

        Raises:
            BadInput: there is no such frame, or the log has no images.
            BadImage: its file cannot be read.
        """
        found = frame_of(self._path, self._done.settings.scan, frame)
        if found is None:
            raise BadInput(
                f"image({frame}): the log has no image of this frame; frames are {self.frames.numbers[0]} to {self.frames.numbers[-1]}."
            )
        return found.image

    def plot(self, kind: FigureKind, frame: int | None = None) -> Figure:
        """Draw one of the standard figures of a run.

        Args:
            kind: ``load``, ``drift``, ``distortion`` or ``stress_strain`` of the run, or ``fields`` of a frame.
            frame: number of the frame, for ``fields`` only; the last frame by default.

        Returns:
            A matplotlib figure; a notebook shows it.

        Raises:
            BadInput: there is no such figure, or the log has no data for it.
            IndexError: there is no such frame.
        """
        return self.frames.figure(-1 if frame is None else frame) if kind == "fields" else run_figure(kind, self._metadata)

    def to_pandas(self) -> pandas.DataFrame:
        """`series` as a data frame with one row for each frame, by number.

        Raises:
            BadInput: pandas is not installed.
        """
        return optional_library("pandas", "to_pandas").DataFrame(self.series).set_index("frame")

    def to_xarray(self, frames: Sequence[int] | None = None) -> xarray.Dataset:
        """Fields over (frame, y, x), NaN where not measured, with units as attributes; with the pixel size also coordinates in µm.

        Args:
            frames: numbers of the frames; all of them by default, which all fit into memory then.

        Raises:
            BadInput: xarray is not installed.
        """
        library = optional_library("xarray", "to_xarray")
        numbers = list(self.frames.numbers if frames is None else frames)
        grid, place = self._done.analysis.grid, {number: at for at, number in enumerate(self.frames.numbers)}
        names = ("u", "v", "sigma_u", "sigma_v", "exx", "eyy", "exy")
        fields = {name: np.full((len(numbers), *grid.shape), np.nan) for name in names}
        for at, number in enumerate(numbers):
            frame = self.frames[number]
            for name in names:
                inside = frame.strain_valid if name.startswith("e") else frame.valid
                fields[name][at][inside] = getattr(frame, name)[inside]
        data = {name: (("frame", "y", "x"), values, {"units": UNITS[name]}) for name, values in fields.items()}
        along = {name: ("frame", column[[place[one] for one in numbers]]) for name, column in self.series.items() if name != "frame"}
        axes, size_um = {"y": grid.y_px, "x": grid.x_px}, self.pixel_size_um
        places = {name: (name, values, {"units": "px"}) for name, values in axes.items()}
        if size_um is not None:
            places |= {f"{name}_um": (name, size_um * values, {"units": "um"}) for name, values in axes.items()}
        return library.Dataset(data, {"frame": numbers, **places, **along}, {"log": self._path.name, **self.elastic})
