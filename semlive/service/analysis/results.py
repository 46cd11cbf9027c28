"""Outputs of an analysed pair in the order of the log, and the new warnings of the estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from semlive.data.faults import FaultKind
from semlive.data.notes import Note, NoteCode, NoteLevel
from semlive.data.results import PairResult
from semlive.formats.log import conversions as values
from semlive.formats.log.maps import encode_displacement, encode_map, encode_strain
from semlive.formats.log.messages import DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD, DicMessage, FaultMessage
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.messages import fault_origin, log_message

_MAX_UNCALIBRATED_FRACTION = 0.01
"""A larger fraction of points outside the calibrated area is reported as a fault."""


def result_messages(result: PairResult, wall_s: float) -> Iterator[LogMessage]:
    """Yield all outputs of an analysed pair in the order of the log."""
    estimate, end_ns = result.estimate, result.decision.second.end_time_ns
    revision, pairs = estimate.drift.revision, result.pairs
    for disparity in result.maps:
        yield LogMessage(DIC_MAP, end_ns, end_ns, disparity.current, encode_map(disparity))
        valid = disparity.valid
        means = [float(field[valid].mean()) if valid.any() else None for field in (disparity.u_px, disparity.v_px, disparity.sigma_u_px)]
        summary = DicMessage(
            reference=disparity.reference,
            current=disparity.current,
            points=valid.size,
            converged=int(valid.sum()),
            mean_u_px=means[0],
            mean_v_px=means[1],
            noise_px=means[2],
            wall_s=wall_s,
        )
        yield log_message(summary, end_ns)
    yield log_message(values.drift_message(estimate.drift, estimate.calibration, pairs), end_ns)
    yield log_message(values.distortion_message(estimate.distortion, revision), end_ns)
    for motion in estimate.motions:
        yield log_message(values.motion_message(motion, revision), end_ns)
    for frame in (*result.frames, *result.revised_frames):
        number = frame.summary.frame
        yield LogMessage(DISPLACEMENT_FIELD, end_ns, end_ns, number, encode_displacement(frame.displacement))
        yield LogMessage(STRAIN_FIELD, end_ns, end_ns, number, encode_strain(frame.strain))
        yield log_message(values.strain_message(frame.summary, revision), end_ns)
    yield log_message(values.elastic_message(result.elastic, revision, result.gage, pairs), end_ns)
    yield from _uncalibrated_area(result, end_ns)


def _uncalibrated_area(result: PairResult, end_ns: int) -> Iterator[LogMessage]:
    """Yield a fault if a frame shows points outside the calibrated area, while the specimen can still be moved back."""
    measured_maps = {disparity_map.current: disparity_map.valid for disparity_map in result.maps if disparity_map.reference == 0}
    for frame in result.frames:
        measured, number = measured_maps.get(frame.summary.frame), frame.summary.frame
        if measured is None or not measured.any():
            continue
        uncalibrated = 1.0 - float(frame.displacement.valid[measured].mean())
        if uncalibrated > _MAX_UNCALIBRATED_FRACTION:
            what = (
                f"{100 * uncalibrated:.0f} % of the points of frame {number} lie beyond the area that the calibration covered and have no "
                "displacement; bring the specimen back, or calibrate with larger translations"
            )
            action, where, kind = (
                "the other points are corrected as ever",
                fault_origin(result.decision.pair),
                FaultKind.POINTS_NOT_CALIBRATED,
            )
            yield log_message(FaultMessage(time_ns=end_ns, what=what, where=where, action=action, kind=kind), end_ns)
            return


def new_warnings(notes: Sequence[Note], before: frozenset[NoteCode]) -> tuple[tuple[str, ...], frozenset[NoteCode]]:
    """Return the texts of the new warnings, and the subjects of all warnings so far.

    Args:
        notes: notes of the newest estimate; estimates between two reviews have no warnings.
        before: subjects of earlier warnings.
    """
    warnings = {note.code: note.text for note in notes if note.level is NoteLevel.WARNING}
    return tuple(text for code, text in warnings.items() if code not in before), before | frozenset(warnings)
