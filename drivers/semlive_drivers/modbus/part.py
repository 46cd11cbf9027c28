"""A device that a register map describes, as a part of a load frame."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping, Sequence

from semlive.data.loading import DeviceFault, MotionState
from semlive.errors import LinkError, LinkRefused, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.device_part import WITHHELD, PartCommand, PartReading, Stops, Way
from semlive_drivers.modbus.client import Link, ModbusLink, RtuLink
from semlive_drivers.modbus.codec import Block, block_of, count_of, decode, encode, number_in, require_in_range
from semlive_drivers.modbus.commander import Commander
from semlive_drivers.modbus.device import StaleReadingCheck
from semlive_drivers.modbus.device_map import Condition, DeviceMap, load_map
from semlive_drivers.modbus.orders import DescribedOrders
from semlive_drivers.modbus.read_back import TargetWatch
from semlive_drivers.modbus.registers import RegisterPoint, overridden_points
from semlive_drivers.modbus.rtu.line import NoReply
from semlive_drivers.modbus.rtu.shared_line import open_shared_line
from semlive_drivers.modbus.settings import ModbusSettings, PartSettings, checked
from semlive_drivers.serial_port import SerialSettings
from semlive_drivers.units import factor


class ModbusPart:
    """The Part over one Modbus link; opened by `open_part`."""

    manual = False

    def __init__(
        self, link: Link, device: DeviceMap, points: Mapping[str, RegisterPoint], settings: PartSettings, clock: ClockSource
    ) -> None:
        self._link, self._device, self._points, self._settings, self._clock = link, device, points, settings, clock
        self._blocks = [(names, block_of((points[name] for name in names), device.max_block)) for names in device.every_turn]
        gage = device.tells.strain_gage if settings.strain_gage else None
        self._gage = None if gage is None else (gage, block_of((points[gage],)))
        self._frozen = StaleReadingCheck(link, settings.frozen_after_s)
        self._commander = Commander(link, device, points, settings, self._again, clock.mono_ns() // 1_000_000 % 65_536)
        self.book = DescribedOrders(device, points)
        self._target = TargetWatch()
        self._target_jump: str | None = None
        self._in_turn = False
        self._words: Mapping[str, Sequence[int]] = {}
        self._beat = 0
        self._withheld = False
        self._recovered = False
        self._greet()
        checked_identity = settings.identity is not None
        self.simulated = checked_identity and self._true(device.simulated)
        self.has_watchdog = bool(checked_identity and settings.watchdog_s and self._true(device.stops_by_itself))
        self.stops = Stops(self._commander.stop_blind, self._ways())
        if settings.watchdog_s and PartCommand.ARM in device.orders:
            self.command(PartCommand.ARM, {})

    @property
    def where(self) -> str:
        """How it is reached."""
        return self._link.where

    @property
    def capabilities(self) -> frozenset[PartCommand]:
        """What it can be told."""
        return self.book.can

    def read(self) -> PartReading:
        """A fresh reading, after feeding the device's watchdog.

        Raises:
            LinkError: if nothing sensible comes back, the reading is frozen, or the device says that it is none.
        """
        self._begin_turn()
        self._in_turn = False
        self._feed()
        return self.identify()

    def order_changed(self) -> str | None:
        """How the device's own orders differ from what was given last, as a sentence, or None; begins a turn that `read` ends.

        Raises:
            LinkError: if the device does not answer.
        """
        self._begin_turn()
        found = self._commander.difference() or self._target_jump
        return None if found is None else f"{self.where}: {found}"

    @property
    def cleared(self) -> bool:
        """Whether the registers of the last order are all 0, as `semlive_drivers.device_part.OrderHolder`."""
        return self._commander.cleared

    def recall(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process; writes nothing."""
        self._commander.recall(what, values)

    def _begin_turn(self) -> None:
        """A link is recovered at most once in a turn, so that a turn stays short."""
        if not self._in_turn:
            self._recovered = False
        self._in_turn = True

    def identify(self) -> PartReading:
        """A fresh reading, without writing anything; raises as `read`."""
        words: dict[str, Sequence[int]] = {}
        raw: tuple[int, ...] = ()
        for names, block in self._blocks:
            registers = self._again(block)
            raw += registers
            words.update((name, registers[block.slice(self._points[name])]) for name in names)
        gage_strain = None
        if self._gage is not None:
            name, block = self._gage
            registers = self._again(block)
            raw += registers
            # A broken wire or an amplifier that is off reads as no number.
            with contextlib.suppress(LinkError):
                gage_strain = decode(self._points[name], registers) * factor(self._device.tells.strain_gage_unit, "strain gage")
        for condition in self._device.valid:
            if not condition.holds(self._word(condition.point, words)):
                raise LinkError(f"{self.where} gives no reading: {condition.says or f'{condition.point} is not as it must be'}")
        self._words = words
        return self._said(words, raw, gage_strain)

    def command(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; returns when it was taken, and read back where the map says so.

        Raises:
            LinkError: if the device did not take it, or its description is not confirmed and it would move.
        """
        self._commander.give(what, values)
        if what in (PartCommand.RAMP, PartCommand.STOP):
            self._target, self._target_jump = self._target.after_order(values.get("force_n"), self._now_s), None

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm, in the last reading; 0 for floats."""
        tells, told = self._device.tells, self._words
        named = ((tells.force, tells.force_unit), (tells.extension, tells.extension_unit))
        force, extension = (0.0 if name is None else count_of(self._points[name], told) * factor(unit, name) for name, unit in named)
        return force, extension

    def blind_stop(self) -> None:
        """Write a stop without waiting for an answer."""
        self.stops.blind()

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _ways(self) -> tuple[Way, ...]:
        """Further ways to stop that the map states; last, where its watchdog is armed, to feed that no more."""
        others = self._device.other_stops
        stated = tuple(Way(stop.says, functools.partial(self._commander.stop_by, place)) for place, stop in enumerate(others))
        return (*stated, Way(WITHHELD, self._withhold)) if self.has_watchdog and self._device.heartbeat is not None else stated

    def _withhold(self) -> None:
        """Feed the watchdog no more, until the link is opened again."""
        self._withheld = True

    def read_point(self, name: str) -> int:
        """The bare number of a point, read for itself."""
        point = self._points[name]
        return int(number_in(point, self._link.read(block_of((point,)))))

    def _again(self, block: Block) -> tuple[int, ...]:
        """Read, and once more where the link recovers from a lost answer."""
        try:
            return self._link.read(block)
        except NoReply:
            if not self._recover():
                raise
            return self._link.read(block)

    def _greet(self) -> None:
        if self._settings.identity is None:
            self._read_identity()
            return
        for place, condition in enumerate(self._device.identity):
            wanted = condition.equals
            if place == 0 and isinstance(self._settings.identity, int):
                wanted = [self._settings.identity]
            said = self.read_point(condition.point)
            if condition.model_copy(update={"equals": wanted}).holds(said):
                continue
            hint = condition.says or "check host and unit"
            raise LinkRefused(
                f"{self.where} is another device: its {condition.point} is {said:#06x} instead of "
                f"{' or '.join(f'{value:#06x}' for value in wanted)}; {hint}"
            )

    def _read_identity(self) -> None:
        """Somebody must answer sensibly, whoever it is."""
        for condition in self._device.identity[:1]:
            self.read_point(condition.point)

    def _true(self, condition: Condition | None) -> bool:
        return condition is not None and condition.holds(self.read_point(condition.point))

    def _feed(self) -> None:
        beat = self._device.heartbeat
        if beat is None or self._withheld:
            return
        highest = beat.value if beat.how == "counter" and beat.value > 1 else 65_535
        self._beat = {"constant": beat.value, "toggle": self._beat ^ 1, "counter": (self._beat + 1) % (highest + 1)}[beat.how]
        point = self._points[beat.point]
        try:
            self._link.write(point.address, encode(point, self._beat), point.kind)
        except NoReply:
            if not self._recover():
                raise

    def _recover(self) -> bool:
        """Once in a turn, so that a turn stays short."""
        again, self._recovered = not self._recovered, True
        return again and self._link.resync()

    def _word(self, name: str, words: Mapping[str, Sequence[int]]) -> int:
        return int(number_in(self._points[name], words[name]))

    def _value(self, name: str | None, words: Mapping[str, Sequence[int]], unit: str = "1") -> float | None:
        if name is None:
            return None
        point, own = self._points[name], words[name]
        value = decode(point, own, words)
        if name in (self._device.tells.force, self._device.tells.extension):
            try:
                require_in_range(name, point, own, value, unsigned=name == self._device.tells.force)
            except LinkError as error:
                raise LinkError(f"{self.where}: {error}") from error
        return value * factor(unit, name)

    def _said(self, words: Mapping[str, Sequence[int]], raw: tuple[int, ...], gage_strain: float | None) -> PartReading:
        tells, counted = self._device.tells, None
        if tells.counter is not None:
            counted = self._word(tells.counter, words), 1 << 16 * self._points[tells.counter].dtype.registers
            self._frozen.check(counted[0], self._clock.mono_ns())
        motion, target_n = self._motion(words), self._value(tells.target, words, tells.force_unit)
        self._watch_target(motion, target_n, words)
        return PartReading(
            force_n=self._value(tells.force, words, tells.force_unit),
            extension_mm=self._value(tells.extension, words, tells.extension_unit),
            motion=motion,
            target_n=target_n,
            lag_s=self._value(tells.lag, words) if self.simulated else None,
            force_max_n=self._value(tells.force_limit, words, tells.force_unit),
            gage_strain=gage_strain,
            raw=raw,
            trouble=self._trouble() if motion is MotionState.FAULT else None,
            reading_counter=counted,
        )

    def _watch_target(self, motion: MotionState | None, target_n: float | None, words: Mapping[str, Sequence[int]]) -> None:
        """Hold the device's own target against the load that was ordered; in a fault a device may forget it."""
        name, unit = self._device.tells.target, self._device.tells.force_unit
        if motion is MotionState.FAULT:
            self._target = self._target.after_order(None, self._now_s)
        elif name is not None and target_n is not None:
            count_n = count_of(self._points[name], words) * factor(unit, name)
            self._target, jump = self._target.after_reading(target_n, self._now_s, count_n)
            self._target_jump = None if jump is None else f"{jump}: another program or a person commands it, or it was restarted"

    @property
    def _now_s(self) -> float:
        return self._clock.mono_ns() / 1e9

    def _trouble(self) -> DeviceFault | None:
        """Why it is in fault; a word that is not known tells nothing."""
        reason = self._device.tells.trouble
        return None if reason is None else reason.words.get(self.read_point(reason.point))

    def _motion(self, words: Mapping[str, Sequence[int]]) -> MotionState | None:
        motion = self._device.tells.motion
        if motion is None:
            return None
        if motion.point is not None:
            word = self._word(motion.point, words)
            if word not in motion.states:
                raise LinkError(f"{self.where} says motion state {word}, which does not exist; check the register map")
            return motion.states[word]
        if any(condition.holds(self._word(condition.point, words)) for condition in motion.fault):
            return MotionState.FAULT
        moving = any(condition.holds(self._word(condition.point, words)) for condition in motion.moving)
        return MotionState.MOVING if moving else MotionState.STOPPED


def open_link(settings: ModbusSettings, device: DeviceMap | None, probes: Sequence[Block]) -> Link:
    """A link to a unit, over TCP or a serial line, which may be one that this process has open already.

    Args:
        settings: where it is.
        device: whose usual line settings hold where the configuration says nothing.
        probes: blocks that can be read without harm.

    Raises:
        BadConfig: if the serial line is open with other settings.
        LinkRefused: if nobody answers.
        LinkError: if the unit does not settle.
    """
    if settings.serial is None:
        return ModbusLink(settings.host, settings.port, settings.unit, settings.timeout_s)
    given = settings.serial.over(device.serial) if device else settings.serial.model_dump(exclude_none=True)
    serial, who = SerialSettings.model_validate(given), device.name if device else "modbus"
    line = open_shared_line(serial, settings.timeout_s, who)
    try:
        return RtuLink(line, settings.unit, probes, lambda: open_shared_line(serial, settings.timeout_s, who))
    except LinkError:
        line.close()
        raise


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "modbus load frame") -> ModbusPart:
    """Open the link and check who answers.

    Raises:
        BadConfig: for settings or a map that are not understood.
        LinkRefused: if nobody, or somebody else, answers.
        LinkError: if the device answers nonsense.
    """
    known = checked(PartSettings, settings, where)
    device = load_map(known.map)
    points = overridden_points({name: text.point() for name, text in device.points.items()}, known.registers, f"{where}: registers")
    link = open_link(known, device, probe_blocks(device, points))
    try:
        return ModbusPart(link, device, points, known, clock)
    except NoReply as error:
        link.close()
        raise LinkRefused(str(error)) from error
    except SemliveError:
        link.close()
        raise


def probe_blocks(device: DeviceMap, points: Mapping[str, RegisterPoint]) -> tuple[Block, ...]:
    """Blocks of a device that can be read without harm: what is read anyway."""
    blocks = [block_of((points[name] for name in names), device.max_block) for names in device.every_turn]
    return (*blocks, *(block_of((points[condition.point],)) for condition in device.identity))
