"""A device that a register map describes, as a part of a load frame."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping, Sequence

from semlive.data.loading import DeviceFault, MotionState
from semlive.errors import LinkError, LinkRefused, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.device_part import FOREIGN_ORDER, WITHHELD, PartCommand, PartReading, StopMethod, Stops
from semlive_drivers.modbus.codec import block_of, decode, encode
from semlive_drivers.modbus.device import DeviceRegisters, StaleReadingCheck, open_link, probe_blocks
from semlive_drivers.modbus.device_map import DeviceMap, Heartbeat, load_map
from semlive_drivers.modbus.link import Link
from semlive_drivers.modbus.orders.commander import Commander
from semlive_drivers.modbus.orders.read_back import TargetWatch
from semlive_drivers.modbus.orders.requests import DescribedOrders
from semlive_drivers.modbus.readings import RegisterReading
from semlive_drivers.modbus.registers import RegisterPoint, overridden_points
from semlive_drivers.modbus.rtu.line import NoReply
from semlive_drivers.modbus.settings import PartSettings
from semlive_drivers.settings import checked
from semlive_drivers.units import factor


class WatchdogFeed:
    """Writes the heartbeat that feeds the watchdog of a device.

    Args:
        registers: of the device.
        points: points of the device by name.
        heartbeat: what to write; None if the device needs no heartbeat.
    """

    def __init__(self, registers: DeviceRegisters, points: Mapping[str, RegisterPoint], heartbeat: Heartbeat | None) -> None:
        self._registers, self._points, self._heartbeat = registers, points, heartbeat
        self._value = 0
        self._withheld = False

    def feed(self) -> None:
        """Write the next heartbeat; raises LinkError if the device does not answer."""
        beat = self._heartbeat
        if beat is None or self._withheld:
            return
        highest = beat.value if beat.how == "counter" and beat.value > 1 else 65_535
        self._value = {"constant": beat.value, "toggle": self._value ^ 1, "counter": (self._value + 1) % (highest + 1)}[beat.how]
        point = self._points[beat.point]
        self._registers.write(point.address, encode(point, self._value), point.kind)

    def withhold(self) -> None:
        """Write no heartbeat any more, until the link is opened again."""
        self._withheld = True


class ModbusPart:
    """The DevicePart over one Modbus link; opened by `open_part`.

    Args:
        link: open.
        device: the description of the device.
        points: points of the device by name, with the changes of the configuration.
        settings: of the part.
        clock: experiment time.

    Raises:
        LinkRefused: if another device answers.
        LinkError: if no valid answer comes.
    """

    manual = False

    def __init__(
        self, link: Link, device: DeviceMap, points: Mapping[str, RegisterPoint], settings: PartSettings, clock: ClockSource
    ) -> None:
        self._link, self._device, self._points, self._settings, self._clock = link, device, points, settings, clock
        self.where = link.where
        self._registers = DeviceRegisters(link, points)
        self._blocks = [(names, block_of((points[name] for name in names), device.max_block)) for names in device.every_turn]
        gage = device.tells.strain_gage if settings.strain_gage else None
        self._gage = None if gage is None else (gage, block_of((points[gage],)))
        self._stale_check = StaleReadingCheck(link, settings.frozen_after_s)
        self._commander = Commander(link, device, points, settings, self._registers.read, clock.mono_ns() // 1_000_000 % 65_536)
        self.book = DescribedOrders(device, points)
        self.capabilities = self.book.can
        self._target = TargetWatch()
        self._target_jump: str | None = None
        self._watchdog = WatchdogFeed(self._registers, points, device.heartbeat)
        self._last_reading = RegisterReading(self.where, device, points, {})
        self._check_identity()
        checked_identity = settings.identity is not None
        self.simulated = checked_identity and self._registers.holds(device.simulated)
        self.has_watchdog = bool(checked_identity and settings.watchdog_s and self._registers.holds(device.stops_by_itself))
        self.stops = Stops(self._commander.stop_blind, self._stop_methods())
        if settings.watchdog_s and PartCommand.ARM in device.orders:
            self.command(PartCommand.ARM, {})

    def read(self) -> PartReading:
        """Feed the watchdog of the device, then take a new reading.

        Raises:
            LinkError: if no valid answer comes, the reading is frozen, or a condition of the map states that it is invalid.
        """
        self._registers.begin_turn()
        self._registers.end_turn()
        self._watchdog.feed()
        return self.identify()

    def order_changed(self) -> str | None:
        """How the orders in the device differ from the last order, as a message, or None; begins a turn that `read` ends.

        Raises:
            LinkError: if the device does not answer.
        """
        self._registers.begin_turn()
        difference = self._commander.difference() or self._target_jump
        return None if difference is None else f"{self.where}: {difference}"

    @property
    def cleared(self) -> bool:
        """Whether the registers of the last order are all 0, as `semlive_drivers.device_part.OrderHolder`."""
        return self._commander.cleared

    def recall(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process; writes nothing."""
        self._commander.recall(order, values)

    def identify(self) -> PartReading:
        """Take a new reading without writing anything; raises as `read`."""
        registers: dict[str, Sequence[int]] = {}
        raw: tuple[int, ...] = ()
        for names, block in self._blocks:
            values = self._registers.read(block)
            raw += values
            registers.update((name, values[block.slice(self._points[name])]) for name in names)
        gage_strain = None
        if self._gage is not None:
            name, block = self._gage
            values = self._registers.read(block)
            raw += values
            # With a broken wire or an amplifier that is off, the register holds no number.
            with contextlib.suppress(LinkError):
                gage_strain = decode(self._points[name], values) * factor(self._device.tells.strain_gage_unit, "strain gage")
        reading = RegisterReading(self.where, self._device, self._points, registers)
        reading.require_valid()
        self._last_reading = reading
        return self._part_reading(reading, raw, gage_strain)

    def command(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; return after the device took it, and after it was read back where the map requires that.

        Raises:
            LinkError: if the device did not take it, or if it is a motion and the description is not confirmed.
        """
        self._commander.give(order, values)
        if order in (PartCommand.RAMP, PartCommand.STOP):
            self._target, self._target_jump = self._target.after_order(values.get("force_n"), _now_s(self._clock)), None

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm, in the last reading; 0 for floats."""
        return self._last_reading.resolution()

    def blind_stop(self) -> None:
        """Write a stop without waiting for an answer."""
        self.stops.blind()

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _stop_methods(self) -> tuple[StopMethod, ...]:
        """Further stop methods that the map states; the last one withholds the heartbeat if the watchdog is armed."""
        stated = tuple(
            StopMethod(stop.says, functools.partial(self._commander.stop_by, index)) for index, stop in enumerate(self._device.other_stops)
        )
        if not self.has_watchdog or self._device.heartbeat is None:
            return stated
        return (*stated, StopMethod(WITHHELD, self._watchdog.withhold))

    def _check_identity(self) -> None:
        """Compare the identity registers with the map; raises LinkRefused if they differ. Without a check, read the first one."""
        if self._settings.identity is None:
            for condition in self._device.identity[:1]:
                self._registers.read_point(condition.point)
            return
        for index, condition in enumerate(self._device.identity):
            expected = condition.equals
            if index == 0 and isinstance(self._settings.identity, int):
                expected = [self._settings.identity]
            identity = self._registers.read_point(condition.point)
            if condition.model_copy(update={"equals": expected}).holds(identity):
                continue
            hint = condition.says or "check host and unit"
            raise LinkRefused(
                f"{self.where} is another device: its {condition.point} is {identity:#06x} instead of "
                f"{' or '.join(f'{value:#06x}' for value in expected)}; {hint}"
            )

    def _part_reading(self, reading: RegisterReading, raw: tuple[int, ...], gage_strain: float | None) -> PartReading:
        readouts, counter = self._device.tells, reading.counter()
        if counter is not None:
            self._stale_check.check(counter[0], self._clock.mono_ns())
        motion, target_n = reading.motion(), reading.value(readouts.target, readouts.force_unit)
        self._watch_target(motion, target_n, reading)
        return PartReading(
            force_n=reading.value(readouts.force, readouts.force_unit),
            extension_mm=reading.value(readouts.extension, readouts.extension_unit),
            motion=motion,
            target_n=target_n,
            lag_s=reading.value(readouts.lag) if self.simulated else None,
            force_max_n=reading.value(readouts.force_limit, readouts.force_unit),
            gage_strain=gage_strain,
            raw=raw,
            trouble=self._fault_reason() if motion is MotionState.FAULT else None,
            reading_counter=counter,
        )

    def _watch_target(self, motion: MotionState | None, target_n: float | None, reading: RegisterReading) -> None:
        """Compare the target in the device with the load that was ordered; in a fault a device may clear it."""
        readouts = self._device.tells
        if motion is MotionState.FAULT:
            self._target = self._target.after_order(None, _now_s(self._clock))
        elif readouts.target is not None and target_n is not None:
            count_n = reading.step_of(readouts.target, readouts.force_unit)
            self._target, jump = self._target.after_reading(target_n, _now_s(self._clock), count_n)
            self._target_jump = None if jump is None else f"{jump}: {FOREIGN_ORDER}"

    def _fault_reason(self) -> DeviceFault | None:
        """The reason of a fault; None if the map does not list the value of its register."""
        reason = self._device.tells.trouble
        return None if reason is None else reason.words.get(self._registers.read_point(reason.point))


def _now_s(clock: ClockSource) -> float:
    return clock.mono_ns() / 1e9


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "modbus load frame") -> ModbusPart:
    """Open the link and check the identity of the device.

    Args:
        settings: as of `PartSettings`.
        clock: experiment time.
        where: name of the settings in an error.

    Raises:
        BadConfig: for settings or a map that are not valid.
        LinkRefused: if no device, or another one, answers.
        LinkError: if an answer is not valid.
    """
    config = checked(PartSettings, settings, where)
    device = load_map(config.map)
    points = overridden_points({name: text.point() for name, text in device.points.items()}, config.registers, f"{where}: registers")
    link = open_link(config, device, probe_blocks(device, points))
    try:
        return ModbusPart(link, device, points, config, clock)
    except NoReply as error:
        link.close()
        raise LinkRefused(str(error)) from error
    except SemliveError:
        link.close()
        raise
