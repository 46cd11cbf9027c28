"""Sleep that tolerates a step of the system clock."""

from __future__ import annotations

import errno
import time


def pause(seconds: float) -> None:
    """Sleep; less than that if the computer's clock is set meanwhile and the system refuses the rest (EINVAL).

    Args:
        seconds: wall time; nothing is done if it is not positive.
    """
    if seconds <= 0.0:
        return
    try:
        time.sleep(seconds)
    except OSError as error:
        # The system was given an absolute time that a step of the clock made invalid; seen under virtualised clocks.
        if error.errno != errno.EINVAL:
            raise
