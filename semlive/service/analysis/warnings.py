"""Warnings of the estimate during a run: the warning of each subject once, when it first becomes significant."""

from __future__ import annotations

from collections.abc import Sequence

from semlive.data.notes import Note, NoteCode, NoteLevel


def new_warnings(notes: Sequence[Note], before: frozenset[NoteCode]) -> tuple[tuple[str, ...], frozenset[NoteCode]]:
    """Return the texts of the new warnings, and the subjects of all warnings so far.

    Args:
        notes: notes of the newest estimate; estimates between two reviews have no warnings.
        before: subjects of earlier warnings.
    """
    warnings = {note.code: note.text for note in notes if note.level is NoteLevel.WARNING}
    return tuple(text for code, text in warnings.items() if code not in before), before | frozenset(warnings)
