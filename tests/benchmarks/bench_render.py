"""Processor time of a rendered frame, one thread, warm: ``python tests/benchmarks/bench_render.py [scenario ...]``.

Bars: 0.5 s for a frame, 6 s for one of 16 integrated scans.
"""

from __future__ import annotations

import dataclasses
import sys
import time

from semlive_simulators.effects.library import build_effects
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import at_rest

REPEATS = 3
LOAD_N = 2200.0
SPOT_PX = 0.8
EXTRAS = {
    "plain": (),
    "grains": ("grain_strain", "grain_contrast"),
    "hole": ("hole",),
    "notch": ("notch",),
    "charging and hum": ("charging_jump", "charging_local_lens", "mains_hum", "vibration"),
}


def cpu_s(scenario: Scenario) -> float:
    """Least processor time of a few renderings after one that compiles."""
    column, spent = scenario.column(), []
    for frame in range(REPEATS + 1):
        begin = time.thread_time()
        render_frame(scenario, 100.0 * frame, at_rest(load_n=LOAD_N), frame, column)
        spent.append(time.thread_time() - begin)
    return min(spent[1:])


def main(names: list[str]) -> int:
    """Print a table; 1 if anything misses its bar."""
    late = 0
    for name in names or ["paper_x200", "paper_x10000"]:
        magnification = "x10000" if "x10000" in name else "x200"
        for bits, spot_px in ((8, 0.0), (16, 0.0), (8, SPOT_PX)):
            for what, chosen in EXTRAS.items():
                if chosen and (bits == 16 or spot_px > 0.0):
                    continue
                scenario = load_scenario(name)
                scenario = dataclasses.replace(scenario, scan=dataclasses.replace(scenario.scan, spot_px=spot_px))
                detector = dataclasses.replace(scenario.detector, bits=bits)
                effects = build_effects(dict.fromkeys(chosen, magnification))
                scenario = dataclasses.replace(scenario, detector=detector, effects=effects)
                bar_s = 0.5 if scenario.scan.integrations == 1 else 6.0 * scenario.scan.integrations / 16
                spent_s = cpu_s(scenario)
                late += spent_s > bar_s
                sys.stdout.write(f"{name:14} {bits:2} bit  spot {spot_px} px  {what:17} {spent_s:7.3f} s of {bar_s} s\n")
                sys.stdout.flush()
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
