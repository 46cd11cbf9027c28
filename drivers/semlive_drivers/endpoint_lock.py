"""One machine, one master: a device's endpoint is reserved for one process of this computer before the first byte is sent to it.

An endpoint is the resolved address, port and unit of a device behind Modbus TCP, or a serial line. Links of one process share it: several
parts on one line, a stage beside a load frame, a link that is opened again. It is released

- with the last link to it, where links are opened in the main thread (`semlive frame check`);
- when the thread ends that opened it, in any other thread: a link thread closes a failed link and opens another again and again, and no
  other process may come between;
- by the operating system when the process ends, however it ends.

Other computers, and devices that are reached under two addresses or answer to several units, are not seen by it.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Iterable
from dataclasses import dataclass, field

from semlive import process_lock
from semlive.endpoints import serial_name, tcp_names
from semlive.errors import LinkRefused
from semlive.process_lock import Holder, ProcessLock


@dataclass(slots=True)
class _Held:
    """A lock of this process, and how many links and threads use it."""

    lock: ProcessLock
    users: int = 0


_HELD: dict[str, _Held] = {}
_GUARD = threading.RLock()


@dataclass(eq=False)
class _ThreadUse:
    """What the links of one thread have reserved; it goes with the thread's local storage when the thread ends."""

    keys: set[str] = field(default_factory=set)


class _OfThread(threading.local):
    """The `_ThreadUse` of the thread that asks."""

    def __init__(self) -> None:
        self.use = _ThreadUse()
        weakref.finalize(self.use, _give_back, self.use.keys).atexit = False


class Reservation:
    """One link's share of an endpoint; made by `reserve_tcp` and `reserve_serial`."""

    def __init__(self, keys: tuple[str, ...]) -> None:
        self._keys = keys

    def release(self) -> None:
        """Give the share back; never raises, any number of times, in any thread."""
        keys, self._keys = self._keys, ()
        _give_back(keys)


def reserve_tcp(host: str, port: int, unit: int | None = None) -> Reservation:
    """Reserve a device behind a TCP port.

    Args:
        host: name or address.
        port: TCP port.
        unit: Modbus unit; units behind one gateway are devices of their own. None for devices without.

    Raises:
        LinkRefused: another process of this computer holds it.
    """
    where = f"{host}:{port}" if unit is None else f"{host}:{port} unit {unit}"
    return _reserve(tcp_names(host, port, unit), where)


def reserve_serial(path: str) -> Reservation:
    """Reserve a serial line.

    Args:
        path: ``/dev/ttyUSB0``, a link to it, or ``COM3``.

    Raises:
        LinkRefused: another process of this computer holds it.
    """
    return _reserve([serial_name(path)], path)


def _reserve(keys: list[str], where: str) -> Reservation:
    with _GUARD:
        new: dict[str, _Held] = {}
        for key in keys:
            if key not in _HELD:
                lock = _lock(key, where)
                if isinstance(lock, Holder):
                    for taken in new.values():
                        taken.lock.release()
                    raise LinkRefused(f"{where} is driven by another semlive already, {lock}; stop that run first, or correct the endpoint")
                new[key] = _Held(lock)
        _HELD.update(new)
        in_main_thread = threading.current_thread() is threading.main_thread()
        of_thread = set() if in_main_thread else _OF_THREAD.use.keys
        for key in keys:
            _HELD[key].users += 1
            if not in_main_thread and key not in of_thread:
                _HELD[key].users += 1
                of_thread.add(key)
    return Reservation(tuple(keys))


def _lock(key: str, where: str) -> ProcessLock | Holder:
    try:
        return process_lock.acquire(key)
    except OSError as error:
        raise LinkRefused(
            f"{where} cannot be reserved for this run ({error.strerror or error}); allow semlive unix sockets (AF_UNIX), see docs/how-to/deploy.md"
        ) from error


def _give_back(keys: Iterable[str]) -> None:
    with _GUARD:
        for key in keys:
            held = _HELD[key]
            held.users -= 1
            if held.users == 0:
                del _HELD[key]
                held.lock.release()


_OF_THREAD = _OfThread()
