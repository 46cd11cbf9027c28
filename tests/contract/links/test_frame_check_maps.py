"""The short form of tests/benchmarks/bench_frame_check.py: wrong maps of a simulated bench."""

from __future__ import annotations

import random
from pathlib import Path

from bench_frame_check import judge, simulated_bench
from frame_check_maps import ERRORS, simulated_truth, wrong_maps


def test_wrong_maps_are_never_sound_and_nearly_all_are_explained(tmp_path: Path) -> None:
    assert len(ERRORS) == 11
    with simulated_bench(tmp_path, 217.4) as port:
        truth = simulated_truth(port, 217.4)
        outcomes = [judge(case, tmp_path) for case in wrong_maps([truth], random.Random(5), 8)]
        assert not any(outcome.sound for outcome in outcomes)
        assert sum(outcome.named for outcome in outcomes) >= 7
