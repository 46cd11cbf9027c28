"""A scan generator that scans one frame when a register is written."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive_drivers.endpoint_lock import reserve_serial, reserve_tcp
from semlive_drivers.modbus.codec import block_of, encode
from semlive_drivers.modbus.device import open_link
from semlive_drivers.modbus.link import Link
from semlive_drivers.modbus.registers import TriggerMap, overridden
from semlive_drivers.modbus.settings import ModbusSettings
from semlive_drivers.settings import checked


class ModbusTrigger:
    """The Trigger port over one Modbus link, opened again for every request, because minutes pass between two of them."""

    def __init__(self, registers: TriggerMap, settings: ModbusSettings) -> None:
        self._map, self._settings = registers, settings
        # The endpoint stays reserved between two requests, so that no other process can command the device.
        serial = settings.serial
        self._endpoint = reserve_tcp(settings.host, settings.port, settings.unit) if serial is None else reserve_serial(serial.port)
        try:
            self._link().close()
        except SemliveError:
            self.close()
            raise

    def scan_once(self) -> None:
        """Request one frame; returns when the request was accepted.

        Raises:
            LinkError: if it was not accepted, for instance because a scan is under way.
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
    """Check that the device answers.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if no device answers.
    """
    del clock  # a trigger has no samples with times
    config = checked(ModbusSettings, settings, "modbus trigger")
    return ModbusTrigger(overridden(TriggerMap(), config.registers, "modbus trigger: registers"), config)
