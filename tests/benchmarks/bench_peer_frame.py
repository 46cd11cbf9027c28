"""The campaign with faulty load frames: the daemon with an independent frame and a second one.

    python tests/benchmarks/bench_peer_frame.py [--write] [--short] [--only NAME ...] [--healthy N] [--jobs 2] [--peers DIR] [--found FILE]

The independent frame is built from DIR/frame.c (by default `../shared/peers` next to the repository; needs gcc and libmodbus); the second
frame is a program of tests/benchmarks/peer_frame. Each scenario is a run of `semlive run CONFIG --attended` with an operator's terminal and
exported frames; the record of the device contains true force, orders and stops. NAME is a scenario or the beginning of several names;
`--list` shows all. Each scenario prints one line; `--write` writes docs/validation/load-frame-safety.md. Observations are added to FILE;
scenarios in FILE are judged without being run again, so the campaign can be interrupted and continued. The exit status is 1 if a scenario
or a bar failed.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "simulators"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from peer_frame.building import PEERS, CannotBuild
from peer_frame.campaign import Campaign, chosen
from peer_frame.page import line, summary, write
from peer_frame.verdict import figures


def main() -> int:
    """Run the requested scenarios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write docs/validation/load-frame-safety.md")
    parser.add_argument("--short", action="store_true", help="only the scenarios that the tests run, and 3 healthy runs")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="scenarios whose name begins so")
    parser.add_argument("--healthy", type=int, default=None, metavar="N", help="healthy runs (100; 3 with --short, 0 with --only)")
    parser.add_argument("--jobs", type=int, default=2, help="trials at the same time")
    parser.add_argument("--peers", type=Path, default=PEERS, help="folder of the independent frame")
    parser.add_argument("--found", type=Path, default=None, metavar="FILE", help="where what was observed is kept")
    parser.add_argument("--keep", type=Path, default=None, metavar="FOLDER", help="keep logs and outputs there")
    parser.add_argument("--list", action="store_true", help="show names and end")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # trials under way end, and take their processes with them
    scenarios = chosen(options.only, options.short, options.healthy)
    if options.list:
        sys.stdout.writelines(f"{item.name:34} {item.what}\n" for item in scenarios)
        return 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        try:
            campaign = Campaign(options.peers.resolve(), (options.keep or Path(name)).resolve(), options.found)
        except CannotBuild as error:
            sys.stderr.write(f"{error}.\n")
            return 2
        verdicts = []
        with ThreadPoolExecutor(options.jobs) as pool:
            for verdict in pool.map(campaign.judged, scenarios):
                verdicts.append(verdict)
                sys.stdout.write(line(verdict) + "\n")
                sys.stdout.flush()
    bars = figures(verdicts)
    sys.stdout.write(summary(bars) + "\n")
    if options.write:
        names = {str(path): name for path, name in ((options.peers, "DIR"), (options.found, "FILE"), (options.keep, "FOLDER"))}
        write(verdicts, bars, [names.get(argument, argument) for argument in sys.argv[1:]])
    return int(not (bars.hold and bars.passed == bars.trials))


if __name__ == "__main__":
    sys.exit(main())
