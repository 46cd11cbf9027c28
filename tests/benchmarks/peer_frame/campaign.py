"""Selection of scenarios, and execution of each with its device."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from .building import build
from .catalogue import ALL
from .healthy import healthy_runs
from .kept import keep, read_stored
from .laboratory import carry_out
from .scenario import Peer, Scenario
from .verdict import Verdict, judge

HEALTHY = 100
SECOND = Path(__file__).with_name("second_frame.py")
MAP_DEVICE = Path(__file__).with_name("map_device.py")


def chosen(only: Sequence[str], short: bool, healthy: int | None) -> tuple[Scenario, ...]:
    """The requested scenarios.

    Args:
        only: begins of names; empty: all.
        short: those of the short campaign.
        healthy: how many healthy runs; None: as many as fit the choice.
    """
    faults = [item for item in ALL if (not short or item.short) and (not only or item.name.startswith(tuple(only)))]
    if healthy is None:
        healthy = 3 if short else 0 if only and faults else HEALTHY
    runs = [item for item in healthy_runs(healthy) if not only or faults or item.name.startswith(tuple(only))]
    return (*faults, *runs)


class Campaign:
    """Builds the devices once, and carries out scenarios.

    Args:
        peers: folder of the independent frame; None: no scenario needs it, and it is not built.
        folder: where trials are carried out.
        found: file in which what was observed is kept.

    Raises:
        CannotBuild: the independent frame cannot be built.
    """

    def __init__(self, peers: Path | None, folder: Path, found: Path | None = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._found, self._known = found, read_stored(found)
        self._peers, self._folder = peers or folder, folder
        self._frame = None if peers is None else build(peers, folder)

    def judged(self, scenario: Scenario) -> Verdict:
        """Carry out a scenario, unless the file contains its result, and judge it; a trial that cannot be carried out counts as failed."""
        if scenario.name in self._known:
            return judge(scenario, self._known[scenario.name])

        def command(port: int, log: Path) -> list[str]:
            if scenario.peer is Peer.C:
                return [str(self._frame), str(port), str(log), str(scenario.clients)]
            options = [f"{name}={value}" for name, value in scenario.device.items()]
            if scenario.peer is Peer.MAP:
                return [sys.executable, str(MAP_DEVICE), str(port), str(log), scenario.kind, *options]
            return [sys.executable, str(SECOND), str(port), str(log), *options]

        try:
            observed = carry_out(scenario, command, self._folder / scenario.name, self._peers)
            if self._found is not None:
                keep(self._found, scenario.name, observed)
            return judge(scenario, observed)
        except Exception as error:
            sys.stderr.write("".join(traceback.format_exception(error)))
            return Verdict(scenario, None, (f"the trial was not carried out: {type(error).__name__}: {error}",))
