"""What is no drift: one drift for all positions does not fit it, one at every position absorbs it, and it has a name."""

from __future__ import annotations

from bench_swallowed import absorbed, experiment
from blind.experiment import Conditions

from semlive.data.diagnosis.effects import Outcome
from semlive.data.grid import Grid
from semlive.diagnose.maps.verdict import diagnose
from semlive.model.effects import EFFECT_CLASSES

CONDITIONS = Conditions(702, calibration=8, tension=2)
GRID = Grid(101, 101, 25, 30, 24, 43)
FEW = tuple(one for one in EFFECT_CLASSES if one.name in ("magnification_drift", "aspect_drift"))


def test_an_effect_absorbed_by_a_local_drift_is_identified() -> None:
    observed = experiment("magnification_drift", 0.4, CONDITIONS, GRID)
    misfit = absorbed(observed)
    found = diagnose(observed, dictionary=FEW, draws=99)

    assert misfit.global_misfit > 1.3
    assert misfit.local_misfit < 1.2  # noise alone gives 1.07, as what no drift is has been left in both
    assert misfit.between_px > 0.003
    assert (found.outcome, [one.name for one in found.effects]) == (Outcome.IDENTIFIED, ["magnification_drift"])
