"""Tables under random conventions, with all numbers recorded by their writer: read right or refused, and never wrong."""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

TABLES = 2000


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    path = Path(__file__).parents[1] / "benchmarks" / "fuzz_tables.py"
    spec = importlib.util.spec_from_file_location("fuzz_tables", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_no_number_is_read_wrong(fuzz: ModuleType) -> None:
    counts = Counter[str]()
    for seed in range(TABLES):
        printed, table = fuzz.verdict(seed)
        counts[printed] += 1
        assert printed != "wrong", (seed, table)
    # Neither is everything refused.
    assert counts["right"] > TABLES / 2


def test_what_a_careful_program_writes_is_read(fuzz: ModuleType) -> None:
    plain = [fuzz.verdict(seed)[0] for seed in range(20_000, 40_000) if fuzz.is_plain(fuzz.written(seed))]
    assert len(plain) > 50
    assert plain.count("right") > 0.95 * len(plain)


def test_a_slow_reader_and_the_writer_of_maps_agree(fuzz: ModuleType) -> None:
    campaign = fuzz.Campaign(100_000, 100_000)
    campaign.run(100_800)
    assert campaign.wrong == 0
    assert campaign.verdicts["right"] > 0.5 * campaign.verdicts.total()
    assert campaign.maps["right"] > 0.4 * campaign.maps.total()
    assert "| disparity maps | 200 |" in campaign.page()


def test_the_slow_reader_lists_every_reading(fuzz: ModuleType) -> None:
    both = fuzz.readings(b"a;b\n1.500;2\n", ("a",))
    assert both == {((2, (1.5,)),), ((2, (1500.0,)),)}
    assert fuzz.readings(b'"a","b"\n"1,5","x, ""y"""\n', ("a",)) == {((2, (1.5,)),)}
    assert fuzz.readings(b"a,b\n1,2,3\n", ("a",)) == set()
    table = fuzz.Written(b"a;b\n1.5;2\n", None, ("a",), {})
    assert fuzz.agrees_with_oracle(table, {2: (1.5,)})
    assert not fuzz.agrees_with_oracle(table, {2: (15.0,)})
