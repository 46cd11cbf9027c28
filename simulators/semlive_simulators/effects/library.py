"""All effects by name, and the selection of a scenario."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter, ValidationError

from semlive_simulators.effects.anisotropic_pixel import AnisotropicPixel
from semlive_simulators.effects.aspect_drift import AspectDrift
from semlive_simulators.effects.baseline_distortion_underresolved import BaselineDistortionUnderresolved
from semlive_simulators.effects.baseline_drift_underresolved import BaselineDriftUnderresolved
from semlive_simulators.effects.bending_misalignment import BendingMisalignment
from semlive_simulators.effects.bidirectional_scan import BidirectionalScan
from semlive_simulators.effects.charging_frame_ramp import ChargingFrameRamp
from semlive_simulators.effects.charging_jump import ChargingJump
from semlive_simulators.effects.charging_local_lens import ChargingLocalLens
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.contamination import Contamination
from semlive_simulators.effects.creep_in_hold import CreepInHold
from semlive_simulators.effects.defocus import Defocus
from semlive_simulators.effects.dic_shape_mismatch import DicShapeMismatch
from semlive_simulators.effects.dic_subpixel_bias import DicSubpixelBias
from semlive_simulators.effects.distortion_scale_drift import DistortionScaleDrift
from semlive_simulators.effects.drift_jump import DriftJump
from semlive_simulators.effects.flyback_settling import FlybackSettling
from semlive_simulators.effects.frame_integration import FrameIntegration
from semlive_simulators.effects.frame_start_settling import FrameStartSettling
from semlive_simulators.effects.friction_hysteresis import FrictionHysteresis
from semlive_simulators.effects.gamma_change import GammaChange
from semlive_simulators.effects.grain_contrast import GrainContrast
from semlive_simulators.effects.grain_strain import GrainStrain
from semlive_simulators.effects.hole import Hole
from semlive_simulators.effects.inhomogeneous_strain import InhomogeneousStrain
from semlive_simulators.effects.inplane_misalignment import InplaneMisalignment
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.interlaced_scan import InterlacedScan
from semlive_simulators.effects.jump_within_pair import JumpWithinPair
from semlive_simulators.effects.line_sync_hum import LineSyncHum
from semlive_simulators.effects.load_cell_drift import LoadCellDrift
from semlive_simulators.effects.load_cell_gain import LoadCellGain
from semlive_simulators.effects.load_cell_zero import LoadCellZero
from semlive_simulators.effects.load_frame_compliance import LoadFrameCompliance
from semlive_simulators.effects.load_step_transient import LoadStepTransient
from semlive_simulators.effects.magnification_drift import MagnificationDrift
from semlive_simulators.effects.magnification_frame_instability import MagnificationFrameInstability
from semlive_simulators.effects.mains_hum import MainsHum
from semlive_simulators.effects.notch import Notch
from semlive_simulators.effects.out_of_plane_translation import OutOfPlaneTranslation
from semlive_simulators.effects.plastic_hardening import PlasticHardening
from semlive_simulators.effects.poisson_noise import PoissonNoise
from semlive_simulators.effects.random_walk_drift import RandomWalkDrift
from semlive_simulators.effects.raster_rotation_drift import RasterRotationDrift
from semlive_simulators.effects.refocus_magnification_step import RefocusMagnificationStep
from semlive_simulators.effects.row_jitter import RowJitter
from semlive_simulators.effects.scan_nonlinearity import ScanNonlinearity
from semlive_simulators.effects.scan_nonorthogonality import ScanNonorthogonality
from semlive_simulators.effects.scan_shear_drift import ScanShearDrift
from semlive_simulators.effects.stage_backlash import StageBacklash
from semlive_simulators.effects.stage_quadratic import StageQuadratic
from semlive_simulators.effects.stage_step_transient import StageStepTransient
from semlive_simulators.effects.stage_yaw import StageYaw
from semlive_simulators.effects.thermal_oscillation import ThermalOscillation
from semlive_simulators.effects.tilt_with_load import TiltWithLoad
from semlive_simulators.effects.timestamp_offset import TimestampOffset
from semlive_simulators.effects.vibration import Vibration
from semlive_simulators.effects.warmup_transient import WarmupTransient
from semlive_simulators.effects.wrong_dwell import WrongDwell
from semlive_simulators.effects.wrong_row_time import WrongRowTime

_ALL: tuple[type[Effect], ...] = (
    # scan: effects on the timing are in the order in which they act, integration last
    RowJitter,
    MainsHum,
    LineSyncHum,
    Vibration,
    FlybackSettling,
    FrameStartSettling,
    ScanNonlinearity,
    BidirectionalScan,
    InterlacedScan,
    WrongRowTime,
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
_ADAPTERS: dict[str, TypeAdapter[Effect]] = {name: TypeAdapter(kind) for name, kind in _REGISTERED.items()}


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
    adapter = _ADAPTERS[name]
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


def as_mapping(effects: EffectSet) -> dict[str, dict[str, Any]]:
    """The effects as an argument of `build_effects`, in plain values."""
    return {member.name: _ADAPTERS[member.name].dump_python(member, mode="json") for member in effects.members}
