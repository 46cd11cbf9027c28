"""Drift of the cross-talk from the slow to the fast scan amplifier."""

import numpy as np

from semlive.model.effects.effect_class import EffectClass, Recurrence, SlowDriftLaw
from semlive.model.effects.run_geometry import field_column

FAMILY = EffectClass(
    "scan_shear_drift",
    "rows shift in proportion to their distance from the centre, slowly changing: u = gamma(T) (y - yc)",
    SlowDriftLaw(lambda scene: field_column(scene.y, np.zeros_like(scene.y)), "change", "1"),
    group="G3",
    discriminating_experiment="the same field with the scan rotated by 90 degrees: the shear turns with the scan",
    recurrence=Recurrence.CONTINUES,
)
