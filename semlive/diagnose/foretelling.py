"""What the experiments that a run could be followed by are expected to decide, and how much beam time they take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from semlive.data.diagnosis import Diagnosis, Foretold, KnownEffect, Outcome
from semlive.data.experiment import Phase
from semlive.diagnose.baseline import Ladder
from semlive.diagnose.evidence import weigh
from semlive.diagnose.foretold import NOTHING, expected_odds, predicted
from semlive.diagnose.known import family_of, joined, showing
from semlive.diagnose.noise import quiet
from semlive.diagnose.observation import MIN_PAIRS, Observation
from semlive.diagnose.propose import Kind
from semlive.diagnose.protocols import Protocol, changed_protocol
from semlive.diagnose.refine import Refined, refined
from semlive.diagnose.rehearsal import PlannedRun, PlannedStep, rehearsed
from semlive.errors import IllPosed
from semlive.model.effects import DICTIONARY

MOST_PAIRS = 32  # that diagnosis takes
UNLOADED = (Kind.PARKED, Kind.AGAIN, Kind.REVERSED, Kind.OTHER_SCAN)
OTHER_DWELLS = (0.5, 2.0)
LOADED = (Kind.LONGER_HOLD, Kind.DUMMY_STEPS, Kind.UNLOAD)


def foretold(seen: Observation, found: Diagnosis, known: Sequence[KnownEffect] = ()) -> tuple[Foretold, ...]:
    """What each experiment would decide between the effects that are left open, or of one effect against nothing; the most a minute first.

    Experiments are those that need nothing the run did not have: loads, moves, another dwell. What turns with the scan is in no law, so
    a turned scan is not among them. None where the names that are left open are one effect to a map.

    Args:
        seen: what the run shows.
        found: the verdict.
        known: effects that the model had before.
    """
    named = {one.name for one in DICTIONARY}
    between = found.ambiguous or tuple(one.name for one in found.effects)
    asked = dict.fromkeys(one.law.name for one in found.effects if one.name in between and one.law.name in named)
    asked |= dict.fromkeys(name for name in between if name in named)
    if not asked or (found.outcome is Outcome.AMBIGUOUS and len(asked) < 2):
        return ()
    beside = [one for one in (*known, *(one.law for one in found.effects)) if one.name in named and one.name not in asked]
    beside = showing(seen, beside)
    before = joined(quiet(seen), beside)[0]
    rivals = [refined(before, one) for one in weigh(before, [family_of(name) for name in asked])]
    told = [_told(kind, run, before, rivals, beside) for kind, run in _menu(seen)]
    return tuple(sorted((one for one in told if one is not None), key=lambda one: -one.per_minute))


def _told(kind: Kind, run: PlannedRun, before: Ladder, rivals: Sequence[Refined], beside: Sequence[KnownEffect]) -> Foretold | None:
    try:
        ahead = rehearsed(before, run, beside)
    except IllPosed:
        return None  # it leaves too little to diagnose
    said = [predicted(ahead, before, one) for one in rivals]
    if not any(len(one.mean) for one in said):
        return None  # it shows none of them
    said += [NOTHING] if len(said) == 1 else []
    odds = expected_odds(ahead, said)
    true, other = min(permutations(range(len(said)), 2), key=lambda pair: float(odds[pair]))
    return Foretold(kind.value, run.dwell, run.duration_s / 60.0, float(odds[true, other]), said[true].name, said[other].name)


def _menu(seen: Observation) -> Iterator[tuple[Kind, PlannedRun]]:
    protocol = _protocol(seen)
    moved, loaded = any(any(one) for one in protocol["calibration_shifts_px"]), any(protocol["loads_n"])
    for kind in (*(UNLOADED if moved else (Kind.PARKED,)), *(LOADED if loaded else ())):
        for dwell in OTHER_DWELLS if kind is Kind.OTHER_SCAN else (1.0,):
            run = planned(seen, kind, dwell)
            if MIN_PAIRS <= len(run.steps) <= MOST_PAIRS:
                yield kind, run


def _protocol(seen: Observation) -> Protocol:
    """What the run did, as its configuration would say it."""
    scene = seen.scene
    place = np.cumsum(scene.move_px[::2], axis=0)
    loads = 0.5 * (scene.load_n[::2] + scene.load_n[1::2])
    return {
        "calibration_shifts_px": place[~scene.free[::2]].tolist(),
        "loads_n": loads[scene.loaded[::2]].tolist(),
        "hold_s": float(scene.since_step_s[0]),
    }


def planned(seen: Observation, kind: Kind, dwell: float = 1.0) -> PlannedRun:
    """An experiment after a run: in time as the run was, longer by what is held or scanned longer.

    Args:
        seen: what the run shows.
        kind: of the experiment.
        dwell: dwell, row and frame time, of those of the run.
    """
    scene, protocol = seen.scene, changed_protocol(_protocol(seen), kind)
    longer_s = (dwell - 1.0) * seen.state.frame_time(int(scene.frame[0])).timing.duration_s
    held_s = protocol["hold_s"] - float(scene.since_step_s[0])
    apart_s = float(np.median(scene.start_s[1::2] - scene.start_s[::2])) + longer_s
    each_s = float(np.median(np.diff(scene.start_s[::2]))) + 2.0 * longer_s + held_s
    steps = [(Phase.CALIBRATION, 0.0, tuple(one)) for one in protocol["calibration_shifts_px"]]
    steps += [(Phase.TENSION, load, (0.0, 0.0)) for load in protocol["loads_n"]]
    told = [
        PlannedStep(phase, load, shift, protocol["hold_s"], (each_s * at, each_s * at + apart_s))
        for at, (phase, load, shift) in enumerate(steps)
    ]
    return PlannedRun(tuple(told), dwell, each_s * len(told))
