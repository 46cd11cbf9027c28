"""True values of the figures of a qualification, from the parameters of the simulators."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from qualify_raster import ROW_EFFECTS, Array, Raster, effect_of, false_strain_per_px, largest_distortion_px, row_time_error
from qualify_still import Still, Truth, displacement_noise, gauge_step_px, strain_noise
from scipy import ndimage

from semlive.qualify.figures.pixel_noise import ORDER_X, ORDER_Y
from semlive.qualify.values import Qualification
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.scan_deflection import MainsHum, RowJitter, Vibration
from semlive_simulators.effects.scan_timing import WrongRowTime
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen import stage as stages
from semlive_simulators.specimen.protocol_player import ScannedFrame
from semlive_simulators.specimen.specimen import at_rest

SHIFT_PX, DECAYED_PX = 5.0, 0.1
"""Shift for which strain is stated, and motion by the decaying drift in a frame at the end of the waiting time."""
SEQUENCES = 400
"""Sequences of moves of a stage of which the error of a move is the root mean square."""
FIELDS, FIELD_PX = 5, 1000.0
NORMAL_MEDIAN = 0.67449
"""Median of the absolute value of a standard normal variable."""

Truths = Mapping[str, Truth]
Strains = Mapping[str, float]
"""True strain at the reference gauge by source."""


def stage_error_px(scenario: Scenario, shots: Sequence[ScannedFrame], turned: Array) -> float:
    """Root mean square error of a move about the affine law of the stage, over many sequences of the moves of a run."""
    pixel_um, commands = scenario.scan.pixel_size_um, np.array([shot.stop.shift_px for shot in shots[::2]])
    positions = np.empty((SEQUENCES, len(commands), 2))
    for sequence in range(SEQUENCES):
        state = stages.StageState()
        for at, (x, y) in enumerate(commands * pixel_um):
            moved = stages.start_move(state, scenario.stage, float(x), float(y), scenario.seed + 1000 + sequence)
            state = stages.step(moved, scenario.stage, 1e6)
            positions[sequence, at] = turned @ stages.true_position_um(state, scenario.stage)
    columns = np.column_stack((np.ones(commands.shape[0]), commands))
    law = np.linalg.lstsq(columns, positions.mean(axis=0) / pixel_um, rcond=None)[0]
    return float(np.sqrt(np.mean((positions / pixel_um - columns @ law) ** 2)))


def truth_of(scenario: Scenario, shots: Sequence[ScannedFrame], found: Qualification) -> dict[str, Truth]:
    """True values of the figures of a qualification by name; figures without one are left out."""
    raster = Raster.of(scenario, found)
    values = {**_drift(raster, shots), **_stage(raster, shots), **_effects(scenario)}
    values |= {"distortion": largest_distortion_px(raster), "false_strain_per_px": false_strain_per_px(raster)}
    begins = np.array([shot.start_s for shot in shots])
    values["frame_interval"] = float(np.median(begins[1::2] - begins[::2])) / scenario.scan.duration_s
    still = Still.of(scenario, shots, raster, row_effects=True)
    sizes = {figure.name.removeprefix("noise_") for figure in found.figures if figure.name.startswith("noise_")}
    own = found.protocol.subset_px
    jitter = effect_of(scenario, RowJitter) is not None
    noise = {
        f"noise_{size}": displacement_noise(still.maps(size, size // 2), jitter=jitter) for size in sorted(int(text) for text in sizes)
    }
    step_px = gauge_step_px(own)
    noise["strain_noise"] = noise["image_strain_noise"] = strain_noise(still.maps(own, step_px))
    if effect_of(scenario, *ROW_EFFECTS) is not None:
        plain = Still.of(scenario, shots, raster, row_effects=False)
        noise["image_strain_noise"] = strain_noise(plain.maps(own, step_px))
    return {name: Truth(value) for name, value in (values | _pattern(scenario)).items()} | noise


def _pattern(scenario: Scenario) -> dict[str, float]:
    """Pattern of five fields of the specimen without noise, and the noise of a pixel as the median over them."""
    clean = replace(scenario, detector=replace(scenario.detector, read_noise=0.0, shot_noise=0.0), effects=EffectSet())
    column, rng = clean.column(), np.random.default_rng(2)
    grey = [render_frame(clean, 0.0, at_rest((FIELD_PX * field, 0.0)), column=column).astype(np.float64) for field in range(FIELDS)]
    noises = []
    for one in grey:
        variance = scenario.detector.read_noise**2 + scenario.detector.shot_noise * one + 1.0 / 12.0
        local = ndimage.correlate1d(ndimage.correlate1d(variance, squared_weights(ORDER_Y), axis=0), squared_weights(ORDER_X), axis=1)
        noises.append(np.median(np.abs(np.sqrt(local) * rng.standard_normal(local.shape))) / NORMAL_MEDIAN)
    return {"contrast": float(np.sqrt(np.mean([one.var() for one in grey]))), "image_noise": float(np.mean(noises))}


def squared_weights(order: int) -> Array:
    """Squared weights of the difference of an order, from which noise is measured, by pixel."""
    weights = np.array([math.comb(order, at) ** 2 for at in range(order + 1)], dtype=np.float64)
    return weights / weights.sum()


def _drift(raster: Raster, shots: Sequence[ScannedFrame]) -> dict[str, float]:
    scenario = raster.scenario
    first, last = (float(np.linalg.norm(raster.rate_px_s(shots, pair))) for pair in (0, len(shots) // 2 - 1))
    stretch, axes = 1.0 + row_time_error(scenario), (scenario.drift.x, scenario.drift.y)
    row_s, frame_s, decay_s = stretch * scenario.scan.row_time_s, stretch * scenario.scan.duration_s, axes[0].warmup_s
    # The first rate is the mean over the rows of both frames.
    middle_s = 0.5 * (shots[0].start_s + shots[1].start_s + frame_s)
    decaying = np.array([axis.warmup_px / decay_s * np.exp(-middle_s / decay_s) for axis in axes])
    moved_px = float(np.linalg.norm(raster.turned @ decaying)) * frame_s
    return {
        "drift_rate_first": first, "drift_rate": last, "drift_rate_nm": 1e3 * scenario.scan.pixel_size_um * last,
        "drift_in_frame": last * frame_s, "drift_strain": last * row_s, "drift_decay": decay_s,
        "drift_rate_final": float(np.linalg.norm(raster.turned @ [axis.linear_px_s for axis in axes])),
        "waiting_time": decay_s * float(np.log(max(moved_px / DECAYED_PX, 1.0))),
    }  # fmt: skip


def _fastest_px_s(raster: Raster, shots: Sequence[ScannedFrame]) -> float:
    """Largest drift rate during the run, which is at its begin or its end, px/s."""
    drift, rates = raster.scenario.drift, []
    for at_s in (shots[0].start_s, shots[-1].start_s + raster.scenario.frame_duration_s):
        moved = drift.at(at_s + 1.0) - drift.at(at_s - 1.0)
        rates.append(float(np.linalg.norm(raster.turned @ moved)) / 2.0)
    return max(rates)


def _stage(raster: Raster, shots: Sequence[ScannedFrame]) -> dict[str, float]:
    stage, scan = raster.scenario.stage, raster.scenario.scan
    angle = stage.nonorthogonality_rad
    along_x, along_y = raster.turned @ [stage.scale_x, 0.0], raster.turned @ [stage.scale_y * np.sin(angle), stage.scale_y * np.cos(angle)]
    scale_x, scale_y = float(np.linalg.norm(along_x)), float(np.linalg.norm(along_y))
    clipped = np.clip(np.random.default_rng(1).standard_normal(200_000), -1.5, 1.5).std()
    return {
        "stage_scale_x": scale_x, "stage_scale_y": scale_y,
        "stage_rotation": float(np.degrees(np.arctan2(along_x[1], along_x[0]))),
        "stage_angle": float(np.degrees(np.arccos(along_x @ along_y / (scale_x * scale_y)))),
        "stage_residual": stage_error_px(raster.scenario, shots, raster.turned),
        "stage_backlash_x": stage.backlash_um / scan.pixel_size_um * scale_x,
        "stage_backlash_y": stage.backlash_um / scan.pixel_size_um * scale_y,
        "stage_yaw": 1e3 * stage.yaw_rad * float(clipped),
    }  # fmt: skip


def _effects(scenario: Scenario) -> dict[str, float]:
    """Parameters of the effects that a qualification can name; a further wave of a hum has no amplitude."""
    found = effect_of(scenario, *ROW_EFFECTS, WrongRowTime)
    if isinstance(found, MainsHum | Vibration):
        sizes = {"amplitude_x_px": found.amplitude_x_px, "amplitude_y_px": found.amplitude_y_px, "frequency_hz": found.frequency_hz}
        further = {f"amplitude_{number}_{axis}_px": 0.0 for number in range(2, 6) for axis in "xy"}
        return {f"{found.name}_{name}": value for name, value in (sizes | further).items()}
    if isinstance(found, RowJitter):
        return {"row_jitter_sd_x_px": found.sd_px, "row_jitter_sd_y_px": 0.0}
    return {"wrong_row_time_row_time_error": found.row_time_error} if isinstance(found, WrongRowTime) else {}


def true_strains(scenario: Scenario, truths: Truths, found: Qualification) -> Strains:
    """True strain of each source at the reference gauge; sources that are not there are left out.

    That of a wrong row time is at the first pair, where the drift is fastest; that of the drift at the last pair, as stated.
    """
    raster = Raster.of(scenario, found)
    image, total = truths["image_strain_noise"].value, truths["strain_noise"].value
    settling = SHIFT_PX * false_strain_per_px(raster, settling_only=True)
    per_px = truths["false_strain_per_px"].value
    strains = {
        "image_noise": image, "drift": truths["drift_strain"].value, "stage": per_px * truths["stage_residual"].value,
        "distortion": SHIFT_PX * per_px, "row_start_settling": settling,
    }  # fmt: skip
    if settling:
        strains["distortion"] = SHIFT_PX * false_strain_per_px(replace(raster, scenario=replace(scenario, effects=EffectSet())))
    else:
        del strains["row_start_settling"]
    row_effect, error = effect_of(scenario, *ROW_EFFECTS), abs(row_time_error(scenario))
    if row_effect is not None:
        strains[row_effect.name] = float(np.sqrt(max(total**2 - image**2, 0.0)))
    if error:
        strains["wrong_row_time"] = truths["drift_rate_first"].value * scenario.scan.row_time_s * error
    return strains
