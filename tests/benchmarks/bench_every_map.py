"""The campaign over every shipped map and every driver of a load frame: the real daemon with an independent device behind each.

    python tests/benchmarks/bench_every_map.py [--write] [--short] [--only NAME ...] [--jobs 2] [--found FILE] [--keep FOLDER] [--list]

Each scenario is a run of `semlive run CONFIG --attended` in real time with default limits. The device is the program
tests/benchmarks/peer_frame/map_device.py. It is written from the maker's register or command list and shares no code with the drivers; its
own record gives the true force, the orders and the stops. NAME is the beginning of a scenario's name. `--write` writes one section of
docs/validation/load-frame-safety.md. Observations are added to FILE, and a scenario that FILE holds is judged without being run again. The
exit status
is 1 if a scenario or a bar failed.
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

from peer_frame.campaign import Campaign
from peer_frame.every_map import EVERY_MAP
from peer_frame.page import line, summary, write_maps
from peer_frame.verdict import figures


def main() -> int:
    """Run the requested scenarios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the section of docs/validation/load-frame-safety.md")
    parser.add_argument("--short", action="store_true", help="only the scenarios that the tests run")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="scenarios whose name begins so")
    parser.add_argument("--jobs", type=int, default=2, help="trials at the same time")
    parser.add_argument("--found", type=Path, default=None, metavar="FILE", help="file of observations")
    parser.add_argument("--keep", type=Path, default=None, metavar="FOLDER", help="keep logs and outputs there")
    parser.add_argument("--list", action="store_true", help="show names and end")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    scenarios = [item for item in EVERY_MAP if (not options.short or item.short) and item.name.startswith(tuple(options.only) or "")]
    if options.list:
        sys.stdout.writelines(f"{item.name:46} {item.what}\n" for item in scenarios)
        return 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name, ThreadPoolExecutor(options.jobs) as pool:
        campaign = Campaign(None, (options.keep or Path(name)).resolve(), options.found)
        verdicts = []
        for verdict in pool.map(campaign.judged, scenarios):
            verdicts.append(verdict)
            sys.stdout.write(line(verdict) + "\n")
            sys.stdout.flush()
    bars = figures(verdicts)
    sys.stdout.write(summary(bars) + "\n")
    if options.write:
        write_maps(verdicts, bars, f"--write{' --found FILE' if options.found else ''}")
    return int(not (bars.hold and bars.passed == bars.trials))


if __name__ == "__main__":
    sys.exit(main())
