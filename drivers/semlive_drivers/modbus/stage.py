"""A specimen stage (or beam shift) behind Modbus TCP or RTU."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.loading import DeviceIdentity, MotionState, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import LinkError, LinkRefused, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.modbus.codec import block_of, decode, decode_int, encode
from semlive_drivers.modbus.device import StaleReadingCheck, open_link
from semlive_drivers.modbus.link import Link, write_verified
from semlive_drivers.modbus.orders.requests import Request, blind_pdus, runs_of
from semlive_drivers.modbus.registers import StageMap, overridden, stage_at
from semlive_drivers.modbus.settings import StageSettings
from semlive_drivers.settings import checked

GO, STOP = 1, 2
_NAMES = {StageKind.SPECIMEN: "stage", StageKind.BEAM: "beam shift"}
_MAP_VERSION = 1
_SIMULATOR_BIT = 0b01
_MOTION = {0: MotionState.STOPPED, 1: MotionState.MOVING, 2: MotionState.FAULT}


class ModbusStage:
    """The Stage port over one Modbus link; opened by `open_stage`."""

    def __init__(self, link: Link, registers: StageMap, settings: StageSettings, clock: ClockSource) -> None:
        self._link, self._map, self._clock = link, registers, clock
        self._kind = settings.kind
        self._status = block_of((registers.motion, registers.x, registers.y, registers.counter))
        self._written = {
            "target_x": registers.target_x,
            "target_y": registers.target_y,
            "command": registers.command,
            "nonce": registers.nonce,
        }
        self._runs = runs_of(self._written)
        self._stale_check = StaleReadingCheck(link, settings.frozen_after_s)
        self._sequence = 0
        self._last_um = (0.0, 0.0)
        self._nonce = clock.mono_ns() // 1_000_000 % 65_536
        simulated = _identify(link, registers, settings.identity)
        # The register map has no watchdog for the stage: after a link loss nothing stops it.
        self._identity = DeviceIdentity(f"{_NAMES[settings.kind]} at {link.where}", simulated, StopOnLinkLoss.NONE)

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the device, as read when the link was opened."""
        return self._identity

    @property
    def kind(self) -> StageKind:
        """What it moves."""
        return self._kind

    def read(self) -> StageSample:
        """Take a new reading.

        Raises:
            LinkError: if no valid answer comes, or the reading is frozen.
        """
        r, s = self._map, self._status
        raw = self._link.read(s)
        mono_ns = self._clock.mono_ns()
        self._stale_check.check(decode_int(r.counter, raw[s.slice(r.counter)]), mono_ns)
        sample = StageSample(
            sequence=self._sequence,
            time_ns=self._clock.now_ns(),
            mono_ns=mono_ns,
            x_um=decode(r.x, raw[s.slice(r.x)]),
            y_um=decode(r.y, raw[s.slice(r.y)]),
            motion=_motion_state(self._link, decode_int(r.motion, raw[s.slice(r.motion)])),
            raw=raw,
        )
        self._sequence += 1
        return sample

    def move_to(self, x_um: float, y_um: float) -> None:
        """Start a motion to a position, um; returns after the command was read back.

        Raises:
            LinkError: if the device did not take the command.
        """
        self._last_um = (x_um, y_um)
        self._command(GO)

    def stop(self) -> None:
        """Stop motion; returns after the command was read back.

        Raises:
            LinkError: if the device did not take the command.
        """
        self._command(STOP)

    def stop_blind(self) -> bool:
        """Write a stop without waiting for an answer, as `semlive.ports.BlindStop`."""
        return self._link.write_without_reply(blind_pdus(self._requests(STOP)))

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _command(self, command: int) -> None:
        for request in self._requests(command):
            write_verified(self._link, request.block, request.registers)

    def _requests(self, command: int) -> list[Request]:
        """The requests of a command: one for each group of adjacent registers, the command register last."""
        self._nonce = (self._nonce + 1) % 65_536
        values = {"target_x": self._last_um[0], "target_y": self._last_um[1], "command": command, "nonce": self._nonce}
        requests = []
        for run in self._runs:
            registers = tuple(register for name in run for register in encode(self._written[name], values[name]))
            requests.append(Request(block_of(self._written[name] for name in run), registers, run))
        return requests


def _identify(link: Link, registers: StageMap, expected: int | None) -> bool:
    """Check the identity and the map version of a stage.

    Args:
        link: open.
        registers: where the stage holds its identity.
        expected: value of the identity register; None checks only that the device answers.

    Returns:
        Whether the device states that it is a simulator; False without a check.

    Raises:
        LinkRefused: if another device answers.
        LinkError: if no valid answer comes.
    """
    points = (registers.identity, registers.version, registers.abilities)
    block = block_of(points)
    raw = link.read(block)
    identity, version, abilities = (decode_int(point, raw[block.slice(point)]) for point in points)
    if expected is None:
        return False
    if identity != expected:
        raise LinkRefused(
            f"{link.where} is another device: its identity is {identity:#06x} instead of {expected:#06x}; check host and unit"
        )
    if version != _MAP_VERSION:
        raise LinkRefused(f"{link.where} has version {version} of the register map, not {_MAP_VERSION}; update the driver or the device")
    return bool(abilities & _SIMULATOR_BIT)


def _motion_state(link: Link, number: int) -> MotionState:
    """The motion state of a register value; raises LinkError if it does not exist."""
    try:
        return _MOTION[number]
    except KeyError:
        raise LinkError(f"{link.where} reports motion state {number}, which does not exist; check the register map") from None


def open_stage(settings: Mapping[str, object], clock: ClockSource) -> ModbusStage:
    """Open the link and check the identity of the device.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if no device, or another one, answers.
        LinkError: if an answer is not valid.
    """
    config = checked(StageSettings, settings, "modbus stage")
    registers = overridden(stage_at(config.first_register), config.registers, "modbus stage: registers")
    status = block_of((registers.motion, registers.x, registers.y, registers.counter))
    link = open_link(config, None, (status,))
    try:
        return ModbusStage(link, registers, config, clock)
    except SemliveError:
        link.close()
        raise
