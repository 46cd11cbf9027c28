"""A warning is reported once, however its figures change."""

from __future__ import annotations

from semlive.data.notes import NoteCode, information, warning
from semlive.service.analysis.results import new_warnings

MISFIT = "the residual of the model is {} px, 1.6 times the noise of the correlation"
HALVES = warning(NoteCode.PAIR_HALVES, "distortions from odd and even pairs differ by 0.01 px rms where noise gives 0.002 px (6 sigma)")


def test_a_warning_is_new_until_it_was_given() -> None:
    consistent = information(NoteCode.PAIR_HALVES, "consistency: all is well")
    news, warned = new_warnings((consistent, warning(NoteCode.MODEL_MISFIT, MISFIT.format(0.02))), frozenset())
    assert news == (MISFIT.format(0.02),)
    assert new_warnings((), warned) == ((), warned)
    repeated = warning(NoteCode.MODEL_MISFIT, MISFIT.format(0.03))
    assert new_warnings((repeated,), warned) == ((), warned)
    news, warned = new_warnings((repeated, HALVES), warned)
    assert news == (HALVES.text,)
    assert new_warnings((HALVES, warning(NoteCode.MODEL_MISFIT, MISFIT.format(0.04))), warned)[0] == ()


def test_the_line_of_a_warning_names_its_level() -> None:
    assert HALVES.message == f"WARNING: {HALVES.text}"
    assert information(NoteCode.METHOD, "for comparison").message == "for comparison"
