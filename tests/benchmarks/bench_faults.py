"""The campaign of faults: each is injected against the real daemon, and what must happen is asserted.

    python tests/benchmarks/bench_faults.py [--rows 1,4,30-33] [--short] [--write]

The load frame is a program behind a real socket or pseudo-terminal (tests/fault/campaign/stand.py), images are written into a real folder,
the daemon is the process that `semlive run` starts. One line a row; `--write` puts what was found into the table of
docs/reference/faults.md, row by row, so the campaign can be taken in pieces. The exit code is 1 if a row failed.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fault" / "campaign"))
from lab import laboratory
from rows import ROWS
from table import Kind, Row

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "faults.md"
_WINDOWS = "not run: what follows from the system's answer is tests/fault/test_watch_open_elsewhere.py"
_LINE = re.compile(r"^\| (\d+) \|.*$", re.MULTILINE)


def run_row(row: Row, folder: Path) -> tuple[bool, str]:
    """Whether it passed, and its line of the table."""
    began_s = time.monotonic()
    try:
        with laboratory(folder) as lab:
            observed = row.run(lab)
    except Exception as error:
        sys.stderr.write("".join(traceback.format_exception(error)[-3:]))
        printed = re.sub(r"live page: \S+ ", "", " ".join(str(error).split()))
        return False, _line(row, f"**failed**: {printed[:200]}", "")
    sys.stderr.write(f"{time.monotonic() - began_s:5.1f} s ")
    stop = "" if observed.stop_ms is None else f"{observed.stop_ms:.0f} ms"
    return True, _line(row, observed.what, stop)


def _line(row: Row, happened: str, stop: str) -> str:
    cells = (str(row.number), row.fault, row.must, happened.replace("|", "/"), stop, row.kind.value)
    return f"| {' | '.join(cells)} |"


def write(lines: dict[int, str]) -> None:
    """Replace the rows of the page that were run."""
    text = PAGE.read_text(encoding="utf-8")
    waiting = {row.number: _line(row, "not run yet", "") for row in ROWS}
    waiting |= {row.number: _line(row, _WINDOWS, "") for row in ROWS if row.kind is Kind.WINDOWS}
    there = waiting | {int(found[1]): found[0] for found in _LINE.finditer(text)} | lines
    head, _, rest = text.partition("<!-- rows -->\n")
    _, _, tail = rest.partition("<!-- end of rows -->")
    rows = "\n".join(there[number] for number in sorted(there))
    PAGE.write_text(f"{head}<!-- rows -->\n{rows}\n<!-- end of rows -->{tail}", encoding="utf-8")


def row_numbers(text: str) -> set[int]:
    """Numbers from "1,4,30-33"."""
    found: set[int] = set()
    for part in text.split(","):
        low, _, high = part.partition("-")
        found |= set(range(int(low), int(high or low) + 1))
    return found


def main() -> int:
    """Run the requested rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=row_numbers, default=None)
    parser.add_argument("--short", action="store_true", help="only those that the tests run")
    parser.add_argument("--write", action="store_true", help="put what was found into docs/reference/faults.md")
    options = parser.parse_args()
    failed, passed, lines = [], 0, {}
    for row in ROWS:
        if (options.rows and row.number not in options.rows) or (options.short and not row.short) or row.kind is Kind.WINDOWS:
            continue
        with tempfile.TemporaryDirectory() as name:
            good, lines[row.number] = run_row(row, Path(name) / "lab")
        passed += good
        failed += [] if good else [row.number]
        sys.stdout.write(f"{'pass' if good else 'FAIL'} {lines[row.number]}\n")
        sys.stdout.flush()
        if options.write:
            write(lines)
    sys.stdout.write(f"{passed} passed, {len(failed)} failed{f': {failed}' if failed else ''}\n")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
