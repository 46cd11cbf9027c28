"""Figures of a trial, from the device's record and the run's log."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from .scenario import TOLERANCE_N, Observed
from .truth import longest_silence, merged, motion_orders, peak, stop_requests, unloadings, when_force_passes, without_foreign

if TYPE_CHECKING:
    from .laboratory import Trial

STIFFNESS_N_MM = 20_000.0


def observe(
    trial: Trial, ended_s: float, by_itself: bool, exit_code: int | None, waits: bool, second: str, counted: int | None
) -> Observed:
    """Collect what was seen; to be called while the device still runs.

    Args:
        trial: the trial.
        ended_s: when it was ended, CLOCK_MONOTONIC.
        by_itself: the daemon had ended before.
        exit_code: of the daemon.
        waits: it waited for the operator, paused or in recover.
        second: what a second daemon printed.
        counted: how many faults were found before it was ended; None: all count.
    """
    must, fault_s = trial.scenario.expected, trial.fault_s
    entries = without_foreign(trial.device.entries(), trial.foreign)
    readings = merged(entries, list(trial.device.samples))
    instant_s = fault_s
    if must.since_force_n is not None and fault_s is not None:
        instant_s = when_force_passes(readings, must.since_force_n, fault_s)
    stops_s = stop_requests(entries, fault_s, ended_s) if fault_s is not None else []
    if instant_s is not None and stops_s and stops_s[0] < instant_s:
        instant_s = stops_s[0]
    resumed_s = [item.at_s for item in motion_orders(entries, stops_s[0])] if stops_s else []
    now = trial.device.state()
    stiffness_n_mm = float(str(trial.scenario.device.get("stiffness_n_mm", STIFFNESS_N_MM)))
    unloading = unloadings(entries, stiffness_n_mm, TOLERANCE_N)
    follower = trial.follower
    return Observed(
        fault_s=fault_s,
        ended_s=ended_s,
        by_itself=by_itself,
        exit_code=exit_code,
        said=" ".join(item.output_text() for item in trial.daemons),
        faults=tuple(follower.faults[:counted]),
        states=tuple(state for state, _, _ in follower.states),
        loaded_pairs=follower.loaded_pairs,
        peak_n=peak(readings),
        final_n=now.force_n if now else 0.0,
        instant_s=instant_s,
        stops_s=tuple(stops_s),
        silence_s=longest_silence(readings, stops_s, ended_s, resumed_s),
        rested=bool(now and not now.moving),
        unloadings=tuple(f"from {item.from_n:.0f} to {item.to_n:.0f} N" for item in unloading),
        orders=len(motion_orders(entries, fault_s)) if fault_s is not None else 0,
        moved=bool(motion_orders(entries, 0.0)),
        registers=trial.device.registers(),
        second=second,
        asked=waits,
        wall_s=time.monotonic() - trial.begun_s,
        start_s=follower.states[0][2] - trial.daemons[0].started_s if follower.states else 0.0,
    )
