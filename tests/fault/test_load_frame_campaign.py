"""The decisive part of the campaign against load frames that misbehave (docs/validation/load-frame-safety.md).

All of it is `python tests/benchmarks/bench_peer_frame.py`. The source of the independent frame, gcc and libmodbus are needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import pytest
from peer_frame.building import PEERS, missing_tool
from peer_frame.campaign import Campaign, chosen
from peer_frame.catalogue import ALL
from peer_frame.healthy import healthy_runs
from peer_frame.scenario import Group
from peer_frame.verdict import Verdict, figures

JOBS = 2
"""Trials at the same time: they wait for the machine most of the time. With three, and other tests at the same time, a thread of a link did
not run for 4 s, which is reported as a driver that hangs."""
SHORT = chosen([], short=True, healthy=None)


@pytest.fixture(scope="module")
def frame_peer(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A campaign with the independent frame, built here."""
    if why := missing_tool(PEERS):
        pytest.skip(why)
    return Campaign(PEERS, tmp_path_factory.mktemp("campaign"))


@pytest.fixture(scope="module")
def verdicts(frame_peer: Campaign) -> Mapping[str, Verdict]:
    with ThreadPoolExecutor(JOBS) as pool:
        return {item.scenario.name: item for item in pool.map(frame_peer.judged, SHORT)}


@pytest.mark.parametrize("name", [item.name for item in SHORT])
def test_what_must_happen_happens(verdicts: Mapping[str, Verdict], name: str) -> None:
    assert verdicts[name].failings == ()


def test_the_bars_hold(verdicts: Mapping[str, Verdict]) -> None:
    bars = figures(list(verdicts.values()))
    assert bars.hold, bars


def test_there_are_twice_as_many_own_scenarios_as_listed_ones() -> None:
    groups = [item.group for item in ALL]
    assert groups.count(Group.OWN) >= 2 * groups.count(Group.README) >= 2 * 50


def test_healthy_runs_are_drawn_reproducibly() -> None:
    assert healthy_runs(100) == healthy_runs(100)
    assert len({item.name for item in (*ALL, *healthy_runs(100))}) == len(ALL) + 100
