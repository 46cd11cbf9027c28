"""Frames, drift and distortion of an open log as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from semlive import pipeline
from semlive.api.html import table_html
from semlive.api.libraries import optional_library
from semlive.api.plots import field_figure
from semlive.data.results import FrameResult
from semlive.report.export.fields import frame_fields
from semlive.service.replay.replay import ReplayResult

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Field = NDArray[np.float64]
_POINT_COLUMNS = ("x", "y", "u", "v", "sigma_u", "sigma_v", "exx", "eyy", "exy")


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

    def to_pandas(self) -> pandas.DataFrame:
        """Measured points as a data frame with one row for each point; strain is NaN where the virtual strain gauge was not full enough.

        Raises:
            BadInput: pandas is not installed.
        """
        columns = {name: getattr(self, name)[self.valid] for name in _POINT_COLUMNS}
        strained = self.strain_valid[self.valid]
        columns |= {name: np.where(strained, columns[name], np.nan) for name in ("exx", "eyy", "exy")}
        return optional_library("pandas", "to_pandas").DataFrame(columns)

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        load = "no load frame" if self.load_n is None else f"{self.load_n:.1f} N"
        points = f"{int(self.valid.sum())} of {self.valid.size} points measured"
        means = [(f"mean {name}", f"{value:.3e} ± {self.strain_mean_sigma[name]:.1e}") for name, value in self.strain_mean.items()]
        return table_html(f"frame {self.number}", [("phase", self.phase), ("load", load), ("points", points), *means])


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
        return self._opened(self._entry(number))

    def figure(self, number: int) -> Figure:
        """Displacement and strain of a frame as maps.

        Raises:
            IndexError: there is no such frame.
        """
        return field_figure(self._corrected(self._entry(number)))

    def _entry(self, number: int) -> Mapping[str, Any]:
        """Return the summary of a frame; negative numbers count from the last."""
        if number < 0 and -number <= len(self):
            number = self.numbers[number]
        if number not in self._index:
            raise IndexError(f"there is no frame {number}; the numbers are {self.numbers[0]} ... {self.numbers[-1]}")
        return self._entries[self._index[number]]

    def _opened(self, entry: Mapping[str, Any]) -> OpenFrame:
        frame = self._corrected(entry)
        means = {"strain_mean": entry["strain_mean"], "strain_mean_sigma": entry["strain_mean_sigma"]}
        return OpenFrame(number=entry["frame"], phase=entry["phase"], load_n=entry["load_n"], **frame_fields(frame), **means)

    def _corrected(self, entry: Mapping[str, Any]) -> FrameResult:
        return pipeline.correct_frame(self._done.analysis, self._done.solution, entry["frame"])
