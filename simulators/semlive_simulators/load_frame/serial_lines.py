"""Serial lines of the bench: Modbus RTU and a text protocol, each over a pseudo-terminal, if the system has these."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from semlive_simulators.load_frame.ascii_stand import BAUD, AsciiTestStand
from semlive_simulators.load_frame.line_faults import Line, LineChunk, LineFaultInjector, corrupt
from semlive_simulators.load_frame.rtu import RtuGateway
from semlive_simulators.specimen.machine import LoadTrain

RTU_BAUD = 19_200

if sys.platform != "win32":
    from semlive_simulators.load_frame.pty_line import PtyLine


@contextlib.contextmanager
def rtu_line(port: int, unit: int, line_faults: LineFaultInjector) -> Iterator[str]:
    """A Modbus RTU line with the registers of the TCP server at a port; yields its path (19,200 baud, no parity).

    Raises:
        RuntimeError: if the system has no pseudo-terminals.
    """
    gateway = RtuGateway(port, unit)
    line_faults.exempt(gateway.port)
    try:
        with _line("rtu", corrupt(line_faults, Line.RTU, gateway.answer), RTU_BAUD) as path:
            yield path
    finally:
        gateway.close()


@contextlib.contextmanager
def ascii_line(machine: LoadTrain, now_ns: Callable[[], int], line_faults: LineFaultInjector) -> Iterator[tuple[str, AsciiTestStand]]:
    """A test stand with commands of single letters; yields the path of its line (115,200 baud, no parity) and the stand.

    Raises:
        RuntimeError: if the system has no pseudo-terminals.
    """
    stand = AsciiTestStand(machine, now_ns)
    with _line("serial", corrupt(line_faults, Line.SERIAL, stand.answer), BAUD) as path:
        yield path, stand


@contextlib.contextmanager
def _line(name: str, answer: Callable[[bytes], tuple[LineChunk, ...]], baud: int) -> Iterator[str]:
    if sys.platform == "win32":
        raise RuntimeError(f"a serial line needs a pseudo-terminal, which Windows does not have; leave --{name} out")
    line = PtyLine(name, answer, baud)
    line.start()
    try:
        yield line.path
    finally:
        line.stop()
