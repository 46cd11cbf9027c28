"""A load frame behind Modbus TCP."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from semlive.data.loading import DeviceIdentity, LoadSample, StopOnLinkLoss
from semlive.errors import LinkError, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.modbus.client import ModbusLink
from semlive_drivers.modbus.codec import block_of, decode, decode_int, decode_or_none, encode, encode_block
from semlive_drivers.modbus.device import FrozenCheck, Greeting, greet, motion_state
from semlive_drivers.modbus.registers import LoadFrameMap, overridden
from semlive_drivers.modbus.settings import LoadFrameSettings, checked

GO, STOP = 1, 2


class ModbusLoadFrame:
    """The LoadFrame port over one Modbus link; opened by `open_load_frame`."""

    def __init__(self, link: ModbusLink, registers: LoadFrameMap, settings: LoadFrameSettings, clock: ClockSource) -> None:
        r = registers
        self._link, self._map, self._settings, self._clock = link, registers, settings, clock
        self._status = block_of((r.motion, r.force, r.extension, r.target_in_force, r.counter, r.lag, r.force_limit))
        self._order = block_of((r.target, r.rate, r.command, r.nonce))
        self._gage = block_of((r.strain_gage,)) if settings.strain_gage else None
        self._frozen = FrozenCheck(link, settings.frozen_after_s)
        self._sequence = 0
        self._nonce = clock.mono_ns() // 1_000_000 % 65_536
        self._beat = 0
        # A stop repeats the last target: a target of zero would wait in the device for the next spurious "go".
        self._last_n, self._last_n_s = 0.0, 0.0
        self._stopped = False
        greeting = greet(link, registers, settings.identity)
        self._simulated = greeting.simulated
        if settings.watchdog_s:
            link.write_verified(block_of((r.watchdog,)), encode(r.watchdog, round(settings.watchdog_s * 10)))
        raw = link.read(self._status)
        self._identity = DeviceIdentity(
            name=f"load frame at {link.where}",
            simulated=greeting.simulated,
            stop_on_link_loss=_statement(settings, greeting),
            force_max_n=decode(r.force_limit, raw[self._status.slice(r.force_limit)]),
        )

    @property
    def identity(self) -> DeviceIdentity:
        """Who answers, as read when the link was opened."""
        return self._identity

    def read(self) -> LoadSample:
        """One fresh reading, after feeding the device's watchdog.

        Raises:
            LinkError: if nothing sensible comes back, or the reading is frozen.
        """
        r, s = self._map, self._status
        self._beat = (self._beat + 1) % 65_536
        self._link.write(r.heartbeat.address, encode(r.heartbeat, self._beat))
        raw = self._link.read(s)
        gage_raw = () if self._gage is None else self._link.read(self._gage)
        mono_ns = self._clock.mono_ns()
        self._frozen.check(decode_int(r.counter, raw[s.slice(r.counter)]), mono_ns)
        sample = LoadSample(
            sequence=self._sequence,
            time_ns=self._clock.now_ns(),
            mono_ns=mono_ns,
            force_n=decode(r.force, raw[s.slice(r.force)]),
            extension_mm=decode(r.extension, raw[s.slice(r.extension)]),
            motion=motion_state(self._link, decode_int(r.motion, raw[s.slice(r.motion)])),
            target_n=decode(r.target_in_force, raw[s.slice(r.target_in_force)]),
            simulator_lag_s=decode(r.lag, raw[s.slice(r.lag)]) if self._simulated else None,
            raw=(*raw, *gage_raw),
            gage_strain=decode_or_none(r.strain_gage, gage_raw) if gage_raw else None,
        )
        self._sequence += 1
        return sample

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Start going to a load at a rate; returns when the command was read back.

        Raises:
            LinkError: if the device did not take it.
        """
        self._last_n, self._last_n_s = force_n, rate_n_s
        self._stopped = False
        self._command(GO)

    def stop(self) -> None:
        """Stop motion and hold position; returns when the command was read back.

        Raises:
            LinkError: if the device did not take it.
        """
        self._command(STOP)
        self._stopped = True

    def close(self) -> None:
        """Close the link; a device that was stopped is told not to expect us any more.

        Otherwise its watchdog would expire after an orderly end and leave it in a fault that somebody has to clear. A
        device that may be moving keeps its watchdog.
        """
        if self._stopped and self._settings.watchdog_s:
            with contextlib.suppress(LinkError):
                self._link.write(self._map.watchdog.address, encode(self._map.watchdog, 0))
        self._link.close()

    def _command(self, word: int) -> None:
        r = self._map
        self._nonce = (self._nonce + 1) % 65_536
        values = {r.target: self._last_n, r.rate: self._last_n_s, r.command: word, r.nonce: self._nonce}
        self._link.write_verified(self._order, encode_block(self._order, values))


def _statement(settings: LoadFrameSettings, greeting: Greeting) -> StopOnLinkLoss:
    """What is known of the machine's own stop: what was found out at it, else its own word."""
    if settings.stop_on_link_loss is not None:
        return settings.stop_on_link_loss
    return StopOnLinkLoss.ASSUMED if greeting.has_watchdog and settings.watchdog_s else StopOnLinkLoss.ABSENT


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> ModbusLoadFrame:
    """Open the link and check who answers.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody, or somebody else, answers.
        LinkError: if the device answers nonsense.
    """
    known = checked(LoadFrameSettings, settings, "modbus load frame")
    registers = overridden(LoadFrameMap(), known.registers, "modbus load frame: registers")
    link = ModbusLink(known.host, known.port, known.unit, known.timeout_s)
    try:
        return ModbusLoadFrame(link, registers, known, clock)
    except SemliveError:
        link.close()
        raise
