"""A process that reserves an endpoint, prints `held` or the reason why not, and keeps it until its standard input ends."""

from __future__ import annotations

import sys

from semlive.errors import LinkRefused
from semlive_drivers.endpoint_lock import reserve_serial, reserve_tcp

if __name__ == "__main__":
    try:
        if sys.argv[1:2] == ["tcp"]:
            reserve_tcp(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
        else:
            reserve_serial(sys.argv[2])
        sys.stdout.write("held\n")
    except LinkRefused as error:
        sys.stdout.write(f"{error}\n")
    sys.stdout.flush()
    sys.stdin.read()
