"""A scan generator that scans one frame when a register is written."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive_drivers.endpoint_lock import reserve_serial, reserve_tcp
from semlive_drivers.modbus.client import Link
from semlive_drivers.modbus.codec import block_of, encode
from semlive_drivers.modbus.part import open_link
from semlive_drivers.modbus.registers import TriggerMap, overridden
from semlive_drivers.modbus.settings import ModbusSettings, checked


class ModbusTrigger:
    """The Trigger port over one Modbus link, opened anew for every request: minutes pass between two of them."""

    def __init__(self, registers: TriggerMap, settings: ModbusSettings) -> None:
        self._map, self._settings = registers, settings
        # Held between two requests as well: no other process shall come between.
        serial = settings.serial
        self._endpoint = reserve_tcp(settings.host, settings.port, settings.unit) if serial is None else reserve_serial(serial.port)
        try:
            self._link().close()
        except SemliveError:
            self.close()
            raise

    def scan_once(self) -> None:
        """Ask for one frame; returns when the request was taken.

        Raises:
            LinkError: if it was not, for instance because a scan is under way.
        """
        link = self._link()
        try:
            link.write(self._map.scan.address, encode(self._map.scan, 1))
        finally:
            link.close()

    def close(self) -> None:
        """Release the device; no link stays open between requests."""
        self._endpoint.release()

    def _link(self) -> Link:
        return open_link(self._settings, None, (block_of((self._map.scan,)),))


def open_trigger(settings: Mapping[str, object], clock: ClockSource) -> ModbusTrigger:
    """Check that somebody answers.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody answers.
    """
    del clock  # a trigger has no samples to stamp
    known = checked(ModbusSettings, settings, "modbus trigger")
    return ModbusTrigger(overridden(TriggerMap(), known.registers, "modbus trigger: registers"), known)
