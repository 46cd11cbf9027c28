"""Processor time of each test file, its child processes included: a plugin, which is loaded by name, and a table.

    SEMLIVE_PROCESSOR_TIME=times.txt python -m pytest -p tests.processor_time [options]
    python tests/processor_time.py times.txt

Wall time does not show it: tests wait for machines in real time, and several run at once. With several processes every one of them appends
its lines. The time of a child counts for the test that waits for its end, so a bench of a module counts for the module's last test.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest


def _spent_s() -> tuple[float, float]:
    """Processor time of this process, and of its children that have ended."""
    times = os.times()
    return times.user + times.system, times.children_user + times.children_system


_before_s = [_spent_s()]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Append one line for the test; what was spent since the test before, such as collecting, counts for it too."""
    result = yield
    now_s = _spent_s()
    own_s, children_s = (now - before for now, before in zip(now_s, _before_s[0], strict=True))
    _before_s[0] = now_s
    with Path(os.environ["SEMLIVE_PROCESSOR_TIME"]).open("a", encoding="utf-8") as stream:
        stream.write(f"{own_s:.3f}\t{children_s:.3f}\t{item.nodeid}\n")
    return result


def main() -> None:
    """Print the files with the largest processor time."""
    own_s, children_s = Counter[str](), Counter[str]()
    for line in Path(sys.argv[1]).read_text(encoding="utf-8").splitlines():
        own, children, test = line.split("\t", 2)
        own_s[test.partition("::")[0]] += float(own)
        children_s[test.partition("::")[0]] += float(children)
    total_s = own_s + children_s
    sys.stdout.write(f"{'all, s':>8} {'own, s':>8} {'children':>8}\n")
    sys.stdout.write(f"{total_s.total():8.1f} {own_s.total():8.1f} {children_s.total():8.1f} {len(total_s)} files\n")
    for name, spent_s in total_s.most_common(60):
        sys.stdout.write(f"{spent_s:8.1f} {own_s[name]:8.1f} {children_s[name]:8.1f} {name}\n")


if __name__ == "__main__":
    main()
