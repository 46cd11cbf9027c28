"""Drift of the magnification by high voltage, lens current or working distance (dM/M = dV/2V, dz/WD)."""

from semlive.model.effects.effect_class import EffectClass, Recurrence, SlowDriftLaw
from semlive.model.effects.run_geometry import field_column

FAMILY = EffectClass(
    "magnification_drift",
    "the magnification drifts slowly: (u, v) = s(T) (x - xc, y - yc)",
    SlowDriftLaw(lambda scene: field_column(scene.x, scene.y), "change", "1"),
    group="G1",
    discriminating_experiment="a series of an hour at zero load, with focus and working distance "
    "read back: only the time course separates the causes",
    recurrence=Recurrence.CONTINUES,
)
