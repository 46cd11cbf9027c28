"""A log for Python: arrays, series and configuration.

log = semlive.open_log("my-run.mcap")
log.frames[7].u                 # (ny, nx) corrected displacement in px
log.drift.time_s, log.drift.dx_px
log.to_xarray().eyy.sel(frame=7).plot()
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from semlive import pipeline
from semlive.data.loading import LoadSeries
from semlive.data.results import FrameResult
from semlive.errors import BadInput
from semlive.report.export.export import run_metadata
from semlive.report.export.fields import UNITS, RunMetadata, constants, distortion_fields, drift_series, frame_fields, frame_series, phases
from semlive.service.config.overrides import parse_changes
from semlive.service.log.pairs import has_images
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, Source, replay, require_calibration

if TYPE_CHECKING:
    import xarray

Array = NDArray[Any]
Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Drift over scan time, relative to the start of frame 0.

    Attributes:
        time_s: (n,) seconds after the start of frame 0.
        frame: (n,) number of the frame.
        dx_px: (n,) along x.
        dy_px: (n,) along y.
        sigma_px: (n,) standard uncertainty, the larger of the two components'.
    """

    time_s: Field
    frame: NDArray[np.int64]
    dx_px: Field
    dy_px: Field
    sigma_px: Field


@dataclass(frozen=True, slots=True, eq=False)
class Distortion:
    """Distortion of the raster over the scan address; all (ny, nx), px."""

    x: Field
    y: Field
    dx_px: Field
    dy_px: Field
    sigma_px: Field
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class OpenFrame:
    """One corrected frame, relative to frame 0; fields are (ny, nx), zero and meaningless where not `valid`.

    Attributes:
        number: 2 * pair + 0 or 1.
        phase: ``calibration``, ``translation`` or ``tension``.
        load_n: mean load in N; None without a load frame.
        x: px in frame 0.
        y: px in frame 0.
        u: corrected displacement along x, px.
        v: corrected displacement along y, px.
        sigma_u: standard uncertainty of u, px.
        sigma_v: standard uncertainty of v, px.
        exx: strain by the measure of the settings (``estimate.strain.measure``: engineering by default), tension positive.
        eyy: likewise.
        exy: tensor shear.
        valid: where displacement was measured.
        strain_valid: where the virtual strain gauge was full enough.
        strain_mean: mean strain by component.
        strain_mean_sigma: its standard uncertainty.
    """

    number: int
    phase: str
    load_n: float | None
    x: Field
    y: Field
    u: Field
    v: Field
    sigma_u: Field
    sigma_v: Field
    exx: Field
    eyy: Field
    exy: Field
    valid: NDArray[np.bool_]
    strain_valid: NDArray[np.bool_]
    strain_mean: Mapping[str, float]
    strain_mean_sigma: Mapping[str, float]


class OpenFrames(Sequence[OpenFrame]):
    """Frames by number. A frame is corrected when it is accessed, so that memory holds only the frames that the caller keeps."""

    def __init__(self, done: ReplayResult, entries: Sequence[Mapping[str, Any]]) -> None:
        self._done, self._entries = done, entries
        self._index = {entry["frame"]: index for index, entry in enumerate(entries)}

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of all frames in ascending order, without the frames of pairs that were not accepted."""
        return tuple(self._index)

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[OpenFrame]:
        return (self[number] for number in self._index)

    @overload
    def __getitem__(self, number: int) -> OpenFrame: ...

    @overload
    def __getitem__(self, number: slice) -> list[OpenFrame]: ...

    def __getitem__(self, number: int | slice) -> OpenFrame | list[OpenFrame]:
        """The frame of a number; negative ones count from the last, slices give lists.

        Raises:
            IndexError: there is no such frame.
        """
        if isinstance(number, slice):
            return [self[selected] for selected in self.numbers[number]]
        if number < 0 and -number <= len(self):
            number = self.numbers[number]
        if number not in self._index:
            raise IndexError(f"there is no frame {number}; the numbers are {self.numbers[0]} ... {self.numbers[-1]}")
        return self._opened(self._entries[self._index[number]])

    def _opened(self, entry: Mapping[str, Any]) -> OpenFrame:
        frame: FrameResult = pipeline.correct_frame(self._done.analysis, self._done.solution, entry["frame"])
        means = {"strain_mean": entry["strain_mean"], "strain_mean_sigma": entry["strain_mean_sigma"]}
        return OpenFrame(number=entry["frame"], phase=entry["phase"], load_n=entry["load_n"], **frame_fields(frame), **means)


class OpenLog:
    """The analysis of a log; returned by `open_log`."""

    def __init__(self, path: Path, done: ReplayResult) -> None:
        self._path, self._done = path, done
        self._metadata: RunMetadata = run_metadata(path, done)
        self.frames = OpenFrames(done, self._metadata.result_json["frames"])

    def __repr__(self) -> str:
        grid = self._done.analysis.grid
        points = f"{grid.nx} x {grid.ny} points {grid.step_px} px apart"
        return f"<semlive log {self._path.name}: {len(self._done.result.decisions)} pairs, {points}>"

    @property
    def result(self) -> Mapping[str, Any]:
        """The JSON object of `semlive replay --json`."""
        return self._metadata.result_json

    @property
    def configuration(self) -> Mapping[str, Any]:
        """The configuration of the run that the log stores."""
        return self._metadata.configuration

    @property
    def settings(self) -> Mapping[str, Any]:
        """Every analysis setting by its name, as ``--set`` takes it."""
        return self._metadata.settings

    @property
    def load(self) -> LoadSeries | None:
        """Load as sampled; None without a load frame."""
        return self._metadata.load

    @property
    def elastic(self) -> Mapping[str, float]:
        """Elastic constants and their uncertainties by name; empty without loads or cross-section."""
        return constants(self._metadata)

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

    def to_xarray(self, frames: Sequence[int] | None = None) -> xarray.Dataset:
        """Fields over (frame, y, x), NaN where not measured, with units as attributes.

        Args:
            frames: numbers of the frames; all of them by default, which all fit into memory then.

        Raises:
            BadInput: xarray is not installed.
        """
        try:
            import xarray  # noqa: PLC0415
        except ImportError:
            raise BadInput("to_xarray: xarray is not installed; pip install semlive[xarray].") from None
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
        return xarray.Dataset(data, {"frame": numbers, "y": grid.y_px, "x": grid.x_px, **along}, {"log": self._path.name, **self.elastic})


def open_log(path: str | Path, *, method: str | None = None, changes: Sequence[str] = (), from_images: bool = False) -> OpenLog:
    """Open a log for Python; its disparity maps are read and the estimate is made from them, seconds for some tens of pairs.

    Args:
        path: one MCAP file, or a run folder of segments.
        method: of estimation, ``joint`` or ``sutton2007``; by default the log's own.
        changes: of settings, as in ``["estimate.window=15"]``.
        from_images: correlate the images again.

    Raises:
        BadInput: the log cannot be read, or a setting is wrong.
        PoorCalibration: the run has load steps, and its translations do not determine the distortion;
            ``changes=["estimate.accept_poor_calibration=true"]`` opens it all the same.
    """
    log, parsed = Path(path), parse_changes(changes)
    images = from_images or any(change.of_images for change in parsed)
    source = Source.IMAGES if images and has_images(log) else Source.DISPARITY
    done = replay(ReplayRequest(log, method, parsed, source), ReplayCallbacks(frame=lambda _: None))
    require_calibration(log, done)
    return OpenLog(log, done)
