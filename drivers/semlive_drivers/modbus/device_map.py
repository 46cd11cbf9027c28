"""Register map of a Modbus device: its points, their meaning and its orders (docs/reference/register-maps.md)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from semlive.data.loading import DeviceFault, MotionState
from semlive_drivers.device_part import PartCommand
from semlive_drivers.maps import Described, DeviceDescription, validate_map
from semlive_drivers.modbus.registers import MAX_BLOCK, BitField, DType, Factor, Kind, RegisterPoint, WordOrder
from semlive_drivers.units import factor

ORDERED = ("force_n", "rate_n_s", "travel_mm", "speed_mm_s", "watchdog_s", "nonce")
"""Names of values that an order may write instead of numbers; a minus sign before a name inverts the sign."""


def _unit(name: str) -> str:
    factor(name, "unit")
    return name


Unit = Annotated[str, AfterValidator(_unit)]


class PointConfig(Described):
    """A point in a description; see `RegisterPoint`."""

    kind: Kind
    address: int
    dtype: DType = DType.U16
    words: WordOrder = WordOrder.HIGH_FIRST
    byte_order: WordOrder = WordOrder.HIGH_FIRST
    scale: float = 1.0
    offset: float = 0.0
    bits: tuple[int, int] | None = None
    """Lowest bit and number of bits."""
    sentinels: tuple[int, ...] = ()
    sign: tuple[str, int] | None = None
    """Point, and its bit that is set when the number is negative."""
    decimals: tuple[str, int, int] | None = None
    """Point, lowest bit and number of bits of the number of decimals."""
    factors: list[FactorConfig] = Field(default_factory=list)
    range: tuple[float, float] | None = None
    """Range of the sensor, in the unit of the value; a value at or beyond an end is no reading."""

    @model_validator(mode="after")
    def _range_rises(self) -> PointConfig:
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range {list(self.range)} must give the low end first")
        return self

    def point(self) -> RegisterPoint:
        """The point as a value."""
        factors = tuple(Factor(BitField(text.point, *text.bits), tuple(text.values.items())) for text in self.factors)
        if self.decimals is not None:
            factors = (*factors, Factor(BitField(*self.decimals)))
        return RegisterPoint(
            self.kind,
            self.address,
            self.dtype,
            self.words,
            self.scale,
            self.byte_order,
            self.offset,
            *(self.bits or (0, 0)),
            self.sentinels,
            None if self.sign is None else BitField(self.sign[0], self.sign[1], 1),
            factors,
            self.range,
        )


class FactorConfig(Described):
    """Factors of this number by the value of bits of another point."""

    point: str
    bits: tuple[int, int] = (0, 16)
    values: dict[int, float]


def _as_list(given: object) -> object:
    return [given] if isinstance(given, int) else given


class Condition(Described):
    """A condition on the number of a point."""

    point: str
    bit: int | None = Field(default=None, ge=0, le=63)
    """Bit of the number; None compares the complete number."""
    equals: Annotated[list[int], BeforeValidator(_as_list)] = Field(default_factory=lambda: [1])
    """Numbers for which the condition is true."""
    says: str = ""
    """Message for the operator where the condition is false."""

    def holds(self, number: int) -> bool:
        """Whether the condition is true for the number of the point."""
        return (number if self.bit is None else number >> self.bit & 1) in self.equals


class Motion(Described):
    """Motion state of the device: by the values of one point, or by conditions, of which any one is sufficient."""

    point: str | None = None
    states: dict[int, MotionState] = Field(default_factory=dict)
    moving: list[Condition] = Field(default_factory=list)
    fault: list[Condition] = Field(default_factory=list)

    @property
    def points(self) -> set[str]:
        """Points that the motion state depends on."""
        return {condition.point for condition in (*self.moving, *self.fault)} | ({self.point} if self.point else set())


class FaultReason(Described):
    """Point that holds the reason of a fault, and the meaning of its values."""

    point: str
    words: dict[int, DeviceFault]


class Readouts(Described):
    """Points of the measured values; ``..._unit`` is the unit of the point's value."""

    force: str | None = None
    force_unit: Unit = "N"
    extension: str | None = None
    extension_unit: Unit = "mm"
    target: str | None = None
    force_limit: str | None = None
    lag: str | None = None
    counter: str | None = None
    """Counter of readings: if it does not change, the reading is frozen."""
    strain_gage: str | None = None
    strain_gage_unit: Unit = "1"
    motion: Motion | None = None
    trouble: FaultReason | None = None
    """Read only while the device is in fault."""


class Write(Described):
    """One request of an order."""

    set: dict[str, float | str] = Field(min_length=1)
    """A number or a name of `ORDERED` by point; adjacent points are written in one request."""
    verify: bool = False
    """Read the registers back, and fail if they differ."""
    single: bool = False
    """Use FC06 or FC05 instead of FC16 or FC15."""


class OtherStop(Described):
    """A further method to stop the device, used when the device does not obey its stop order."""

    says: str = Field(min_length=1)
    """What the method does, for the operator: ``enable off``, ``speed 0``."""
    writes: list[Write] = Field(min_length=1)


