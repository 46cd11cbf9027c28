"""Values between a run and the commands that start it: connections of display and operator, and the outcome.

Theory of operation
-------------------
The command line fills `RunInterface` before the run. The loop calls `observe` and `on_socket_open`, which must not block; any thread may
put a command into the queue.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from semlive.engine import OperatorCommand
from semlive.service.control.run_monitor import RunSnapshot
from semlive.service.control.socket import SocketAddress
from semlive.service.log.alarms import AcknowledgeAll


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Outcome of a run.

    Attributes:
        log: run folder.
        complete: every step was executed.
        text: one sentence.
    """

    log: Path
    complete: bool
    text: str


@dataclass(frozen=True, slots=True)
class RunInterface:
    """Connections of a run to display and operator.

    Attributes:
        observe: callback with a snapshot at every tick, in the loop; must not block.
        commands: queue of commands of the operator, filled from any thread.
        attended: a person stays at the instrument.
        stop_on_fault: end the run at a fault instead of waiting for the operator.
        resume: resume an interrupted run instead of beginning one.
        auto_resume: resume without confirmation if the devices agree with the last readings in the log.
        on_socket_open: callback with the address of the control socket once it is open, in the loop; must not block. None: no socket.
    """

    observe: Callable[[RunSnapshot], None]
    commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll]
    attended: bool = False
    stop_on_fault: bool = False
    resume: bool = False
    auto_resume: bool = False
    on_socket_open: Callable[[SocketAddress], object] | None = None
