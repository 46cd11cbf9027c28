"""The page's benchmark runs, briefly: events reach a browser, viewers get their news, and a week does not fill it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ..waiting import RUN_END_S

BENCH = Path(__file__).parents[1] / "benchmarks" / "bench_page.py"


@pytest.mark.usefixtures("chromium_peer")
def test_every_event_arrives_and_memory_of_a_compressed_week_is_constant() -> None:
    briefly = ["--paints", "1", "--events", "10", "--viewers", "3", "--seconds", "4", "--readings", "2000"]
    reported = subprocess.run([sys.executable, str(BENCH), *briefly], capture_output=True, text=True, timeout=RUN_END_S, check=True).stdout
    observed = re.search(r"log to page: (\d+) of 10 events", reported)
    # Lines that come faster than a busy computer draws are drawn together.
    assert observed is not None
    assert int(observed[1]) >= 3
    assert re.search(r"3 viewers: .*, (?!0\.0)[\d.]+ kB/s each", reported)
    heaps = [float(heap) for heap in re.findall(r"heap ([\d.]+) MB", reported)]
    assert len(heaps) == 4
    assert heaps[-1] < heaps[0] + 5.0
