"""Load samples of the last minutes, and the load during the scan of a frame."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace

from semlive.data.loading import FrameLoad

_CHUNK = 256
_MAX_CHUNKS = 512

Point = tuple[int, float, float | None]


@dataclass(frozen=True, slots=True)
class LoadHistory:
    """Samples (time_ns, force_n, gage_strain) in order of time; the oldest are discarded.

    Stored in chunks, so that adding a sample copies at most 256 samples: a run that polls at 50 Hz stores 90,000.

    Attributes:
        keep_ns: samples older than this may be discarded, ns.
        chunks: full chunks, oldest first.
        tail: the chunk that is being filled.
    """

    keep_ns: int
    chunks: tuple[tuple[Point, ...], ...] = ()
    tail: tuple[Point, ...] = ()

    def with_sample(self, time_ns: int, force_n: float, gage_strain: float | None = None) -> LoadHistory:
        """Return the history with one more sample; a sample that is not later than the last is ignored."""
        if self.tail and time_ns <= self.tail[-1][0]:
            return self
        tail = (*self.tail, (time_ns, force_n, gage_strain))
        if len(tail) <= _CHUNK:
            return replace(self, tail=tail)
        chunks = (*self.chunks, tail[:-1])
        oldest = time_ns - self.keep_ns
        first = max(next((i for i, chunk in enumerate(chunks) if chunk[-1][0] >= oldest), 0), len(chunks) - _MAX_CHUNKS)
        return replace(self, chunks=chunks[first:], tail=tail[-1:])

    def between(self, start_time_ns: int, end_time_ns: int) -> tuple[Point, ...]:
        """Return the available samples from the last one not after the start to the first one not before the end."""
        points = tuple(p for chunk in (*self.chunks, self.tail) if chunk and chunk[-1][0] >= start_time_ns for p in chunk)
        # The previous chunk may hold the last sample before the start.
        earlier = [chunk for chunk in self.chunks if chunk[-1][0] < start_time_ns]
        if earlier:
            points = (*earlier[-1], *points)
        first = max(bisect_right(points, start_time_ns, key=lambda p: p[0]) - 1, 0)
        last = bisect_left(points, end_time_ns, key=lambda p: p[0])
        return points[first : last + 1]


def frame_load(history: LoadHistory, start_time_ns: int, end_time_ns: int) -> FrameLoad | None:
    """Return load and mean strain-gage reading during a scan; None if the samples do not reach back to its start."""
    points = history.between(start_time_ns, end_time_ns)
    if not points or points[0][0] > start_time_ns:
        return None
    forces = [force for _, force, _ in points]
    mean, sd = _mean_sd(forces)
    gage = [strain for _, _, strain in points if strain is not None]
    if not gage:
        return FrameLoad(before_n=forces[0], after_n=forces[-1], mean_n=mean, sd_n=sd)
    strain, strain_sd = _mean_sd(gage)
    return FrameLoad(forces[0], forces[-1], mean, sd, gage_strain=strain, gage_strain_sigma=strain_sd / math.sqrt(len(gage)))


def _mean_sd(values: list[float]) -> tuple[float, float]:
    mean = math.fsum(values) / len(values)
    return mean, math.sqrt(math.fsum((value - mean) ** 2 for value in values) / len(values))
