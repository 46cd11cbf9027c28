"""How long a command takes to begin: processor time of the complete process, best of several, compared with Python's own.

    python tests/benchmarks/bench_startup.py [--runs 7]

Exits with 1 where the list of commands, the version or a completion takes 0.3 s or more.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence

BAR_S = 0.3
COMPLETION = {"_SEMLIVE_COMPLETE": "complete_bash", "COMP_WORDS": "semlive re", "COMP_CWORD": "1"}
SEMLIVE = ("-c", "import sys; sys.argv[0] = 'semlive'; from semlive.cli.main import main; main()")
CASES: tuple[tuple[str, tuple[str, ...], dict[str, str], bool], ...] = (
    ("python alone", ("-c", ""), {}, False),
    ("semlive --version", (*SEMLIVE, "--version"), {}, True),
    ("semlive --help", (*SEMLIVE, "--help"), {}, True),
    ("semlive, nothing more", SEMLIVE, {}, True),
    ("completion of `semlive re`", SEMLIVE, COMPLETION, True),
    ("semlive init --help", (*SEMLIVE, "init", "--help"), {}, False),
    ("semlive doctor --help", (*SEMLIVE, "doctor", "--help"), {}, False),
    ("semlive run --help", (*SEMLIVE, "run", "--help"), {}, False),
    ("semlive replay --help", (*SEMLIVE, "replay", "--help"), {}, False),
)


def processor_s(arguments: Sequence[str], environ: dict[str, str]) -> float:
    """Processor time of one process, its children included."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], env={**os.environ, **environ}, capture_output=True, timeout=120, check=False)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main() -> int:
    """Measure, print a table, judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--smoke", action="store_true", help="only the first case, one time")
    options = parser.parse_args()
    runs, cases = (1, CASES[:1]) if options.smoke else (options.runs, CASES)
    late = 0
    for name, arguments, environ, judged in cases:
        best = min(processor_s(arguments, environ) for _ in range(runs))
        late += judged and best >= BAR_S
        sys.stdout.write(f"{name:<28} {best:6.2f} s{'  bar 0.30 s' if judged else ''}\n")
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
