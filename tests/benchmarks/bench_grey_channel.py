"""The channel of grey levels on the simulated microscope: hidden effects as they are found, and false names where there is nothing.

    python tests/benchmarks/bench_grey_channel.py [--pairs 8] [--nulls 20] [--size 1024 884]

Frames are rendered by the simulator without noise: pairs with moves of the stage, then loads with strain and rotation, four minutes
from pair to pair. Each is exposed with 2, 5 and 10 % of full scale (5, 13 and 26 grey levels) and correlated. Effects have the simulator's
own size and half of it. Nulls are exposed again each time, as many for each noise.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import expose

from semlive import dic
from semlive.data.diagnosis.channels import IntensityDiagnosis
from semlive.data.settings import DicSettings
from semlive.diagnose.intensity.frames import IntensityFrames, intensity_frame, intensity_reference, pair_noise
from semlive.diagnose.intensity.verdict import diagnose_intensity
from semlive_simulators.effects.charging import ChargingFrameRamp, ChargingJump, ChargingLocalLens
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.detector import Contamination, Defocus, GammaChange
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import at_rest

PERCENT = (2, 5, 10)
WIDE_PX = 5000.0
CASES: dict[str, tuple[Effect, ...]] = {
    "contamination 2e-5 /s": (Contamination(2e-5, WIDE_PX, WIDE_PX),),
    "contamination 1e-5 /s": (Contamination(1e-5, WIDE_PX, WIDE_PX),),
    "contamination 2e-5 /s in a box of 1000 x 860 px": (Contamination(2e-5, 1000.0, 860.0),),
    "defocus 1e-4 px/s": (Defocus(1e-4, 2e-4),),
    "defocus 5e-5 px/s": (Defocus(5e-5, 2e-4),),
    "gamma 0.9, gain 1.05, offset -8": (GammaChange(1.05, 0.9, -8.0, 600.0),),
    "gamma 0.95, gain 1.025, offset -4": (GammaChange(1.025, 0.95, -4.0, 600.0),),
    "flashes of 25 levels, 0.3 s": (ChargingJump(1.0, 1200.0, 25.0, 0.3),),
    "flashes of 12.5 levels, 0.3 s": (ChargingJump(0.5, 1200.0, 12.5, 0.3),),
    "contamination 2e-5 /s and defocus 1e-4 px/s": (Contamination(2e-5, WIDE_PX, WIDE_PX), Defocus(1e-4, 2e-4)),
    "charging_frame_ramp (no name of grey)": (ChargingFrameRamp(0.15, 0.3, 5.0, 20.0, 1800.0),),
    "charging_local_lens (no name of grey)": (ChargingLocalLens(0.3, 80.0, 10.0, 900.0, ((310.0, 250.0), (720.0, 610.0))),),
}
YAWS_RAD = (0.0, 3e-4)
SHIFTS_PX = ((0.0, 0.0), (16.0, 0.0), (-24.0, 0.0), (0.0, 16.0), (0.0, -32.0), (5.0, -3.0))
STEP_S = 45.0


@dataclasses.dataclass(frozen=True, slots=True)
class Run:
    """Frames without noise and when they began."""

    scenario: Scenario
    images: tuple[np.ndarray, ...]
    start_s: tuple[float, ...]


def rendered(pairs: int, size_px: tuple[int, int], *effects: Effect, yaw_rad: float = 0.0) -> Run:
    """Pairs of frames without noise; from the seventh on under load. Every second pair is turned."""
    paper = load_scenario("paper_x200")
    detector = dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0, bits=16)
    scan = dataclasses.replace(paper.scan, width_px=size_px[0], height_px=size_px[1], frame_time_s=size_px[1] * paper.scan.row_time_s)
    scenario = dataclasses.replace(paper, scan=scan, effects=EffectSet(effects), detector=detector)
    column, images, starts, at_s = scenario.column(), [], [], 2.0
    for pair in range(pairs):
        load_n = 500.0 * max(0, pair + 1 - len(SHIFTS_PX))
        shift = SHIFTS_PX[min(pair, len(SHIFTS_PX) - 1)]
        motion = at_rest(shift, scenario.specimen.gradient(load_n, yaw_rad * (pair % 2)), load_n)
        for member in (0, 1):
            # In 16 bit: grey rounded to 8 bit without noise is a quarter of a level off, equally all over the gold.
            images.append(render_frame(scenario, at_s, motion, 2 * pair + member, column).astype(np.float32) / 256.0)
            starts.append(at_s)
            at_s += scan.frame_time_s + scan.gap_s
        at_s += STEP_S
    return Run(scenario, tuple(images), tuple(starts))


def series(run: Run, percent: float, seed: int) -> IntensityFrames:
    """Grey of the frames, exposed with noise and correlated."""
    scan = run.scenario.scan
    roi_px = (101, 101, 846, 696) if scan.width_px == 1024 else None
    settings = DicSettings(step_px=15, roi_px=roi_px)
    grid = dic.grid_for(settings, scan.width_px, scan.height_px)
    images = [expose(entry, 2.55 * percent, 100_000 * int(percent) + 1000 * seed + at) for at, entry in enumerate(run.images)]
    ready = dic.prepare(images[0], grid, settings)
    maps = [dic.correlate(ready, entry, settings, reference_frame=0, current_frame=at) for at, entry in enumerate(images[1:], start=1)]
    grey = [entry.astype(np.float32) for entry in images]
    reference = intensity_reference(grey[0], grey[1], maps[0])
    assert reference is not None
    frames = [
        intensity_frame(reference, grey[entry.current], entry, run.start_s[entry.current] - run.start_s[0], scan.row_time_s)
        for entry in maps
    ]
    return IntensityFrames(reference, tuple(frames), np.array([pair_noise(reference.blocks, grey[0], grey[1], maps[0])]))


def summary(found: IntensityDiagnosis) -> str:
    """A verdict in a line."""
    effects = []
    for entry in found.effects:
        reported = ", ".join(f"{item.name} {item.value:.4g} +- {item.sigma:.2g}" for item in entry.parameters)
        effects.append(f"{entry.name} ({reported}; logarithm of the Bayes factor {entry.log_bayes_factor:.0f})")
    dark, slope = found.noise
    return f"{found.outcome.value} {'; '.join(effects)} {found.unexplained} [noise {dark.value:.1f} + {slope.value:.3f} I]"


def nulls(pairs: int, size_px: tuple[int, int], count: int) -> Iterator[tuple[str, IntensityDiagnosis]]:
    """Verdicts where nothing is hidden that grey levels should name."""
    for yaw_rad in YAWS_RAD:
        run = rendered(pairs, size_px, yaw_rad=yaw_rad)
        for percent in PERCENT:
            for seed in range(count):
                yield f"yaw {yaw_rad} rad, noise {percent} %, seed {seed}", diagnose_intensity(series(run, percent, 2 + seed))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--nulls", type=int, default=20, help="for each noise, without and with stage yaw")
    parser.add_argument("--size", type=int, nargs=2, default=(1024, 884), help="of the frames, px")
    requests = parser.parse_args()
    size_px = (requests.size[0], requests.size[1])
    for name, effects in CASES.items():
        run = rendered(requests.pairs, size_px, *effects)
        for percent in PERCENT:
            begin = time.process_time()
            found = diagnose_intensity(series(run, percent, 1))
            sys.stdout.write(f"{name}, noise {percent} %: {summary(found)} [{time.process_time() - begin:.1f} s]\n")
            sys.stdout.flush()
    false, p_values = 0, []
    for name, found in nulls(requests.pairs, size_px, requests.nulls):
        p_values.append(found.where[0].p_value)
        if found.outcome.value != "NONE":
            false += 1
            sys.stdout.write(f"null, {name}: {summary(found)}\n")
            sys.stdout.flush()
    count = len(p_values)
    bound = float(beta.ppf(0.95, false + 1, count - false)) if false < count else 1.0
    sys.stdout.write(f"false names: {false} of {count} nulls of {requests.pairs} pairs, one-sided 95 % bound {100 * bound:.1f} %\n")
    if count:
        sys.stdout.write(
            f"p of intensity below 0.01 in {np.mean(np.array(p_values) < 0.01):.3f}, below 0.1 in {np.mean(np.array(p_values) < 0.1):.3f}\n"
        )


if __name__ == "__main__":
    main()
