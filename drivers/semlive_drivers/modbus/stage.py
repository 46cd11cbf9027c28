"""A specimen stage (or beam shift) behind Modbus TCP or RTU."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.loading import DeviceIdentity, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive_drivers.modbus.client import Link, write_verified
from semlive_drivers.modbus.codec import block_of, decode, decode_int, encode
from semlive_drivers.modbus.device import StaleReadingCheck, identify, motion_state
from semlive_drivers.modbus.orders import Request, blind_pdus, runs_of
from semlive_drivers.modbus.part import open_link
from semlive_drivers.modbus.registers import StageMap, overridden, stage_at
from semlive_drivers.modbus.settings import StageSettings, checked

GO, STOP = 1, 2
_NAMES = {StageKind.SPECIMEN: "stage", StageKind.BEAM: "beam shift"}


class ModbusStage:
    """The Stage port over one Modbus link; opened by `open_stage`."""

    def __init__(self, link: Link, registers: StageMap, settings: StageSettings, clock: ClockSource) -> None:
        r = registers
        self._link, self._map, self._clock = link, registers, clock
        self._kind = settings.kind
        self._status = block_of((r.motion, r.x, r.y, r.counter))
        self._order = {name: getattr(r, name) for name in ("target_x", "target_y", "command", "nonce")}
        self._runs = runs_of(self._order)
        self._frozen = StaleReadingCheck(link, settings.frozen_after_s)
        self._sequence = 0
        self._last_um = (0.0, 0.0)
        self._nonce = clock.mono_ns() // 1_000_000 % 65_536
        greeting = identify(link, registers, settings.identity)
        # The map has no watchdog for the stage: nobody stops it when the link is gone.
        self._identity = DeviceIdentity(f"{_NAMES[settings.kind]} at {link.where}", greeting.simulated, StopOnLinkLoss.NONE)

    @property
    def identity(self) -> DeviceIdentity:
        """Who answers, as read when the link was opened."""
        return self._identity

    @property
    def kind(self) -> StageKind:
        """What it moves."""
        return self._kind

    def read(self) -> StageSample:
        """One fresh reading.

        Raises:
            LinkError: if nothing sensible comes back, or the reading is frozen.
        """
        r, s = self._map, self._status
        raw = self._link.read(s)
        mono_ns = self._clock.mono_ns()
        self._frozen.check(decode_int(r.counter, raw[s.slice(r.counter)]), mono_ns)
        sample = StageSample(
            sequence=self._sequence,
            time_ns=self._clock.now_ns(),
            mono_ns=mono_ns,
            x_um=decode(r.x, raw[s.slice(r.x)]),
            y_um=decode(r.y, raw[s.slice(r.y)]),
            motion=motion_state(self._link, decode_int(r.motion, raw[s.slice(r.motion)])),
            raw=raw,
        )
        self._sequence += 1
        return sample

    def move_to(self, x_um: float, y_um: float) -> None:
        """Start going to a position; returns when the command was read back.

        Raises:
            LinkError: if the device did not take it.
        """
        self._last_um = (x_um, y_um)
        self._command(GO)

    def stop(self) -> None:
        """Stop motion; returns when the command was read back.

        Raises:
            LinkError: if the device did not take it.
        """
        self._command(STOP)

    def stop_blind(self) -> bool:
        """Write a stop without waiting for an answer, as `semlive.ports.BlindStop`."""
        return self._link.write_without_reply(blind_pdus(self._requests(STOP)))

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _command(self, word: int) -> None:
        for request in self._requests(word):
            write_verified(self._link, request.block, request.registers)

    def _requests(self, word: int) -> list[Request]:
        """The requests of a command: one for each group of adjacent registers, the command last."""
        self._nonce = (self._nonce + 1) % 65_536
        values = {"target_x": self._last_um[0], "target_y": self._last_um[1], "command": word, "nonce": self._nonce}
        requests = []
        for run in self._runs:
            words = tuple(register for name in run for register in encode(self._order[name], values[name]))
            requests.append(Request(block_of(self._order[name] for name in run), words, run))
        return requests


def open_stage(settings: Mapping[str, object], clock: ClockSource) -> ModbusStage:
    """Open the link and check who answers.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody, or somebody else, answers.
        LinkError: if the device answers nonsense.
    """
    known = checked(StageSettings, settings, "modbus stage")
    registers = overridden(stage_at(known.first_register), known.registers, "modbus stage: registers")
    status = block_of((registers.motion, registers.x, registers.y, registers.counter))
    link = open_link(known, None, (status,))
    try:
        return ModbusStage(link, registers, known, clock)
    except SemliveError:
        link.close()
        raise
