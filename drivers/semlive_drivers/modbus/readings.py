"""Decode the registers of one reading by a device map, without IO."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from semlive.data.loading import MotionState
from semlive.errors import LinkError
from semlive_drivers.modbus.codec import count_of, decode, number_in, require_in_range
from semlive_drivers.modbus.device_map import DeviceMap
from semlive_drivers.modbus.registers import RegisterPoint
from semlive_drivers.units import factor


@dataclass(frozen=True, slots=True)
class RegisterReading:
    """The registers of one reading, decoded by a device map.

    Attributes:
        where: name of the device in errors.
        device: the description of the device.
        points: points of the device by name, with the changes of the configuration.
        registers: the registers of each point that was read, by name; empty before the first reading.
    """

    where: str
    device: DeviceMap
    points: Mapping[str, RegisterPoint]
    registers: Mapping[str, Sequence[int]]

    def require_valid(self) -> None:
        """Raise LinkError if a condition that every reading must fulfil is false."""
        for condition in self.device.valid:
            if not condition.holds(self.number(condition.point)):
                reason = condition.says or f"{condition.point} is not as it must be"
                raise LinkError(f"{self.where} gives no reading: {reason}")

    def number(self, name: str) -> int:
        """The unscaled number of a point."""
        return int(number_in(self.points[name], self.registers[name]))

    def value(self, name: str | None, unit: str = "1") -> float | None:
        """The value of a point in N, mm, s or strain; None without a point.

        Raises:
            LinkError: if it is no reading, or a force or an extension at the end of its range.
        """
        if name is None:
            return None
        readouts, point, registers = self.device.tells, self.points[name], self.registers[name]
        value = decode(point, registers, self.registers)
        if name in (readouts.force, readouts.extension):
            try:
                require_in_range(name, point, registers, value, unsigned=name == readouts.force)
            except LinkError as error:
                raise LinkError(f"{self.where}: {error}") from error
        return value * factor(unit, name)

    def counter(self) -> tuple[int, int] | None:
        """The counter of readings and its modulus; None if the device has none."""
        name = self.device.tells.counter
        return None if name is None else (self.number(name), 1 << 16 * self.points[name].dtype.registers)

    def motion(self) -> MotionState | None:
        """The motion state; None if the map describes none.

        Raises:
            LinkError: if the map does not list the state.
        """
        motion = self.device.tells.motion
        if motion is None:
            return None
        if motion.point is not None:
            state = self.number(motion.point)
            if state not in motion.states:
                raise LinkError(f"{self.where} reports motion state {state}, which does not exist; check the register map")
            return motion.states[state]
        if any(condition.holds(self.number(condition.point)) for condition in motion.fault):
            return MotionState.FAULT
        moving = any(condition.holds(self.number(condition.point)) for condition in motion.moving)
        return MotionState.MOVING if moving else MotionState.STOPPED

    def step_of(self, name: str | None, unit: str) -> float:
        """Value of one count of a point in N or mm; 0 without a point and for floats."""
        return 0.0 if name is None else count_of(self.points[name], self.registers) * factor(unit, name)

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm; 0 for floats."""
        readouts = self.device.tells
        return self.step_of(readouts.force, readouts.force_unit), self.step_of(readouts.extension, readouts.extension_unit)
