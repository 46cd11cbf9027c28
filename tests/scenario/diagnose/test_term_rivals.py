"""The optional terms of the estimate compete with the dictionary: a hidden bending is no drift of the raster rotation."""

from __future__ import annotations

from blind.experiment import Conditions
from blind.hiding import hidden_effect
from blind.observing import QUICK, observed

from semlive.data.grid import Grid
from semlive.data.notes import NoteCode, NoteLevel
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.maps.term_rivals import rival_notes, rival_of_terms

GRID = Grid(101, 101, 45, 17, 14, 43)  # a block is a point


def hiding(name: str) -> Observation:
    observation = observed(Conditions(511, calibration=6, tension=5), hidden_effect(name, 0.3, 1), GRID, QUICK)
    assert [term.name for term in observation.solution.terms if term.included] == ["raster_rotation"]
    return observation


def test_a_bending_that_the_estimate_takes_for_a_drift_of_the_raster_rotation_is_reported() -> None:
    rival = rival_of_terms(hiding("bending_misalignment"))
    assert rival is not None
    assert (rival.terms, rival.effect) == (("raster_rotation",), "bending_misalignment")
    assert rival.log_odds > 100.0
    [note] = rival_notes(rival)
    assert (note.level, note.code) == (NoteLevel.WARNING, NoteCode.TERM_RIVAL)
    assert "drift of raster rotation, but bending_misalignment explains the maps better" in note.text
    assert "`semlive diagnose LOG`" in note.text


def test_a_raster_rotation_that_drifts_has_no_rival() -> None:
    assert rival_of_terms(hiding("raster_rotation_drift")) is None
