"""The stored order of a device compared with the written order: differences are named, healthy devices raise no alarm."""

from __future__ import annotations

import pytest

from semlive_drivers.device_part import PartCommand
from semlive_drivers.modbus.codec import Block, encode
from semlive_drivers.modbus.device_map import DeviceMap, Write
from semlive_drivers.modbus.orders.read_back import (
    Entry,
    Memory,
    TargetWatch,
    cleared,
    comparable,
    compared,
    expected,
    forgotten,
    groups_of,
    remembered,
)
from semlive_drivers.modbus.orders.requests import requests_of
from semlive_drivers.modbus.registers import Kind


def described(**more: object) -> DeviceMap:
    return DeviceMap.model_validate(
        {
            "protocol": "modbus",
            "name": "a frame",
            "source": "none",
            "points": {
                "target": {"kind": "holding", "address": 10, "dtype": "i16", "scale": 0.1},
                "rate": {"kind": "holding", "address": 12, "scale": 0.1},
                "command": {"kind": "holding", "address": 14},
                "nonce": {"kind": "holding", "address": 15},
            },
            "orders": {
                "ramp": [{"set": {"target": "force_n", "rate": "rate_n_s", "command": 1, "nonce": "nonce"}}],
                "stop": [{"set": {"command": 2}, "verify": True}],
            },
            **more,
        }
    )


DEVICE = described()
POINTS = {name: text.point() for name, text in DEVICE.points.items()}
VALUES = {"force_n": 300.0, "rate_n_s": 30.0, "nonce": 7.0}


def written(memory: Memory, what: PartCommand, device: DeviceMap = DEVICE) -> Memory:
    for write in device.orders[what]:
        for request in requests_of(write, POINTS, VALUES):
            memory = remembered(memory, comparable(device), write, request, POINTS)
    return memory


def held(**values: float) -> dict[str, tuple[int, ...]]:
    return {name: encode(POINTS[name], value) for name, value in values.items()}


def test_targets_and_rates_are_compared_commands_only_where_they_are_verified_and_nonces_never() -> None:
    after_ramp = written({}, PartCommand.RAMP)
    assert set(after_ramp) == {"target", "rate"}
    after_stop = written(after_ramp, PartCommand.STOP)
    assert set(after_stop) == {"target", "rate", "command"}
    assert set(written(after_stop, PartCommand.RAMP)) == {"target", "rate"}
    spared = described(changes_by_itself=["rate"])
    assert set(written({}, PartCommand.RAMP, spared)) == {"target"}


def test_another_value_is_named_with_its_register_and_unit() -> None:
    memory, nothing = compared(written({}, PartCommand.RAMP), comparable(DEVICE), POINTS, held(target=300.0, rate=30.0))
    assert nothing is None
    _, difference = compared(memory, comparable(DEVICE), POINTS, held(target=380.0, rate=30.0))
    assert difference == "its target (holding register 10) holds 380 N, 300 N was written"
    _, difference = compared(memory, comparable(DEVICE), POINTS, held(target=300.0, rate=0.0))
    assert difference == "its rate (holding register 12) holds 0 N/s, 30 N/s was written"


def test_a_value_that_the_device_rounds_is_what_later_ones_are_compared_with() -> None:
    memory, nothing = compared(written({}, PartCommand.RAMP), comparable(DEVICE), POINTS, held(target=299.5))
    assert nothing is None
    assert memory["target"] == Entry((3000,), (2995,))
    assert compared(memory, comparable(DEVICE), POINTS, held(target=299.5))[1] is None
    assert compared(memory, comparable(DEVICE), POINTS, held(target=300.0))[1] is not None


def test_the_first_read_back_finds_a_value_that_was_not_taken() -> None:
    for value in (0.0, 290.0, -300.0):
        _, difference = compared(written({}, PartCommand.RAMP), comparable(DEVICE), POINTS, held(target=value))
        assert difference is not None


def test_what_an_order_wrote_that_failed_is_not_compared() -> None:
    assert set(forgotten(written({}, PartCommand.RAMP), ["target"])) == {"rate"}


def test_registers_that_are_all_cleared_are_a_restart_and_one_of_them_is_not() -> None:
    memory = written({}, PartCommand.RAMP)
    assert cleared(memory, held(target=0.0, rate=0.0))
    assert not cleared(memory, held(target=0.0, rate=30.0))
    assert not cleared(memory, held(target=0.0))
    assert not cleared({}, held(target=0.0, rate=0.0))


def test_the_order_of_an_earlier_process_is_compared_in_its_values_and_may_be_rounded() -> None:
    memory: Memory = {}
    for write in DEVICE.orders[PartCommand.STOP] + DEVICE.orders[PartCommand.RAMP]:
        for request in requests_of(write, POINTS, VALUES):
            memory = expected(memory, comparable(DEVICE), write, request, POINTS)
    assert set(memory) == {"target", "rate"}
    assert compared(memory, comparable(DEVICE), POINTS, held(target=299.5, rate=30.0))[1] is None
    assert compared(memory, comparable(DEVICE), POINTS, held(target=0.0, rate=0.0))[1] is not None


def test_points_are_read_together_or_each_for_itself() -> None:
    names = ("target", "rate")
    assert groups_of(names, POINTS, 123, together=True) == [(("target", "rate"), Block(Kind.HOLDING, 10, 3))]
    separate_blocks = [(("target",), Block(Kind.HOLDING, 10, 1)), (("rate",), Block(Kind.HOLDING, 12, 1))]
    assert groups_of(names, POINTS, 123, together=False) == separate_blocks
    assert groups_of(names, POINTS, 2, together=True) == separate_blocks


def test_a_jump_of_the_devices_own_target_is_named_and_a_drift_is_not() -> None:
    watch = TargetWatch().after_order(300.0, 0.0)
    watch, jump = watch.after_reading(0.0, 0.5, 0.0)  # not taken over yet
    assert jump is None
    for step in range(100):
        watch, jump = watch.after_reading(300.0 + 0.2 * step, 1.1 + step, 0.0)
        assert jump is None
    watch, jump = watch.after_reading(380.0, 200.0, 0.0)
    assert jump == "its own target is 380 N, 300 N was ordered"
    assert watch.after_order(None, 201.0).after_reading(12.0, 300.0, 0.0)[1] is None
    assert TargetWatch().after_order(300.0, 0.0).after_reading(380.0, 1.1, 0.0)[1] is not None


@pytest.mark.parametrize("count_n", [0.0, 1.0])
def test_a_target_of_zero_raises_no_alarm_by_its_noise(count_n: float) -> None:
    watch, jump = TargetWatch().after_order(0.0, 0.0).after_reading(2.0, 2.0, count_n)
    assert jump is None
    assert watch.after_reading(-2.0, 3.0, count_n)[1] is None


def test_a_verified_write_is_held_as_it_was_written() -> None:
    write = Write(set={"target": "force_n"}, verify=True)
    (request,) = requests_of(write, POINTS, VALUES)
    assert remembered({}, comparable(DEVICE), write, request, POINTS)["target"] == Entry((3000,), (3000,))
