"""Waves and jitter of the rows: which of them are stated, and what they add to the uncertainty of other figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import IdentifiedEffect, ParameterEstimate
from semlive.diagnose.rows.series import RowSeries
from semlive.qualify.figures.row_response import Pattern, RowResponse
from semlive.qualify.values import Figure, Result

Array = NDArray[np.float64]
MIN_SHARE = 0.08
"""Smallest amplitude relative to the strongest one that is stated. A wave along y moves rows against each other, which makes waves of up to
5 % of its amplitude at other frequencies; jitter of 0.27 px along x was measured with 0.005 px along y.
"""
ADJACENT_LINES, MIN_SHARE_ADJACENT = 2.0, 0.5
"""Distance in the spectrum of the rows, in cycles per frame, within which part of a wave appears at another frequency, and the smallest
share that is stated there: a vibration of 0.61 px at 37.2 Hz appeared with 0.05 px at 143.2 Hz, whose alias is 1.2 cycles away.
"""
MIN_EXCESS, MIN_JITTER_EXCESS = 2.0, 4.0
"""Smallest amplitude and smallest jitter relative to those which the strongest wave causes in pairs of texture. Jitter contains the waves
that are too weak to be found: a hum of 0.32 px caused 0.017 px, and 0.006 px in texture.
"""
ALIAS_ERROR = 1e-3
"""Error of a frequency in widths of a spectral line, times the cycles per row of its alias. The removal of the trend over 43 rows displaces
slow waves: 50 Hz at 3.05 cycles per row were found at 49.9994 Hz with a stated uncertainty of 0.0001 Hz and a line of 0.037 Hz.
"""
DRIFT_BIAS_PER_PX = 0.15
"""Standard uncertainty of the mean motion within a pair per squared amplitude of a wave, 1/px: 60 Hz with 0.21 px along y moved the mean of
all nine pairs by 0.011 px, and 50 Hz with 0.40 px along x by 0.036 px.
"""


@dataclass(frozen=True, slots=True)
class StatedWave:
    """A wave of an effect: frequency, and amplitudes along x and y."""

    frequency: ParameterEstimate
    along_x: ParameterEstimate
    along_y: ParameterEstimate

    @property
    def size_px(self) -> float:
        """Amplitude."""
        return float(np.hypot(self.along_x.value, self.along_y.value))


def waves_of(effect: IdentifiedEffect) -> list[StatedWave]:
    """The waves of an effect of the rows."""
    return [StatedWave(*effect.parameters[at : at + 3]) for at in range(0, len(effect.parameters) - 2, 3)]


def stated_waves(effect: IdentifiedEffect, effects: Sequence[IdentifiedEffect], pairs: RowPairs) -> list[StatedWave]:
    """The waves of an effect that are not a consequence of the strongest wave of all effects."""
    strongest = max((wave for one in effects if is_wave(one) for wave in waves_of(one)), key=lambda wave: wave.size_px)
    return [wave for wave in waves_of(effect) if wave is strongest or _is_stated(wave, strongest, pairs)]


def _is_stated(wave: StatedWave, strongest: StatedWave, pairs: RowPairs) -> bool:
    share = wave.size_px / strongest.size_px
    lines = abs(pairs.alias_cycles(wave.frequency.value) - pairs.alias_cycles(strongest.frequency.value))
    consequence_px = 0.0 if pairs.response is None else pairs.response.consequence_px(wave.frequency.value)
    return share >= (MIN_SHARE if lines > ADJACENT_LINES else MIN_SHARE_ADJACENT) and wave.size_px > MIN_EXCESS * consequence_px


def is_beyond_response(jitter: IdentifiedEffect, pairs: RowPairs) -> bool:
    """Whether jitter of the rows is larger than that which the registration makes of the strongest wave."""
    size_px = float(np.linalg.norm([parameter.value for parameter in jitter.parameters]))
    return pairs.response is None or size_px > MIN_JITTER_EXCESS * float(np.linalg.norm(pairs.response.jitter_px))


def strongest_wave_px(effects: Sequence[IdentifiedEffect]) -> float:
    """Largest amplitude of a wave of the rows; 0 without."""
    return max((wave.size_px for effect in effects if is_wave(effect) for wave in waves_of(effect)), default=0.0)


def row_motion_px(row_effects: Sequence[IdentifiedEffect]) -> float:
    """Largest displacement by waves and jitter of the rows; 0 without."""
    return max((effect.peak_px for effect in row_effects), default=0.0)


def certain_effects(map_effects: Sequence[IdentifiedEffect], row_effects: Sequence[IdentifiedEffect]) -> tuple[IdentifiedEffect, ...]:
    """Effects of the maps that are larger than the motion of the rows.

    Smaller ones may be caused by it: five of seven random microscopes with waves or jitter of 0.09 to 0.8 px had such effects, a wrong row
    time or a charge among them, of 0.03 to 0.11 px, which were not there.
    """
    return tuple(effect for effect in map_effects if effect.peak_px > row_motion_px(row_effects))


def is_wave(effect: IdentifiedEffect) -> bool:
    """Whether an effect of the rows is periodic."""
    return effect.parameters[0].unit == "Hz"


@dataclass(frozen=True, slots=True)
class RowMotion:
    """Motion of the rows by the strongest wave and by jitter, and what it adds to the uncertainty of other figures.

    Attributes:
        wave_px: amplitude of the strongest wave.
        jitter_px: standard deviation of the jitter.
        rows: number of rows of a frame.
    """

    wave_px: float
    jitter_px: float
    rows: int

    @classmethod
    def of(cls, results: Sequence[Result], rows: int) -> RowMotion:
        """From the figures of the rows."""
        sizes: dict[str, list[float]] = {}
        for result in results:
            if isinstance(result, Figure) and result.unit == "px":
                sizes.setdefault(result.name[: -len("_x_px")], []).append(result.value)
        jitter, waves = [0.0], [0.0]
        for name, both in sizes.items():
            (jitter if name.endswith("_sd") else waves).append(float(np.linalg.norm(both)))
        return cls(max(waves), max(jitter), rows)

    @property
    def mean_sigma_px(self) -> float:
        """Standard uncertainty of the mean motion between two frames; points of one row move together."""
        return float(np.hypot(DRIFT_BIAS_PER_PX * self.wave_px**2, np.sqrt(2.0 / self.rows) * self.jitter_px))


AT_REST = RowMotion(0.0, 0.0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class RowPairs:
    """Rows of the pairs.

    Attributes:
        series: row series of each pair.
        interval_s: (k,) from the start of the first frame to that of the second; 0 if it is unknown.
        moved_px: (k, 2) mean motion along x and y from the first frame to the second.
        response: of the row registration to the strongest wave; None without a wave.
        pattern: of the first frame; None if it is not needed.
    """

    series: Sequence[RowSeries]
    interval_s: Array
    moved_px: Array
    response: RowResponse | None = None
    pattern: Pattern | None = None

    def frequency_sigma_hz(self, frequency: ParameterEstimate) -> float:
        """Standard uncertainty of a frequency, with the error of slow aliases."""
        longest = max(self.series, key=lambda one: one.duration_s)
        per_row = frequency.value * longest.row_time_s
        alias = max(abs(per_row - round(per_row)), ALIAS_ERROR)
        return float(np.hypot(frequency.sigma, ALIAS_ERROR / alias / longest.duration_s))

    def alias_cycles(self, frequency_hz: float) -> float:
        """Cycles per frame with which the rows sample a wave, whatever its direction."""
        longest = max(self.series, key=lambda one: one.duration_s)
        per_row = frequency_hz * longest.row_time_s
        return abs(per_row - round(per_row)) * longest.duration_s / longest.row_time_s

    def turns(self, frequency_hz: float) -> Array:
        """(k,) phase of a wave in the second frame minus that in the first at the same points, turns.

        Rows sample the wave, so that a motion by a row changes the phase by that of its alias.
        """
        row_s, dwell_s = (np.array([getattr(one, name) for one in self.series]) for name in ("row_time_s", "dwell_time_s"))
        per_row = frequency_hz * row_s
        alias = per_row - np.round(per_row)
        by_rows = alias * self.moved_px[:, 1]
        if self.pattern is not None:
            by_rows = np.array([self.pattern.turned(*one) for one in zip(alias.tolist(), self.moved_px[:, 1].tolist(), strict=True)])
        return np.asarray(frequency_hz * (self.interval_s + dwell_s * self.moved_px[:, 0]) + by_rows)
