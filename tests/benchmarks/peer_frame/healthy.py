"""Healthy runs: machines drawn from a seeded generator, in which nothing may be stopped."""

from __future__ import annotations

import random

from .own_cell import COUNT, DISP, LOAD
from .scenario import Ending, Expected, Group, Peer, Scenario

_KINDS = ("noisy", "coarse", "drifting", "slow", "late start", "overshoot", "relaxing", "compliant", "hunting", "steps", "mixed")
_PLANS = ((150.0,), (120.0, 240.0), (200.0, 210.0), (220.0, 110.0), (60.0, 180.0, 90.0))


def _drawn(kind: str, chance: random.Random, disp: bool) -> dict[str, object]:
    """The characters of one kind."""
    u = chance.uniform
    match kind:
        case "noisy":
            return {"noise_n": round(u(0.2, 0.8), 3), "extension_noise_mm": round(u(0.0, 5e-5), 7)}
        case "coarse":
            return {
                "lsb_n": chance.choice([0.1, 0.5, 1.0, 2.0]),
                "extension_lsb_mm": chance.choice([1e-5, 1e-4, 1e-3]),
                "cell_s": round(u(0, 0.2), 3),
            }
        case "drifting":
            return {"drift_n_s": round(u(-0.04, 0.04), 4), "noise_n": round(u(0.02, 0.2), 3)}
        case "slow":
            return {
                "latency_s": round(u(0.04, 0.12), 3),
                "jitter_s": round(u(0.0, 0.03), 3),
                "cell_s": round(u(0.05, 0.3), 3),
                "pieces": chance.choice([0, 1]),
            }
        case "late start":
            return {"start_s": round(u(0.1, 0.25 if disp else 0.8), 2)}
        case "overshoot":
            return {"damping": round(u(0.25, 0.5), 2), "servo_rad_s": round(u(12, 25), 1), "lag_s": round(u(0, 0.1), 3)}
        case "relaxing":
            return {"relax": round(u(0.001, 0.006), 4), "relax_s": round(u(3, 15), 1), "hold_force": chance.choice([0, 1])}
        case "compliant":
            return {
                "toe_n": round(u(10, 60), 1),
                "toe_part": round(u(0.25, 0.6), 2),
                "slack_mm": round(u(0.0, 0.0015), 5),
                "stiffness_n_mm": round(u(5e3, 2e4)),
                "speed_mm_s": 0.08,
            }
        case "hunting":
            return {"hunt_n": round(u(0.3, 1.2), 2), "hunt_hz": round(u(0.3, 3.0), 2), "noise_n": round(u(0.02, 0.2), 3)}
        case _:
            return {"noise_n": round(u(0.02, 0.3), 3)}


def _run(number: int) -> Scenario:
    chance = random.Random(1000 + number)
    disp, kind = bool((number + number // len(_KINDS)) % 2), _KINDS[number % len(_KINDS)]
    device: dict[str, object] = {"seed": number}
    for item in ("noisy", "slow", "relaxing", "hunting") if kind == "mixed" else (kind,):
        device |= _drawn(item, chance, disp)
    loads = list(chance.choice(_PLANS)) if kind in ("steps", "mixed") else [chance.choice([120.0, 180.0, 240.0])]
    rate = chance.choice([20.0, 40.0, 60.0])
    settings: dict[str, object] = {}
    if disp:
        stiffness = float(str(device.get("stiffness_n_mm", 20_000.0))) * chance.uniform(1.0, 1.2)
        settings["approach"] = {"stiffness_n_mm": round(stiffness), "speed_max_mm_s": 0.05}
    return Scenario(
        f"healthy-{number:03}-{kind.replace(' ', '-')}",
        f"{kind}: " + ", ".join(f"{name} {value}" for name, value in device.items() if name != "seed"),
        "the run completes without a fault",
        Expected(Ending.COMPLETE, stop_within_s=None, loaded_pairs=len(loads), no_orders=False, unloads=True),
        map=DISP if disp else chance.choice([LOAD, COUNT]),
        group=Group.HEALTHY,
        peer=Peer.SECOND,
        device=device,
        settings=settings,
        protocol={"loads_n": loads, "ramp_rate_n_s": rate, "load_tolerance_n": 6.0, "hold_s": 1.0},
        unloaded=number % 5 == 0,
    )


def healthy_runs(count: int) -> tuple[Scenario, ...]:
    """The first so many healthy runs; the same for ever."""
    return tuple(_run(number) for number in range(count))
