"""Campaigns of two runs each: continue where they stopped, in shards, and put their table into the page."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

PAGE = Path(__file__).parents[3] / "docs" / "validation" / "diagnosis.md"


class CampaignCase(Protocol):
    """A case."""

    @property
    def key(self) -> str:
        """By which its verdict is known."""
        ...

    def verdict(self) -> dict[str, Any]:
        """With its key."""
        ...


def run(
    about: str | None, name: str, cases: Callable[[int, int], Iterator[CampaignCase]], table: Callable[[list[dict[str, Any]]], str]
) -> None:
    """Run what is missing, or score what is there.

    Args:
        about: text of `--help`.
        name: of the verdict files, and of the page's part.
        cases: so many seeds, and so many with nothing hidden.
        table: of verdicts, as Markdown.
    """
    requests = _arguments(about, name)
    requests.folder.mkdir(parents=True, exist_ok=True)
    own, shards = (int(item) for item in requests.shard.split("/"))
    chosen, begin = list(cases(requests.seeds, requests.nulls)), time.monotonic()
    done = _verdicts(requests.folder, name)
    for case in [] if requests.score else chosen[own - 1 :: shards]:
        if case.key not in done and time.monotonic() - begin < requests.seconds:
            with (requests.folder / f"{name}-{own}-of-{shards}.jsonl").open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(case.verdict()) + "\n")
    done = _verdicts(requests.folder, name)
    found = table([done[item.key] for item in chosen if item.key in done])
    sys.stdout.write(found)
    if requests.write:
        first, last = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->\n"
        before, rest = PAGE.read_text(encoding="utf-8").split(first)
        PAGE.write_text(f"{before}{first}\n{found}\n{last}{rest.split(last)[1]}", encoding="utf-8")


def _arguments(about: str | None, name: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--nulls", type=int, default=4)
    parser.add_argument("--folder", type=Path, default=Path(name))
    parser.add_argument("--shard", default="1/1", help="k/n: every n-th case from the k-th on")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--score", action="store_true", help="run nothing")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    return parser.parse_args()


def _verdicts(folder: Path, name: str) -> dict[str, dict[str, Any]]:
    lines = [line for path in sorted(folder.glob(f"{name}-*.jsonl")) for line in path.read_text(encoding="utf-8").splitlines()]
    return {str(item["key"]): item for item in map(json.loads, lines)}
