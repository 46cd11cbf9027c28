"""All effects by name, and the selection of a scenario."""

from __future__ import annotations

import functools
from typing import Any

from pydantic import TypeAdapter, ValidationError

from semlive_simulators.effects.charging import ChargingFrameRamp, ChargingJump, ChargingLocalLens
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.deformation import (
    BendingMisalignment,
    InhomogeneousStrain,
    InplaneMisalignment,
    OutOfPlaneTranslation,
    TiltWithLoad,
)
from semlive_simulators.effects.detector import Contamination, Defocus, DicShapeMismatch, DicSubpixelBias, GammaChange, PoissonNoise
from semlive_simulators.effects.drift import (
    BaselineDistortionUnderresolved,
    BaselineDriftUnderresolved,
    RandomWalkDrift,
    ThermalOscillation,
    WarmupTransient,
)
from semlive_simulators.effects.image_field import (
    AnisotropicPixel,
    AspectDrift,
    DistortionScaleDrift,
    MagnificationDrift,
    MagnificationFrameInstability,
    RasterRotationDrift,
    RefocusMagnificationStep,
    ScanNonorthogonality,
    ScanShearDrift,
)
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.load_cell import FrictionHysteresis, LoadCellDrift, LoadCellGain, LoadCellZero, LoadFrameCompliance
from semlive_simulators.effects.material import GrainContrast, GrainStrain, Hole, Notch, PlasticHardening
from semlive_simulators.effects.scan_deflection import LineSyncHum, MainsHum, RowJitter, ScanNonlinearity, Vibration
from semlive_simulators.effects.scan_timing import (
    BidirectionalScan,
    FrameIntegration,
    InterlacedScan,
    IrregularRows,
    TimestampOffset,
    WrongDwell,
    WrongRowTime,
)
from semlive_simulators.effects.settling import (
    FlybackSettling,
    FrameStartSettling,
    FrameStartSettlingInPosition,
    RowStartSettlingInPosition,
)
from semlive_simulators.effects.specimen_motion import (
    CreepInHold,
    DriftJump,
    JumpWithinPair,
    LoadStepTransient,
    StageBacklash,
    StageQuadratic,
    StageStepTransient,
    StageYaw,
)

_ALL: tuple[type[Effect], ...] = (
    # scan: effects on the timing are in the order in which they act, integration last
    RowJitter,
    MainsHum,
    LineSyncHum,
    Vibration,
    FlybackSettling,
    RowStartSettlingInPosition,
    FrameStartSettling,
    FrameStartSettlingInPosition,
    ScanNonlinearity,
    BidirectionalScan,
    InterlacedScan,
    WrongRowTime,
    IrregularRows,
    WrongDwell,
    TimestampOffset,
    FrameIntegration,
    # field
    MagnificationDrift,
    MagnificationFrameInstability,
    RefocusMagnificationStep,
    RasterRotationDrift,
    ScanShearDrift,
    AspectDrift,
    DistortionScaleDrift,
    AnisotropicPixel,
    ScanNonorthogonality,
    OutOfPlaneTranslation,
    TiltWithLoad,
    # specimen and load frame
    CreepInHold,
    LoadStepTransient,
    StageStepTransient,
    StageBacklash,
    StageQuadratic,
    StageYaw,
    DriftJump,
    JumpWithinPair,
    BendingMisalignment,
    InplaneMisalignment,
    InhomogeneousStrain,
    LoadCellZero,
    LoadCellGain,
    LoadCellDrift,
    LoadFrameCompliance,
    FrictionHysteresis,
    # drift
    WarmupTransient,
    ThermalOscillation,
    RandomWalkDrift,
    BaselineDriftUnderresolved,
    BaselineDistortionUnderresolved,
    # charge, detector, correlation
    ChargingFrameRamp,
    ChargingLocalLens,
    ChargingJump,
    Contamination,
    Defocus,
    GammaChange,
    PoissonNoise,
    DicSubpixelBias,
    DicShapeMismatch,
)
LIBRARY: dict[str, type[Effect]] = {kind.name: kind for kind in _ALL}
"""Every effect by its name; effects act in this order."""
MATERIAL: dict[str, type[Effect]] = {kind.name: kind for kind in (PlasticHardening, GrainStrain, GrainContrast, Hole, Notch)}
"""Properties of a specimen that is not a plain elastic sheet: no errors, but quantities to measure. They act before the effects."""
_REGISTERED = MATERIAL | LIBRARY


@functools.cache
def _adapter(name: str) -> TypeAdapter[Effect]:
    """Made when an effect is used: a scenario has a few of them, and all take 60 ms at every start of a simulator."""
    return TypeAdapter(_REGISTERED[name])


def build_effects(chosen: object) -> EffectSet:
    """The effects of a scenario.

    Args:
        chosen: ``{name: parameters}``. Parameters are a mapping, or ``x200`` or ``x10000`` for the defaults there; a
            mapping may contain ``defaults: x200`` and only the differences. None disables an effect.

    Raises:
        ValueError: if an effect or a parameter is unknown, or a value is wrong.
    """
    if chosen is None:
        return EffectSet()
    if isinstance(chosen, EffectSet):
        return chosen
    if not isinstance(chosen, dict):
        raise ValueError("effects must be a mapping from names to parameters")
    unknown = sorted(str(name) for name in chosen if name not in _REGISTERED)
    if unknown:
        raise ValueError(f"unknown effect {', '.join(unknown)}; the known ones are {', '.join(LIBRARY | MATERIAL)}")
    return EffectSet(tuple(_built(name, chosen[name]) for name in _REGISTERED if chosen.get(name) is not None))


def _built(name: str, parameters: Any) -> Effect:
    if isinstance(parameters, str):
        parameters = {"defaults": parameters}
    if not isinstance(parameters, dict):
        raise ValueError(f"{name}: parameters must be a mapping, x200 or x10000")
    fields = dict(parameters)
    magnification = fields.pop("defaults", None)
    adapter = _adapter(name)
    try:
        if magnification is not None:
            fields = adapter.dump_python(_REGISTERED[name].defaults(magnification)) | fields
        return adapter.validate_python(fields)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in (name, *first["loc"]))
        raise ValueError(f"{key}: {first['msg']}") from error
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def as_mapping(effects: EffectSet) -> dict[str, dict[str, object]]:
    """The effects as an argument of `build_effects`, in plain values."""
    return {member.name: _adapter(member.name).dump_python(member, mode="json") for member in effects.members}
