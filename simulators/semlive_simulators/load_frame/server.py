"""The Modbus TCP server of the bench: present values with every read, orders executed when they are written."""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time

from pymodbus.constants import ExcCodes
from pymodbus.simulator import DataType, SimData, SimDevice

from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.dynamics import FAULTS
from semlive_simulators.load_frame.fault_schedule import MachineFault, planned_line_faults
from semlive_simulators.load_frame.faulty_tcp import FaultyTcpServer
from semlive_simulators.load_frame.line_faults import Line, LineFault, LineFaultInjector
from semlive_simulators.load_frame.registers import (
    FAULT,
    MOVING,
    STOPPED,
    CrossheadOrders,
    DiagnosticInputs,
    FaultOrders,
    LoadFrameInputs,
    LoadFrameOrders,
    SemInputs,
    StageInputs,
    StageOrders,
)
from semlive_simulators.microscope.sem import Sem
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.machine import LoadTrain
from semlive_simulators.specimen.stage import Actuator

UNIT = 1
_READ_HOLDING, _READ_INPUT = 3, 4
_WRITES = (6, 16)
_GO, _STOP = 1, 2
_FIRST_MACHINE_FAULT = 101


class Watchdog:
    """The watchdog of the device, in wall time: a change of the heartbeat register feeds it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._timeout_s = 0.0
        self._fed_ns = time.monotonic_ns()

    def set(self, timeout_s: float) -> None:
        """Set the time until the watchdog expires, s, and feed it; 0 disables it."""
        with self._lock:
            self._timeout_s = timeout_s
            self._fed_ns = time.monotonic_ns()

    def feed(self) -> None:
        """Feed the watchdog."""
        with self._lock:
            self._fed_ns = time.monotonic_ns()

    @property
    def expired(self) -> bool:
        """Whether the watchdog was not fed in time."""
        with self._lock:
            return self._timeout_s > 0 and time.monotonic_ns() - self._fed_ns > self._timeout_s * 1e9


class BenchRegisters:
    """Answers reads and executes writes; the register map is docs/reference/bench-registers.md."""

    def __init__(self, scenario: Scenario, clock: BenchClock, machine: LoadTrain, sem: Sem) -> None:
        self._scenario = scenario
        self._clock = clock
        self._machine = machine
        self._sem = sem
        self.watchdog = Watchdog()
        self.line_faults = LineFaultInjector(planned_line_faults(scenario.faults), lambda: (clock.now_ns() - clock.start_ns) * 1e-9)

    async def action(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: list[int] | list[bool] | None
    ) -> ExcCodes | None:
        """Called by pymodbus before it answers a request; `registers` is the complete block from `start`."""
        if function == _READ_INPUT:
            registers[:] = self._inputs(registers, start)
            return None
        if function != _READ_HOLDING and function not in _WRITES:
            return ExcCodes.ILLEGAL_FUNCTION
        if values is None:  # FC06 reads back what it wrote under its own number
            return None
        written = list(registers)
        written[address - start : address - start + len(values)] = [int(value) for value in values]
        touched = range(address, address + len(values))
        if touched.start < 100:
            return self._order_load_frame(registers, written, touched)
        if touched.start < 200:
            return self._order_stage(written, touched, 100, Actuator.STAGE)
        if touched.start < 300:
            return self._order_sem(written[200])
        if touched.start < 400:
            return self._order_crosshead(written, touched)
        if touched.start < 900:
            return self._order_stage(written, touched, 400, Actuator.BEAM_SHIFT)
        return self._order_fault(FaultOrders.decoded(written[900:904]))

    def _inputs(self, registers: list[int], start: int) -> list[int]:
        reading = self._machine.read(self._clock.now_ns())
        load_frame = LoadFrameInputs(
            state=FAULT if reading.load_frame_fault else MOVING if reading.load_frame_moving else STOPPED,
            force_n=reading.force_n,
            extension_mm=reading.extension_mm,
            target_n=reading.target_n,
            readings=reading.load_frame_number,
            lag_s=self._clock.lag_s(),
            force_limit_n=self._scenario.load_frame.force_limit_n,
        )
        stage = StageInputs(_stage_state(reading.stage.moving, reading.stage.fault), reading.stage.x_um, reading.stage.y_um, reading.number)
        beam = StageInputs(_stage_state(reading.beam.moving), reading.beam.x_um, reading.beam.y_um, reading.number)
        drive = reading.load_frame_drive
        diagnostics = DiagnosticInputs(FAULTS.index(drive) + 1 if drive in FAULTS else 0, reading.strain_gage, reading.load_frame_number)
        block = list(registers)
        for address, part in ((0, load_frame), (100, stage), (200, self._sem_inputs()), (300, diagnostics), (400, beam)):
            values = part.registers()
            block[address - start : address - start + len(values)] = values
        return block

    def _sem_inputs(self) -> SemInputs:
        return SemInputs(self._sem.scanning, self._sem.exported)

    def _order_load_frame(self, before: list[int], written: list[int], touched: range) -> ExcCodes | None:
        orders, old = LoadFrameOrders.decoded(written[0:8]), LoadFrameOrders.decoded(before[0:8])
        command = orders.command if 4 in touched else 0
        if command not in (0, _GO, _STOP):
            return ExcCodes.ILLEGAL_VALUE
        if command == _GO:
            limit = self._scenario.load_frame.force_limit_n
            valid = math.isfinite(orders.target_n) and abs(orders.target_n) <= limit and 0 < orders.rate_n_s < math.inf
            if not valid:
                return ExcCodes.ILLEGAL_VALUE
            if self._machine.locked:
                return ExcCodes.DEVICE_FAILURE
        if 7 in touched and orders.watchdog_s != old.watchdog_s:
            self.watchdog.set(orders.watchdog_s)
        if 6 in touched and orders.heartbeat != old.heartbeat:
            self.watchdog.feed()
        self._machine.advance_to(self._clock.now_ns())
        if command == _GO:
            self._machine.ramp_to(orders.target_n, orders.rate_n_s)
        elif command == _STOP:
            self._machine.stop_load()
        return None

    def _order_crosshead(self, written: list[int], touched: range) -> ExcCodes | None:
        orders, limits = CrossheadOrders.decoded(written[300:306]), self._scenario.load_frame
        command = orders.command if 304 in touched else 0
        if command not in (0, _GO, _STOP):
            return ExcCodes.ILLEGAL_VALUE
        if command == _GO:
            within = limits.extension_min_mm <= orders.extension_mm <= limits.extension_max_mm
            if not (within and 0 < orders.speed_mm_s < math.inf):
                return ExcCodes.ILLEGAL_VALUE
            if self._machine.locked:
                return ExcCodes.DEVICE_FAILURE
        self._machine.advance_to(self._clock.now_ns())
        if command == _GO:
            self._machine.travel_to(orders.extension_mm, orders.speed_mm_s)
        elif command == _STOP:
            self._machine.stop_load()
        return None

    def _order_stage(self, written: list[int], touched: range, first: int, actuator: Actuator) -> ExcCodes | None:
        orders = StageOrders.decoded(written[first : first + 6])
        command = orders.command if first + 4 in touched else 0
        if command not in (0, _GO, _STOP):
            return ExcCodes.ILLEGAL_VALUE
        parameters = self._scenario.stage if actuator is Actuator.STAGE else self._scenario.beam_shift
        travel = parameters.travel_um
        if command == _GO and not (abs(orders.x_um) <= travel and abs(orders.y_um) <= travel):
            return ExcCodes.ILLEGAL_VALUE
        self._machine.advance_to(self._clock.now_ns())
        if command == _GO:
            self._machine.move_stage(orders.x_um, orders.y_um, actuator)
        elif command == _STOP:
            self._machine.stop_stage(actuator)
        return None

    def _order_sem(self, command: int) -> ExcCodes | None:
        if command not in (0, 1):
            return ExcCodes.ILLEGAL_VALUE
        if command == 1 and not self._sem.request_scan():
            return ExcCodes.DEVICE_BUSY
        return None

    def _order_fault(self, orders: FaultOrders) -> ExcCodes | None:
        kinds, lines = tuple(LineFault), [line for bit, line in enumerate(Line) if orders.lines >> bit & 1]
        machine_faults = dict(enumerate(MachineFault, _FIRST_MACHINE_FAULT))
        if orders.what in machine_faults:
            self._machine.faults.order(machine_faults[orders.what], orders.wait_s, orders.count * 1e-3)
            return None
        if orders.what > len(kinds) or orders.lines >> len(Line):
            return ExcCodes.ILLEGAL_VALUE
        if orders.what == 0:
            self.line_faults.clear()
            self._machine.faults.clear()
        else:
            self.line_faults.order(kinds[orders.what - 1], lines, orders.count, orders.wait_s)
        return None


def _stage_state(moving: bool, fault: bool = False) -> int:
    return FAULT if fault else MOVING if moving else STOPPED


def _device(registers: BenchRegisters) -> SimDevice:
    def block(address: int, count: int) -> SimData:
        return SimData(address, count=count, values=0, datatype=DataType.REGISTERS)

    bits = [SimData(0, count=1, values=False, datatype=DataType.BITS)]
    holding = [block(0, 8), block(100, 6), block(200, 1), block(300, 6), block(400, 6), block(900, 4)]
    inputs = [block(0, 16), block(100, 7), block(200, 2), block(300, 5), block(400, 7)]
    return SimDevice(id=UNIT, simdata=(bits, list(bits), holding, inputs), action=registers.action)


class ModbusThread:
    """The server in a separate thread with its own event loop."""

    def __init__(self, registers: BenchRegisters, port: int) -> None:
        self._registers = registers
        self._requested_port = port
        self._loop = asyncio.new_event_loop()
        self._listening = threading.Event()
        self._failure: Exception | None = None
        self._port = 0
        self._thread = threading.Thread(target=self._run, name="modbus", daemon=True)

    def start(self) -> int:
        """Start listening on 127.0.0.1; returns the port.

        Raises:
            RuntimeError: if the port is not available.
        """
        self._thread.start()
        self._listening.wait()
        if self._failure is not None:
            raise RuntimeError(
                f"cannot listen on 127.0.0.1:{self._requested_port} ({self._failure}); choose another --port"
            ) from self._failure
        return self._port

    def stop(self) -> None:
        """Close the server and end the thread."""
        self._loop.call_soon_threadsafe(self._server_stop.set)
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        except Exception as error:
            self._failure = error
        finally:
            self._listening.set()
            self._loop.close()

    async def _serve(self) -> None:
        self._server_stop = asyncio.Event()
        # `start` reports a failure in one message; the library would log the same failure.
        logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())
        server = FaultyTcpServer(_device(self._registers), ("127.0.0.1", self._requested_port), self._registers.line_faults)
        await server.serve_forever(background=True)
        self._port = server.transport.sockets[0].getsockname()[1]  # type: ignore[union-attr]
        self._listening.set()
        await self._server_stop.wait()
        await server.shutdown()
