"""Access to one Modbus device: open its link, read its registers with one recovery per turn, and detect a frozen reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from semlive.errors import LinkError
from semlive_drivers.modbus.codec import Block, block_of, number_in
from semlive_drivers.modbus.device_map import Condition, DeviceMap
from semlive_drivers.modbus.link import Link
from semlive_drivers.modbus.registers import Kind, RegisterPoint
from semlive_drivers.modbus.rtu.line import NoReply
from semlive_drivers.modbus.rtu.link import RtuLink
from semlive_drivers.modbus.rtu.shared_line import open_shared_line
from semlive_drivers.modbus.settings import ModbusSettings
from semlive_drivers.modbus.tcp.link import ModbusLink
from semlive_drivers.serial_port import SerialSettings


def open_link(settings: ModbusSettings, device: DeviceMap | None, probes: Sequence[Block]) -> Link:
    """A link to a unit, over TCP or a serial line; this process may have opened the serial line already.

    Args:
        settings: host or serial line, and unit.
        device: the description, for line settings that the configuration does not set; None without a description.
        probes: blocks that can be read without side effects.

    Raises:
        BadConfig: if the serial line is open with other settings.
        LinkRefused: if no device answers.
        LinkError: if a late answer of the unit is still possible.
    """
    if settings.serial is None:
        return ModbusLink(settings.host, settings.port, settings.unit, settings.timeout_s)
    values = settings.serial.over(device.serial) if device else settings.serial.model_dump(exclude_none=True)
    serial, device_name = SerialSettings.model_validate(values), device.name if device else "modbus"
    line = open_shared_line(serial, settings.timeout_s, device_name)
    try:
        return RtuLink(line, settings.unit, probes, lambda: open_shared_line(serial, settings.timeout_s, device_name))
    except LinkError:
        line.close()
        raise


def probe_blocks(device: DeviceMap, points: Mapping[str, RegisterPoint]) -> tuple[Block, ...]:
    """Blocks of a device that can be read without side effects: those of every reading and of the identity."""
    blocks = [block_of((points[name] for name in names), device.max_block) for names in device.every_turn]
    return (*blocks, *(block_of((points[condition.point],)) for condition in device.identity))


class DeviceRegisters:
    """Registers of a device over a link that is recovered from a lost answer at most once per turn, so that a turn stays short.

    A turn is one call of `DevicePart.order_changed` and of `Part.read`.

    Args:
        link: open.
        points: points of the device by name.
    """

    def __init__(self, link: Link, points: Mapping[str, RegisterPoint]) -> None:
        self._link, self._points = link, points
        self._in_turn = self._recovered = False

    def begin_turn(self) -> None:
        """Begin a turn, if none is under way."""
        if not self._in_turn:
            self._recovered = False
        self._in_turn = True

    def end_turn(self) -> None:
        """End the turn: the next `begin_turn` allows a recovery again."""
        self._in_turn = False

    def read(self, block: Block) -> tuple[int, ...]:
        """Read a block; read it again after the link recovered from a lost answer.

        Raises:
            LinkError: if no valid answer comes.
        """
        try:
            return self._link.read(block)
        except NoReply:
            if not self._recover():
                raise
            return self._link.read(block)

    def write(self, address: int, registers: Sequence[int], kind: Kind) -> None:
        """Write registers; a lost answer is accepted if the link recovers.

        Raises:
            LinkError: if no valid answer comes.
        """
        try:
            self._link.write(address, registers, kind)
        except NoReply:
            if not self._recover():
                raise

    def read_point(self, name: str) -> int:
        """The unscaled number of a point, read in a request of its own; without recovery."""
        point = self._points[name]
        return int(number_in(point, self._link.read(block_of((point,)))))

    def holds(self, condition: Condition | None) -> bool:
        """Whether a condition is stated and true; reads its point."""
        return condition is not None and condition.holds(self.read_point(condition.point))

    def _recover(self) -> bool:
        available, self._recovered = not self._recovered, True
        return available and self._link.resync()


class StaleReadingCheck:
    """Detects a frozen reading by the device's counter of readings."""

    def __init__(self, link: Link, frozen_after_s: float) -> None:
        self._link = link
        self._frozen_after_ns = round(frozen_after_s * 1e9)
        self._counter: int | None = None
        self._since_mono_ns = 0

    def check(self, counter: int, mono_ns: int) -> None:
        """Compare the counter with its previous value.

        Raises:
            LinkError: if it has not changed for too long.
        """
        if counter != self._counter:
            self._counter, self._since_mono_ns = counter, mono_ns
        elif mono_ns - self._since_mono_ns > self._frozen_after_ns:
            still_s = (mono_ns - self._since_mono_ns) / 1e9
            raise LinkError(f"the reading of {self._link.where} is frozen: no new value for {still_s:.1f} s; check the sensor")
