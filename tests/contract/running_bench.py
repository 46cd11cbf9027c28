"""A simulated bench in the process of a test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.server import BenchRegisters, ModbusThread
from semlive_simulators.microscope.sem import Sem
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.machine import LoadTrain


@dataclass(frozen=True)
class Bench:
    """Parts of a bench, and the port of its registers."""

    clock: BenchClock
    machine: LoadTrain
    sem: Sem
    registers: BenchRegisters
    port: int


@contextmanager
def running_bench(
    scenario: Scenario, rate: float, folder: Path = Path(), triggered: bool = True, failed: Callable[[BaseException], None] = lambda _: None
) -> Iterator[Bench]:
    """A bench whose registers are served over TCP. Its microscope scans when it is triggered, or after `sem.start()`."""
    clock = BenchClock(rate, lambda _: None)
    machine = LoadTrain(scenario, clock.start_ns)
    machine.read(clock.start_ns)  # loads compiled code, which takes longer than a client waits when the computer is busy
    sem = Sem(scenario, clock, machine, folder, triggered, lambda _: None, failed)
    registers = BenchRegisters(scenario, clock, machine, sem)
    server = ModbusThread(registers, 0)
    port = server.start()
    clock.begin()
    yield Bench(clock, machine, sem, registers, port)
    server.stop()
