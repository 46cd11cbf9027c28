"""Scan: interval of frames against the stated frame time, waves and jitter of rows, settling at the row start, effects of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import IdentifiedEffect, Outcome, ParameterEstimate
from semlive.data.frame import FrameInfo
from semlive.data.scan import Provenance
from semlive.qualify.intervals import NORMAL_95
from semlive.qualify.values import Figure, Result, Trend, Undetermined

STATED_TIMES = (Provenance.FILE, Provenance.DERIVED)
TIMES_REMEDY = "export files that contain dwell, row and frame time and the time of the scan, or give them in frames.csv"
ROWS_REMEDY = "take pairs of at least 100 rows, one right after the other"


def interval_results(pairs: Sequence[tuple[FrameInfo, FrameInfo]]) -> list[Result]:
    """Interval of the frames of a pair in units of the stated frame time: 1 for a continuous scan, and never less.

    A ratio below 1 proves a wrong frame or row time. A larger ratio is a pause between the frames, or a row time that is too short in the
    file; a second dwell separates both, because the pause does not change with the dwell.
    """
    first = pairs[0][0]
    times = (first.start_time_ns.source, first.timing.frame_time_s.source)
    if any(source not in (*STATED_TIMES, Provenance.CONFIG) for source in times):
        return [Undetermined("frame_interval", "the files do not contain the times of the scans", TIMES_REMEDY)]
    ratio, sigma = [], []
    for before, after in pairs:
        duration_s = before.timing.duration_s
        ratio.append((after.start_time_ns.value - before.start_time_ns.value) * 1e-9 / duration_s)
        sigma.append(np.hypot(before.start_sigma_s, after.start_sigma_s) / duration_s)
    value, error = float(np.median(ratio)), NORMAL_95 * float(np.median(sigma)) / np.sqrt(len(ratio))
    note = "interval of the frames of a pair in units of the frame time in the file; below 1 the row time in the file is too long"
    return [Figure("frame_interval", "frame interval", value, value - error, value + error, "", Trend.NONE, note)]


def row_results(rows: RowDiagnosis | None, reason: str) -> list[Result]:
    """Frequencies and amplitudes of waves, and jitter, of the rows; or why they are not determined.

    Args:
        rows: verdict on the rows; None without one.
        reason: why there is no verdict.
    """
    if rows is None:
        return [Undetermined("rows", reason, ROWS_REMEDY)]
    if rows.outcome is Outcome.NONE:
        p_value = min((test.p_value for test in rows.where), default=1.0)
        return [
            Undetermined(
                "row_waves", f"no hum, vibration or row jitter is significant (p = {p_value:.2g})", "none is needed", by_pairs=False
            )
        ]
    return [figure for effect in rows.effects for figure in effect_figures(effect)]


def effect_figures(effect: IdentifiedEffect) -> list[Figure]:
    """One figure for each parameter of an effect."""
    return [_parameter(effect.name, parameter) for parameter in effect.parameters]


def _parameter(effect: str, parameter: ParameterEstimate) -> Figure:
    half = NORMAL_95 * parameter.sigma
    name = f"{effect}_{parameter.name}"
    trend = Trend.LARGER if parameter.unit == "px" else Trend.NONE
    title = f"{effect.replace('_', ' ')}: {parameter.name.replace('_', ' ')}"
    return Figure(name, title, parameter.value, parameter.value - half, parameter.value + half, parameter.unit, trend)
