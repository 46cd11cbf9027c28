"""Sleep that tolerates a step of the system clock."""

from __future__ import annotations

import errno
import time


def pause(seconds: float) -> None:
    """Sleep; shorter if the clock of the computer is set meanwhile and the system rejects the remaining time (EINVAL).

    Args:
        seconds: wall time, s; without effect if it is not positive.
    """
    if seconds <= 0.0:
        return
    try:
        time.sleep(seconds)
    except OSError as error:
        # A step of the clock made the absolute end time invalid; observed with virtualised clocks.
        if error.errno != errno.EINVAL:
            raise
