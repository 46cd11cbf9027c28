"""The decisive part of the campaign over every shipped map and driver (docs/validation/load-frame-safety.md).

All of it is `python tests/benchmarks/bench_every_map.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import pytest
from peer_frame.campaign import Campaign
from peer_frame.every_map import EVERY_MAP, SHORT
from peer_frame.map_setups import SETUPS
from peer_frame.verdict import Verdict, figures

from semlive_drivers.maps import bundled_maps

JOBS = 3
"""Trials at the same time: each waits for its machine most of the time, but its start takes three seconds of a processor; the starts
of six made another's stop late on a busy computer."""


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Verdict]:
    campaign = Campaign(None, tmp_path_factory.mktemp("campaign"))
    with ThreadPoolExecutor(JOBS) as pool:
        return {one.scenario.name: one for one in pool.map(campaign.judged, (one for one in EVERY_MAP if one.short))}


@pytest.mark.parametrize("name", sorted(SHORT))
def test_what_must_happen_happens(verdicts: Mapping[str, Verdict], name: str) -> None:
    assert verdicts[name].failings == ()


def test_the_bars_hold(verdicts: Mapping[str, Verdict]) -> None:
    bars = figures(list(verdicts.values()))
    assert bars.hold, bars


def test_every_shipped_map_is_in_the_campaign() -> None:
    assert {name for setup in SETUPS for name in setup.maps} == set(bundled_maps())


def test_every_load_frame_driver_that_moves_is_in_the_campaign() -> None:
    assert {setup.driver for setup in SETUPS} == {"modbus", "ascii", "assembled", "operator"}


def test_names_are_unique() -> None:
    assert len({one.name for one in EVERY_MAP}) == len(EVERY_MAP)
