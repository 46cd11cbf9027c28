"""Notes of the estimate for the operator: level, code and text. The line to show is made last, by `Note.message`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class NoteLevel(StrEnum):
    """Importance of a note."""

    INFORMATION = "information"
    WARNING = "warning"


class NoteCode(StrEnum):
    """Subject of a note. A run reports the warning of each code once, however often its figures change."""

    METHOD = "method"
    CALIBRATION = "calibration"
    OUTSIDE_CALIBRATED_AREA = "outside_calibrated_area"
    MODEL_TERM = "model_term"
    DRIFT_GAP = "drift_gap"
    STAGE_PATH = "stage_path"
    FIELD_HALVES = "field_halves"
    PAIR_HALVES = "pair_halves"
    MODEL_MISFIT = "model_misfit"
    RESIDUAL = "residual"
    EFFECTS = "effects"
    EFFECTS_OF_OTHER_FRAMES = "effects_of_other_frames"
    EFFECTS_IN_LONG_RUN = "effects_in_long_run"
    STRAIN_GAGE = "strain_gage"
    GLOBAL_CORRELATION = "global_correlation"
    ELASTIC_CONSTANTS = "elastic_constants"
    TERM_RIVAL = "term_rival"


_PREFIX = {NoteLevel.INFORMATION: "", NoteLevel.WARNING: "WARNING: "}


@dataclass(frozen=True, slots=True)
class Note:
    """One note.

    Attributes:
        level: importance; a live run reports each new warning as a fault of the model.
        code: subject, by which two notes are compared.
        text: message for the operator, without the level.
    """

    level: NoteLevel
    code: NoteCode
    text: str

    @property
    def message(self) -> str:
        """The line for results and reports."""
        return _PREFIX[self.level] + self.text


def information(code: NoteCode, text: str) -> Note:
    """Return a note that needs no action."""
    return Note(NoteLevel.INFORMATION, code, text)


def warning(code: NoteCode, text: str) -> Note:
    """Return a note that the operator should act on."""
    return Note(NoteLevel.WARNING, code, text)