class Heartbeat(Described):
    """Value that is written with every reading to feed the watchdog of the device."""

    point: str
    how: Literal["constant", "toggle", "counter"] = "counter"
    value: int = 1
    """The constant value, or the highest number before the counter restarts at 0 (0: 65,535)."""


class SerialConfig(Described):
    """Factory settings of the serial line of the device; the configuration may change them."""

    baud: int = 19_200
    parity: Literal["none", "even", "odd"] = "even"
    stop_bits: Literal[1, 2] = 1
    silence_s: float = 0.0
    slowest_s: float = 1.0


class DeviceMap(DeviceDescription):
    """The description of a Modbus device."""

    protocol: Literal["modbus"]
    serial: SerialConfig = SerialConfig()
    max_block: int = Field(default=MAX_BLOCK, ge=1, le=MAX_BLOCK)
    points: dict[str, PointConfig]
    every_turn: list[list[str]] = Field(default_factory=list)
    """Groups of points, each of which is read in one request with every reading."""
    identity: list[Condition] = Field(default_factory=list)
    """Conditions that identify the device; the configuration may set another value for the first."""
    simulated: Condition | None = None
    stops_by_itself: Condition | None = None
    """True for a device that stops when its armed watchdog expires."""
    tells: Readouts = Readouts()
    valid: list[Condition] = Field(default_factory=list)
    """Conditions that every valid reading fulfils."""
    orders: dict[PartCommand, list[Write]] = Field(default_factory=dict)
    other_stops: list[OtherStop] = Field(default_factory=list)
    """Further methods to stop, in the order in which they are used; only those that the documents of the device state."""
    changes_by_itself: list[str] = Field(default_factory=list)
    """Points that orders write and that the device changes by itself afterwards; they are not compared with the order."""
    heartbeat: Heartbeat | None = None

    @model_validator(mode="after")
    def _points_exist(self) -> DeviceMap:
        for where, names in self._references().items():
            for name in names:
                if name not in self.points:
                    raise ValueError(f"{where} names a point {name!r} that is not among points")
        every = {name for group in self.every_turn for name in group}
        required = {*self._measured(), *(condition.point for condition in self.valid)}
        for name in list(required):
            required |= set(self.points[name].point().needs)
        if required - every:
            raise ValueError(f"every_turn must contain {', '.join(sorted(required - every))}, which every reading needs")
        for order, writes in self.orders.items():
            for write in writes:
                self._check_write(f"orders.{order}", write)
        for stop in self.other_stops:
            for write in stop.writes:
                self._check_write(f"other_stops ({stop.says})", write)
        return self

    def _check_write(self, where: str, write: Write) -> None:
        """Raise ValueError for a value that an order cannot write exactly."""
        for name, value in write.set.items():
            if isinstance(value, str) and value.removeprefix("-") not in ORDERED:
                raise ValueError(f"{where} writes {value!r}; an order can write numbers and {', '.join(ORDERED)}")
            point = self.points[name]
            if point.kind in (Kind.INPUT, Kind.DISCRETE):
                raise ValueError(f"{where} writes {name}, which is read-only ({point.kind}); write holding registers or coils")
            if point.bits or point.sign or point.factors or point.decimals:
                raise ValueError(f"{where} writes {name}, whose value depends on other bits or registers; write a plain number")

    def _measured(self) -> set[str]:
        """Points of the values of every reading."""
        readouts = self.tells
        values = (readouts.force, readouts.extension, readouts.target, readouts.force_limit, readouts.lag, readouts.counter)
        return {name for name in values if name} | (readouts.motion.points if readouts.motion else set())

    def _read_separately(self) -> set[str]:
        """Points that are read in requests of their own."""
        readouts = self.tells
        return ({readouts.strain_gage} if readouts.strain_gage else set()) | ({readouts.trouble.point} if readouts.trouble else set())

    def _references(self) -> dict[str, set[str]]:
        """Names of points by the key that refers to them."""
        needs = {name for point in self.points.values() for name in point.point().needs}
        conditions = [*self.identity, *self.valid, *(c for c in (self.simulated, self.stops_by_itself) if c)]
        return {
            "points": needs,
            "tells": self._measured() | self._read_separately(),
            "every_turn": {name for group in self.every_turn for name in group},
            "identity or valid": {condition.point for condition in conditions},
            "plausible": set(self.plausible),
            "orders": {name for writes in self.orders.values() for write in writes for name in write.set},
            "other_stops": {name for stop in self.other_stops for write in stop.writes for name in write.set},
            "changes_by_itself": set(self.changes_by_itself),
            "heartbeat": {self.heartbeat.point} if self.heartbeat else set(),
        }


def load_map(name: str) -> DeviceMap:
    """A register map by name or path.

    Raises:
        BadConfig: if it does not exist or is not valid.
    """
    return validate_map(DeviceMap, name)


def number(value: Any, values: dict[str, float]) -> float:
    """The number that an order writes: a fixed number, or a value of the order by its name."""
    if not isinstance(value, str):
        return float(value)
    return -values[value[1:]] if value.startswith("-") else values[value]
