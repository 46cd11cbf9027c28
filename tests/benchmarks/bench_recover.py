"""What `semlive recover` keeps of a damaged log: random truncation, flipped bits, zero pages, rubbish after the cut.

    python tests/benchmarks/bench_recover.py [--log LOG] [--cases 1000] [--max-mb 16]

Without --log the short demo makes one (a minute); of a larger log the first --max-mb are taken. The place of each message is given by
the mcap library's own index of the complete log, and whether a recovered log is valid by the library's indexed reader. Held to:

* truncated: every message that ends before the cut is kept;
* a flipped bit, or a zero page of 4096 bytes: every message outside the chunks that it touched is kept;
* always: what is kept are messages of the log as they were, in their order, and the recovered log is valid and indexed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from semlive.service.log.repair import RepairSummary, recover_segment

PAGE = 4096
KINDS = ("truncated", "truncated, then rubbish", "bit", "page", "unfinished, bit", "unfinished, page")


@dataclass(frozen=True)
class Standing:
    """A message of the complete log, and its place."""

    key: tuple[str, int, int, int, bytes]
    start: int
    end: int
    chunk: tuple[int, int]


def standing(data: bytes) -> list[Standing]:
    """Every message of a complete log in file order, by the mcap library's index."""
    reader = make_reader(BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    found = []
    for index in summary.chunk_indexes:
        chunk = (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length)
        # Kind, length, two times, size, checksum, name of no compression, size: 49 bytes.
        inside, end = chunk[0] + 49, chunk[1]
        at = inside
        while at < end:
            length = int.from_bytes(data[at + 1 : at + 9], "little")
            if data[at] == 5:
                body = data[at + 9 : at + 9 + length]
                number, sequence = int.from_bytes(body[:2], "little"), int.from_bytes(body[2:6], "little")
                times = int.from_bytes(body[6:14], "little"), int.from_bytes(body[14:22], "little")
                found.append(Standing((summary.channels[number].topic, sequence, *times, body[22:]), at, at + 9 + length, chunk))
            at += 9 + length
    return found


@dataclass(frozen=True)
class Case:
    """One damage: the spoilt log, and what must be kept of it."""

    name: str
    data: bytes
    must: list[Standing]


def cases(data: bytes, messages: list[Standing], count: int, seed: int = 6) -> Iterator[Case]:
    """Random damages, each kind in turn."""
    rng = np.random.default_rng(seed)
    data_end = messages[-1].chunk[1]
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        spoilt = bytearray(data if not kind.startswith("unfinished") else data[:data_end])
        at = int(rng.integers(len(spoilt)))
        if kind.startswith("truncated"):
            rubbish = rng.integers(0, 256, int(rng.integers(1, PAGE)), dtype=np.uint8).tobytes() if kind != "truncated" else b""
            if rng.integers(2):
                rubbish = bytes(len(rubbish))
            yield Case(f"{kind} at {at}", bytes(spoilt[:at]) + rubbish, [item for item in messages if item.end <= at])
            continue
        if kind.endswith("bit"):
            begin, end = at, at + 1
            spoilt[at] ^= 1 << int(rng.integers(8))
        else:
            begin = at - at % PAGE
            end = min(begin + PAGE, len(spoilt))
            spoilt[begin:end] = bytes(end - begin)
        yield Case(f"{kind} at {begin}", bytes(spoilt), [item for item in messages if item.chunk[1] <= begin or item.chunk[0] >= end])


def held(case: Case, recovered: RepairSummary, all_keys: list[tuple[str, int, int, int, bytes]]) -> int:
    """Check a recovered log; how many messages it kept beyond what it must.

    Raises:
        AssertionError: it does not hold what it must, or more than there was, or is not valid.
    """
    with recovered.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None, case.name
        assert summary.statistics is not None, case.name
        stored = [
            (channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
    assert summary.statistics.message_count == len(stored) == sum(recovered.recovered.values()), case.name
    rest = iter(all_keys)
    assert all(key in rest for key in stored), f"{case.name}: a message that was not there, or out of order"
    missing = Counter(item.key[:2] for item in case.must) - Counter(key[:2] for key in stored)
    assert not missing, f"{case.name}: lost {dict(missing)}"
    lost = len(all_keys) - len(stored)
    if recovered.lost_is_complete:
        assert sum(recovered.lost.values()) == lost, f"{case.name}: lost {lost}, reported {dict(recovered.lost)}"
    else:
        assert sum(recovered.lost.values()) <= lost, f"{case.name}: lost {lost}, reported {dict(recovered.lost)}"
    return len(stored) - len(case.must)


def campaign(data: bytes, count: int, folder: Path) -> list[str]:
    """Spoil, recover and check; returns lines to print.

    Raises:
        AssertionError: a recovered log is not what it must be.
    """
    messages = standing(data)
    all_keys = [item.key for item in messages]
    done, stored, must, more, exact = Counter[str](), Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    began = time.process_time()
    for number, case in enumerate(cases(data, messages, count)):
        kind = case.name.split(" at ")[0]
        path = folder / f"{number}.mcap.part"
        path.write_bytes(case.data)
        recovered = recover_segment(path)
        beyond = held(case, recovered, all_keys)
        done[kind] += 1
        must[kind] += len(case.must)
        stored[kind] += len(case.must) + beyond
        more[kind] += beyond
        exact[kind] += recovered.lost_is_complete
        for used in (recovered.path, recovered.original):
            if used is not None:
                used.unlink()
    lines = [f"log: {len(data) / 1e6:.1f} MB, {len(messages)} messages, {len({item.chunk for item in messages})} chunks"]
    lines += [
        f"{kind:<18} {done[kind]:4d} cases: {stored[kind]:9d} messages kept of {must[kind]:9d} asked ({more[kind]} more); "
        f"loss reported exactly in {exact[kind]}"
        for kind in done
    ]
    spent = time.process_time() - began
    lines.append(
        f"{sum(done.values())} cases, none lost what it must keep; {spent / max(1, count):.3f} s of processor each, checks included"
    )
    return lines


def main() -> None:
    """The campaign as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--log", type=Path, help="one MCAP file")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--max-mb", type=float, default=16.0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = arguments.log
        if log is None:
            command = [sys.executable, "-m", "semlive", "demo", "--short", "--out", str(folder / "demo")]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            log = folder / "demo" / "log" / "demo" / "demo.000.mcap"
        # What fits, as a log of its own, in today's layout.
        (folder / "taken.mcap.part").write_bytes(log.read_bytes()[: int(arguments.max_mb * 1e6)])
        whole = recover_segment(folder / "taken.mcap.part").path
        for line in campaign(whole.read_bytes(), arguments.cases, folder):
            sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
