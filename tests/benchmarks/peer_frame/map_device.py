"""A load frame behind the links that a shipped map describes; shares no code with the product.

    python map_device.py PORT LOG KIND [NAME=VALUE ...]

KIND is a name of `KINDS`. NAME=VALUE are characters and fault switches of second_settings.py. Serial lines are pseudo-terminals ``line1``,
``line2`` in the folder of LOG, a load file is ``load.csv`` there. Modbus TCP and the commands over UDP are at 127.0.0.1:PORT as for
second_frame.py, with two more commands: ``hand TARGET RATE`` and ``handstop`` are what a person does at the machine's own panel.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, __file__.rpartition("/")[0])

from map_registers import (
    BenchRegisters,
    FlintecRegisters,
    GenericRegisters,
    LaumasRegisters,
    LeadshineRegisters,
    OrientalRegisters,
    SenecaRegisters,
    WagoRegisters,
)
from map_text import ForceGauge, MantracourtAmplifier, Mark10Stand, MercuryController
from second_frame import Control, Server, machine_of
from second_machine import Machine
from serial_lines import PseudoLine, rtu_line, text_line

_STEP_S = 0.002
_ROW_S = 0.1
"""Time between two rows of the load file."""


class MapDevice(Server):
    """Links, log and time of one kind of load frame.

    Args:
        machine: specimen, drive and cell.
        log: file of the log; lines and the load file are made next to it.
        kind: a name of `KINDS`.
    """

    def __init__(self, machine: Machine, log: str, kind: str) -> None:
        super().__init__(machine, log)
        self.folder = Path(log).parent
        self.lines = list[PseudoLine]()
        self.passing = list[Callable[[], None]]()
        self.forgetting = list[Callable[[], None]]()
        self.writes_file = False
        KINDS[kind](self)

    def rtu(
        self, number: int, *units: BenchRegisters | GenericRegisters | LaumasRegisters | LeadshineRegisters | OrientalRegisters
    ) -> None:
        """A line of Modbus RTU with units 1, 2, ..."""
        self.lines.append(rtu_line(self.folder / f"line{number}", number, self.machine, dict(enumerate(units, 1))))
        self.forgetting += [unit.forget for unit in units]

    def text(self, number: int, device: Mark10Stand | MantracourtAmplifier | ForceGauge | MercuryController) -> None:
        """A line of text."""
        self.lines.append(text_line(self.folder / f"line{number}", number, self.machine, device))
        self.forgetting.append(device.forget)

    def command(self, text: str) -> None:
        """A fault switch, a value, or what a person does at the machine."""
        word, _, rest = text.partition(" ")
        if word == "hand":
            target_n, rate_n_s = (float(value) for value in rest.split())
            self.machine.ramp(target_n, rate_n_s)
            self.note(f"RAMP to {target_n:.3f} at {rate_n_s:.3f}")
        elif word == "handstop":
            self.note("REQ hand <STOP>")
            self.note("STOPPED" if self.machine.stop() else "STOP ignored")
        else:
            super().command(text)
            if word == "reboot":
                for forget in self.forgetting:
                    forget()

    async def live(self) -> None:
        """Let time pass for machine, watchdogs and load file."""
        file = (self.folder / "load.csv").open("w", encoding="utf-8") if self.writes_file else None
        if file is not None:
            file.write("Time (s),Force (N),Extension (mm)\n")
        start_s, row_s = time.monotonic(), 0.0
        while True:
            await asyncio.sleep(_STEP_S)
            if what := self.machine.advance():
                self.note(what)
            for pass_time in self.passing:
                pass_time()
            now_s = time.monotonic()
            if file is not None and now_s > row_s + _ROW_S and not self.machine.switches.hole:
                shown, row_s = self.machine.shown(), now_s
                file.write(f"{now_s - start_s:.3f},{shown.force_n:.3f},{shown.extension_mm:.5f}\n")
                file.flush()


def _bench(device: MapDevice) -> BenchRegisters:
    registers = BenchRegisters(device.machine, device.note)
    device.registers = registers
    device.passing.append(registers.pass_time)
    return registers


def _bench_tcp(device: MapDevice) -> None:
    _bench(device)


def _bench_rtu(device: MapDevice) -> None:
    device.rtu(1, _bench(device))


def _generic_tcp(device: MapDevice) -> None:
    device.registers = GenericRegisters(device.machine, device.note)


def _generic_rtu(device: MapDevice) -> None:
    device.registers = registers = GenericRegisters(device.machine, device.note)
    device.rtu(1, registers)


def _mark10(device: MapDevice) -> None:
    device.text(1, Mark10Stand(device.machine, device.note))


def _laumas_leadshine(device: MapDevice) -> None:
    """Cell and drive on one line."""
    device.rtu(1, LaumasRegisters(device.machine, device.note), LeadshineRegisters(device.machine, device.note))


def _mantracourt_oriental_wago(device: MapDevice) -> None:
    """Cell on a line of text, drive on a line of Modbus RTU, watchdog behind Modbus TCP."""
    device.text(1, MantracourtAmplifier(device.machine, device.note))
    device.rtu(2, OrientalRegisters(device.machine, device.note))
    wago = WagoRegisters(device.machine, device.note)
    device.registers, device.link = wago, 3
    device.passing.append(wago.pass_time)


def _flintec_pi(device: MapDevice) -> None:
    """Drive on a line of text, cell behind Modbus TCP."""
    device.text(1, MercuryController(device.machine, device.note))
    device.registers, device.link = FlintecRegisters(device.machine, device.note), 2


def _mark10_gauge_pi(device: MapDevice) -> None:
    """Drive on one line of text, gauge on another."""
    device.text(1, MercuryController(device.machine, device.note))
    device.text(2, ForceGauge(device.machine, device.note, "mark10"))


def _imada_oriental(device: MapDevice) -> None:
    """Gauge on a line of text, drive on a line of Modbus RTU."""
    device.text(1, ForceGauge(device.machine, device.note, "imada"))
    device.rtu(2, OrientalRegisters(device.machine, device.note))


def _mettler_oriental(device: MapDevice) -> None:
    """Weighing terminal on a line of text, drive on a line of Modbus RTU."""
    device.text(1, ForceGauge(device.machine, device.note, "mettler"))
    device.rtu(2, OrientalRegisters(device.machine, device.note))


def _seneca_pi(device: MapDevice) -> None:
    """Drive on a line of text, cell behind Modbus TCP."""
    device.text(1, MercuryController(device.machine, device.note))
    device.registers, device.link = SenecaRegisters(device.machine, device.note), 2


def _csv_oriental(device: MapDevice) -> None:
    """Cell by a load file, drive on a line of Modbus RTU."""
    device.writes_file = True
    device.rtu(1, OrientalRegisters(device.machine, device.note))


def _hand(device: MapDevice) -> None:
    """A person moves the machine; its program records a load file."""
    device.writes_file = True


KINDS: dict[str, Callable[[MapDevice], None]] = {
    "bench_tcp": _bench_tcp,
    "bench_rtu": _bench_rtu,
    "generic_tcp": _generic_tcp,
    "generic_rtu": _generic_rtu,
    "mark10": _mark10,
    "laumas_leadshine": _laumas_leadshine,
    "mantracourt_oriental_wago": _mantracourt_oriental_wago,
    "flintec_pi": _flintec_pi,
    "mark10_gauge_pi": _mark10_gauge_pi,
    "imada_oriental": _imada_oriental,
    "mettler_oriental": _mettler_oriental,
    "seneca_pi": _seneca_pi,
    "csv_oriental": _csv_oriental,
    "hand": _hand,
}


async def _serve(port: int, log: str, kind: str, given: dict[str, float]) -> None:
    device = MapDevice(machine_of(given), log, kind)
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(lambda: Control(device), local_addr=("127.0.0.1", port))
    await asyncio.start_server(device.talk, "127.0.0.1", port)
    serving = [asyncio.ensure_future(line.serve()) for line in device.lines]
    device.note("START")
    await asyncio.gather(device.live(), *serving)


if __name__ == "__main__":
    named = {name: float(value) for name, value in (item.split("=") for item in sys.argv[4:])}
    asyncio.run(_serve(int(sys.argv[1]), sys.argv[2], sys.argv[3], named))
