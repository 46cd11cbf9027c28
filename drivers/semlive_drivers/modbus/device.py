"""What the Modbus devices have in common: identity check, motion word, frozen readings."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.loading import MotionState
from semlive.errors import LinkError, LinkRefused
from semlive_drivers.modbus.client import Link
from semlive_drivers.modbus.codec import block_of, decode_int
from semlive_drivers.modbus.registers import StageMap

MAP_VERSION = 1
SIMULATOR_BIT = 0b01
WATCHDOG_BIT = 0b10

_MOTION = {0: MotionState.STOPPED, 1: MotionState.MOVING, 2: MotionState.FAULT}


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What a device says of itself when the link is opened."""

    simulated: bool
    has_watchdog: bool


def identify(link: Link, registers: StageMap, expected: int | None) -> DeviceInfo:
    """Check who answers.

    Raises:
        LinkRefused: if it is somebody else.
        LinkError: if nobody answers sensibly.
    """
    block = block_of((registers.identity, registers.version, registers.abilities))
    raw = link.read(block)
    identity, version, abilities = (
        decode_int(p, raw[block.slice(p)]) for p in (registers.identity, registers.version, registers.abilities)
    )
    if expected is None:
        return DeviceInfo(simulated=False, has_watchdog=False)
    if identity != expected:
        raise LinkRefused(
            f"{link.where} is another device: its identity is {identity:#06x} instead of {expected:#06x}; check host and unit"
        )
    if version != MAP_VERSION:
        raise LinkRefused(f"{link.where} speaks version {version} of the register map, not {MAP_VERSION}; update the driver or the device")
    return DeviceInfo(simulated=bool(abilities & SIMULATOR_BIT), has_watchdog=bool(abilities & WATCHDOG_BIT))


def motion_state(link: Link, word: int) -> MotionState:
    """The device's word on its motion.

    Raises:
        LinkError: if it is no word of the map.
    """
    try:
        return _MOTION[word]
    except KeyError:
        raise LinkError(f"{link.where} says motion state {word}, which does not exist; check the register map") from None


class StaleReadingCheck:
    """Tells a frozen reading by the device's counter of readings."""

    def __init__(self, link: Link, frozen_after_s: float) -> None:
        self._link = link
        self._frozen_after_ns = round(frozen_after_s * 1e9)
        self._counter: int | None = None
        self._since_mono_ns = 0

    def check(self, counter: int, mono_ns: int) -> None:
        """Take note of the counter.

        Raises:
            LinkError: if it has stood still for too long.
        """
        if counter != self._counter:
            self._counter, self._since_mono_ns = counter, mono_ns
        elif mono_ns - self._since_mono_ns > self._frozen_after_ns:
            still_s = (mono_ns - self._since_mono_ns) / 1e9
            raise LinkError(f"the reading of {self._link.where} is frozen: no new value for {still_s:.1f} s; check the sensor")
