"""Every effect that moves the image, against its formula written independently, pixel by pixel in plain Python."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from semlive_simulators.effects.interfaces import Effect, TimingEffect
from semlive_simulators.effects.library import LIBRARY, build_effects
from semlive_simulators.kernels.pattern import gaussian
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.history import History, LoadStep, Move
from semlive_simulators.specimen.specimen import at_rest

W, H, FRAME = 90, 40, 7
DWELL_S, ROW_S = 1e-4, 94.67 / 884
XC, YC = (W - 1) / 2, (H - 1) / 2
LOAD_N, PIXEL_UM = 2000.0, 1.25
STEPS = (LoadStep(30.0, 800.0), LoadStep(590.0, 1200.0))
MOVES = (Move(10.0, (0.0, 0.0), (8.0, 0.0)), Move(300.0, (8.0, 0.0), (-4.0, 6.0)), Move(598.0, (-4.0, 6.0), (-4.0, -9.0)))
HISTORY = History(STEPS, MOVES)
START_S = 599.0

Formula = Callable[[Any, float, float, float], tuple[float, float]]
"""(effect, x, y, time since the run began) -> (u, v) in px."""


def calm(**effects: Any) -> Scenario:
    """A small frame without drift, distortion and noise."""
    paper = load_scenario("paper_x200")
    flat = dataclasses.replace(paper.distortion.x, constant_px=0, xx_px=0, xy_px=0, yy_px=0, wave_px=0)
    still = dataclasses.replace(paper.drift.x, warmup_px=0, linear_px_s=0, quadratic_px_s2=0)
    return dataclasses.replace(
        paper,
        scan=dataclasses.replace(paper.scan, width_px=W, height_px=H, frame_time_s=H * ROW_S),
        detector=dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0, bits=16),
        distortion=dataclasses.replace(paper.distortion, x=flat, y=flat),
        drift=dataclasses.replace(paper.drift, x=still, y=still),
        effects=build_effects(effects),
    )


def rising(p: Any, change: float, t: float) -> float:
    return change * (1 - math.exp(-t / p.time_constant_s))


def turned(angle: float, x: float, y: float) -> tuple[float, float]:
    return -angle * (y - YC), angle * (x - XC)


def scaled(s: float, x: float, y: float) -> tuple[float, float]:
    return s * (x - XC), s * (y - YC)


def happened(t: float, events: tuple[Any, ...]) -> list[Any]:
    return [event for event in events if event.time_s <= t]


def backlash(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    signs = [0.0, 0.0]
    for move in happened(t, MOVES):
        for axis, change in enumerate(move.change_px):
            signs[axis] = math.copysign(1, change) if change else signs[axis]
    return signs[0] * p.backlash_um / PIXEL_UM, signs[1] * p.backlash_um / PIXEL_UM


def square(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    done = happened(t, MOVES)
    c_um = [PIXEL_UM * value for value in (done[-1].to_px if done else (0.0, 0.0))]
    return p.quadratic_per_um * c_um[0] ** 2 / PIXEL_UM, p.quadratic_per_um * c_um[1] ** 2 / PIXEL_UM


def yaw(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    number = len(happened(t, MOVES)) - 1
    return turned(p.sd_rad * gaussian(p.seed, 30, number) if number >= 0 else 0.0, x, y)


def creep(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    done = happened(t, STEPS)
    eps = p.strain_per_n * LOAD_N * math.log(1 + (t - done[-1].time_s) / p.onset_s) if done else 0.0
    return -p.poissons_ratio * eps * (x - XC), eps * (y - YC)


def load_transient(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    total = sum(step.change_n * math.exp(-(t - step.time_s) / p.time_constant_s) for step in happened(t, STEPS))
    return p.x_px_per_n * total, p.y_px_per_n * total


def stage_transient(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    parts = [(move.change_px, p.fraction * math.exp(-(t - move.time_s) / p.time_constant_s)) for move in happened(t, MOVES)]
    return sum(m[0] * share for m, share in parts), sum(m[1] * share for m, share in parts)


def nonlinear(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    X, Y = (x - XC) / XC, (y - YC) / YC
    return p.quadratic_px * X**2 + p.cubic_px * X**3 + p.hysteresis_px * (1 - X**2), p.quadratic_px * Y**2 + p.cubic_px * Y**3


def tilt(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    a = p.tilt_rad_per_n * LOAD_N / (p.working_distance_mm * 1000 / PIXEL_UM)
    return a * (x - XC) * (y - YC), a * (y - YC) ** 2


def bending(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    kf = p.curvature_per_mm_n * LOAD_N * PIXEL_UM / 1000
    return -kf * ((y - YC) ** 2 / 2 + p.poissons_ratio * (x - XC) ** 2 / 2), kf * (x - XC) * (y - YC)


def misaligned(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    s, r = p.shear_per_n * LOAD_N, p.rotation_rad_per_n * LOAD_N
    return (s - r) * (y - YC), (s + r) * (x - XC)


def bands(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    a = p.amplitude_px_per_n * LOAD_N * math.sin(2 * math.pi * (x - XC + y - YC) / (math.sqrt(2) * p.wavelength_px)) / math.sqrt(2)
    return a, -a


def walk(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    totals = [0.0, 0.0]
    for axis in range(2):
        for k in range(1, round(2 * p.span_s / p.shortest_period_s) + 1):
            w = (k - 0.5) * math.pi
            totals[axis] += gaussian(p.seed, 43 + axis, k - 1) * math.sqrt(2 * p.span_s) * math.sin(w * t / p.span_s) / w
    return p.step_px_per_sqrt_s * totals[0], p.step_px_per_sqrt_s * totals[1]


def rich_drift(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    totals = [0.0, 0.0]
    for axis in range(2):
        for k in range(12):
            period_s = p.shortest_period_s * (p.longest_period_s / p.shortest_period_s) ** (k / 11)
            totals[axis] += math.sin(2 * math.pi * (t / period_s + gaussian(p.seed, 45 + axis, k)))
    return p.sd_px * math.sqrt(2 / 12) * totals[0], p.sd_px * math.sqrt(2 / 12) * totals[1]


def hills(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    kx, ky = 2 * math.pi * x / p.wavelength_px, 2 * math.pi * y / p.wavelength_px
    return p.amplitude_px * math.sin(kx) * math.cos(ky), p.amplitude_px * math.cos(kx) * math.sin(ky)


def ramp(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    charge = (1 - math.exp(-(t - START_S) / p.charging_s)) * (1 - math.exp(-START_S / p.dose_s))
    return p.x_px * charge, p.y_px * charge


def lens(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    q, u, v = p.peak_px * (1 - math.exp(-t / p.charging_s)), 0.0, 0.0
    for gx, gy in p.grains_px:
        r2 = (x - gx) ** 2 + (y - gy) ** 2
        u, v = u + q * 2 * p.width_px * (x - gx) / (r2 + p.width_px**2), v + q * 2 * p.width_px * (y - gy) / (r2 + p.width_px**2)
    return u, v


def discharges(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    totals = [0.0, 0.0]
    for k in range(200):
        share = 0.5 * (1 + math.erf(gaussian(p.seed, 50, k) / math.sqrt(2)))
        if (k + share) * p.mean_interval_s <= t:
            totals = [totals[axis] + p.sd_px * gaussian(p.seed, 51 + axis, k) for axis in range(2)]
    return totals[0], totals[1]


def waves(p: Any, x: float, y: float, t: float) -> tuple[float, float]:
    a = p.amplitude_px_per_n * LOAD_N
    return a * math.cos(2 * math.pi * (x - XC) / p.wavelength_px), a * math.cos(2 * math.pi * (y - YC) / p.wavelength_px)


RASTER: dict[str, Formula] = {
    "row_jitter": lambda p, x, y, t: (p.sd_px * gaussian(p.seed, 1_000_003 * FRAME, int(y)), 0.0),
    "mains_hum": lambda p, x, y, t: tuple(
        a * math.sin(2 * math.pi * p.frequency_hz * t + p.phase_rad) for a in (p.amplitude_x_px, p.amplitude_y_px)
    ),
    "line_sync_hum": lambda p, x, y, t: (p.amplitude_px * math.sin(2 * math.pi * p.frequency_hz * x * DWELL_S), 0.0),
    "vibration": lambda p, x, y, t: tuple(
        a * math.sin(2 * math.pi * (p.frequency_hz * (t - START_S) + gaussian(p.seed, 4, FRAME)))
        for a in (p.amplitude_x_px, p.amplitude_y_px)
    ),
    "flyback_settling": lambda p, x, y, t: (
        p.amplitude_px * math.exp(-x * DWELL_S / p.settling_s) + p.second_amplitude_px * math.exp(-x * DWELL_S / p.second_settling_s),
        0.0,
    ),
    "row_start_settling_in_position": lambda p, x, y, t: (
        p.amplitude_um / PIXEL_UM * math.exp(-x * PIXEL_UM / p.length_um)
        + p.second_amplitude_um / PIXEL_UM * math.exp(-x * PIXEL_UM / p.second_length_um),
        0.0,
    ),
    "frame_start_settling": lambda p, x, y, t: tuple(
        a * math.exp(-y * ROW_S / p.settling_s) + b * math.exp(-y * ROW_S / p.second_settling_s)
        for a, b in ((p.amplitude_x_px, p.second_x_px), (p.amplitude_y_px, p.second_y_px))
    ),
    "frame_start_settling_in_position": lambda p, x, y, t: tuple(
        (a * math.exp(-y * PIXEL_UM / p.length_um) + b * math.exp(-y * PIXEL_UM / p.second_length_um)) / PIXEL_UM
        for a, b in ((p.amplitude_x_um, p.second_x_um), (p.amplitude_y_um, p.second_y_um))
    ),
    "scan_nonlinearity": nonlinear,
    "magnification_drift": lambda p, x, y, t: scaled(rising(p, p.change, t), x, y),
    "magnification_frame_instability": lambda p, x, y, t: scaled(p.sd * gaussian(p.seed, 15, FRAME), x, y),
    "refocus_magnification_step": lambda p, x, y, t: scaled(p.sd * gaussian(p.seed, 16, 5), x, y),
    "raster_rotation_drift": lambda p, x, y, t: turned(rising(p, p.change_rad, t), x, y),
    "scan_shear_drift": lambda p, x, y, t: (rising(p, p.change, t) * (y - YC), 0.0),
    "aspect_drift": lambda p, x, y, t: (rising(p, p.change, t) * (x - XC), -rising(p, p.change, t) * (y - YC)),
    "anisotropic_pixel": lambda p, x, y, t: (p.x_excess * (x - XC), 0.0),
    "scan_nonorthogonality": lambda p, x, y, t: (p.skew_rad * (y - YC), 0.0),
    "out_of_plane_translation": lambda p, x, y, t: scaled(LOAD_N * p.lift_um_per_n / (1000 * p.working_distance_mm), x, y),
    "tilt_with_load": tilt,
    "load_step_transient": load_transient,
    "stage_step_transient": stage_transient,
    "drift_jump": lambda p, x, y, t: (p.x_px, p.y_px) if t >= p.at_s else (0.0, 0.0),
    "jump_within_pair": lambda p, x, y, t: (p.x_px, p.y_px),
    "warmup_transient": lambda p, x, y, t: (p.x_px * math.exp(-t / p.time_constant_s), p.y_px * math.exp(-t / p.time_constant_s)),
    "thermal_oscillation": lambda p, x, y, t: tuple(a * math.sin(2 * math.pi * t / p.period_s + p.phase_rad) for a in (p.x_px, p.y_px)),
    "random_walk_drift": walk,
    "baseline_drift_underresolved": rich_drift,
    "baseline_distortion_underresolved": hills,
    "charging_frame_ramp": ramp,
    "charging_jump": discharges,
    "defocus": lambda p, x, y, t: scaled(p.magnification_per_px * p.blur_px_per_s * t, x, y),
}
"""Displacement of the image at a scan address."""
MATERIAL: dict[str, Formula] = {
    "creep_in_hold": creep,
    "stage_backlash": backlash,
    "stage_quadratic": square,
    "stage_yaw": yaw,
    "bending_misalignment": bending,
    "inplane_misalignment": misaligned,
    "inhomogeneous_strain": bands,
    "charging_local_lens": lens,
    "dic_shape_mismatch": waves,
}
"""Displacement of a material point."""
SPECIAL: dict[str, dict[str, Any]] = {"charging_jump": {"defaults": "x200", "mean_interval_s": 40.0}}


def points(scenario: Scenario) -> list[tuple[int, int, float, float, float, float]]:
    """(x, y, material x, material y, seconds since the run began, seconds since the frame began) of sampled pixels."""
    x_px, y_px, at = scenario.column().specimen_points(range(H), 0, START_S, at_rest(load_n=LOAD_N, history=HISTORY), FRAME)
    samples = [(x, y) for y in range(0, H, 3) for x in (0, 1, 2, 13, 44, 45, W - 1)]
    return [(x, y, x_px[y, x], y_px[y, x], at.time_s[y, x], at.in_frame_s[y, x]) for x, y in samples]


@pytest.mark.parametrize("magnification", ["x200", "x10000"])
@pytest.mark.parametrize("name", [*RASTER, *MATERIAL])
def test_the_image_moves_by_the_formula(name: str, magnification: str) -> None:
    scenario = calm(**{name: SPECIAL.get(name, magnification)})
    (effect,) = scenario.effects.members
    errors, sizes = [], []
    for x, y, image_x, image_y, time_s, in_frame_s in points(scenario):
        assert in_frame_s == pytest.approx(y * ROW_S + x * DWELL_S, abs=1e-9)
        where = (x, y) if name in RASTER else (image_x, image_y)
        u, v = (RASTER | MATERIAL)[name](effect, *where, time_s)
        errors.append(math.hypot(x - image_x - u, y - image_y - v))
        sizes.append(math.hypot(u, v))
    assert max(sizes) > 1e-6
    assert max(errors) < min(1e-4, 1e-7 + 0.01 * max(sizes))  # some are tiny in so small a frame


def test_every_effect_is_covered() -> None:
    silent = {"timestamp_offset", "load_cell_zero", "load_cell_gain", "load_cell_drift", "load_frame_compliance", "friction_hysteresis"}
    grey = {"contamination", "gamma_change", "poisson_noise", "dic_subpixel_bias"}
    retiming = {name for name, kind in LIBRARY.items() if issubclass(kind, TimingEffect)}
    assert set(LIBRARY) == set(RASTER) | set(MATERIAL) | retiming | silent | grey | {"distortion_scale_drift"}


def test_distortion_grows_with_time() -> None:
    paper = load_scenario("paper_x200")
    scenario = dataclasses.replace(calm(distortion_scale_drift="x200"), distortion=paper.distortion)
    (effect,) = scenario.effects.members
    for x, y, image_x, image_y, time_s, _ in points(scenario):
        bend = paper.distortion.at(x, y, W, H) * (1 + rising(effect, effect.change, time_s))  # type: ignore[attr-defined]
        assert math.hypot(x - image_x - bend[0], y - image_y - bend[1]) < 1e-4


TIMES: dict[str, Callable[[Any, int, int, int], float]] = {
    "bidirectional_scan": lambda p, x, y, m: (W - 1 - x if y % 2 else x) * DWELL_S + y * ROW_S,
    "interlaced_scan": lambda p, x, y, m: (y % 2) * H * ROW_S / 2 + (y // 2) * ROW_S + x * DWELL_S,
    "irregular_rows": lambda p, x, y, m: (
        y * ROW_S
        + x * DWELL_S
        + sum(p.delay_s * abs(gaussian(p.seed, 60, row)) for row in range(1, y + 1))
        + (p.pause_s if y >= p.pause_row else 0.0)
    ),
    "frame_integration": lambda p, x, y, m: (m * H * ROW_S + y * ROW_S + x * DWELL_S) / p.scans,
    "wrong_row_time": lambda p, x, y, m: y * ROW_S * (1 + p.row_time_error) + x * DWELL_S,
    "wrong_dwell": lambda p, x, y, m: y * ROW_S + x * DWELL_S * (1 + p.dwell_error),
}


@pytest.mark.parametrize("name", TIMES)
def test_pixels_are_visited_at_the_times_of_the_formula(name: str) -> None:
    rate = 0.05
    scenario = calm(**{name: "x200"})
    x_drift = dataclasses.replace(scenario.drift.x, linear_px_s=rate)
    scenario = dataclasses.replace(scenario, drift=dataclasses.replace(scenario.drift, x=x_drift))
    (effect,) = scenario.effects.members
    column = scenario.column()
    assert column.timing.row_start_s.shape[0] == getattr(effect, "scans", 1)
    for visit in range(column.timing.row_start_s.shape[0]):
        x_px, y_px, at = column.specimen_points(range(H), visit, START_S, at_rest(), FRAME)
        for y in range(0, H, 3):
            for x in (0, 1, 44, W - 1):
                time_s = START_S + TIMES[name](effect, x, y, visit)
                lag = (-1) ** y * getattr(effect, "lag_px", 0.0) / 2
                assert at.time_s[y, x] == pytest.approx(time_s, abs=1e-9)
                assert x - x_px[y, x] == pytest.approx(rate * time_s + lag, abs=1e-4)
                assert y_px[y, x] == pytest.approx(y, abs=1e-4)


def test_hum_has_the_overtones_it_is_given() -> None:
    hum = {"defaults": "x10000", "harmonics": [[2, 0.3], [3, -0.5]]}
    for x, y, image_x, image_y, time_s, _ in points(calm(mains_hum=hum)):
        angle = 2 * math.pi * 50.0 * time_s + 0.4
        wave = math.sin(angle) + 0.3 * math.sin(2 * angle) - 0.5 * math.sin(3 * angle)
        assert math.hypot(x - image_x - 0.5 * wave, y - image_y - 0.25 * wave) < 1e-4


def test_two_effects_add_up() -> None:
    scenario = calm(magnification_drift="x200", mains_hum="x10000", charging_local_lens="x10000", warmup_transient="x200")
    by_name: dict[str, Effect] = {member.name: member for member in scenario.effects.members}
    for x, y, image_x, image_y, time_s, _ in points(scenario):
        hum = RASTER["mains_hum"](by_name["mains_hum"], x, y, time_s)
        grown = RASTER["magnification_drift"](by_name["magnification_drift"], x - hum[0], y - hum[1], time_s)
        warm = RASTER["warmup_transient"](by_name["warmup_transient"], x, y, time_s)
        bent = MATERIAL["charging_local_lens"](by_name["charging_local_lens"], image_x, image_y, time_s)
        u, v = (sum(part) for part in zip(hum, grown, warm, bent, strict=True))
        assert math.hypot(x - image_x - u, y - image_y - v) < 1e-4


def test_what_shakes_the_beam_is_averaged_by_integration() -> None:
    scenario = calm(vibration="x10000", frame_integration={"scans": 3}, row_jitter="x200")
    column = scenario.column()
    by_name: dict[str, Any] = {member.name: member for member in scenario.effects.members}
    for visit in range(3):
        x_px, _, at = column.specimen_points(range(H), visit, START_S, at_rest(), FRAME)
        for y in (0, 17, H - 1):
            for x in (0, 30, W - 1):
                time_s = START_S + (visit * H * ROW_S + y * ROW_S + x * DWELL_S) / 3
                shaken = RASTER["vibration"](by_name["vibration"], x, y, time_s)[0]
                jitter = 0.03 * gaussian(1, 1_000_003 * FRAME + visit, y)
                assert x - x_px[y, x] == pytest.approx(shaken + jitter, abs=1e-4)
                assert at.visit == visit


def test_effects_in_strips_equal_those_in_the_complete_frame() -> None:
    every = {name: "x200" for name in LIBRARY if name != "dic_subpixel_bias"}
    column = calm(**every).column()
    motion = at_rest(load_n=LOAD_N, history=HISTORY)
    whole = np.empty((H, W), dtype=np.uint16)
    column.render_rows(whole, 0, START_S, motion, FRAME)
    for first in range(0, H, 16):
        strip = np.empty_like(whole[first : first + 16])
        column.render_rows(strip, first, START_S, motion, FRAME)
        assert np.array_equal(strip, whole[first : first + 16])
