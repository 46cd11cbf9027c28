"""Drift of the gain ratio of the two scan amplifiers."""

from semlive.model.effects.effect_class import EffectClass, Recurrence, SlowDriftLaw
from semlive.model.effects.run_geometry import field_column

FAMILY = EffectClass(
    "aspect_drift",
    "the image becomes slowly wider and lower: (u, v) = s(T) (x - xc, -(y - yc))",
    SlowDriftLaw(lambda scene: field_column(scene.x, -scene.y), "change", "1"),
    group="G3",
    discriminating_experiment="the same field with the scan rotated by 90 degrees: the aspect turns with the scan",
    recurrence=Recurrence.CONTINUES,
)
