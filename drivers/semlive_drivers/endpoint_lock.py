"""Reservation of a device: one process of this computer reserves the endpoint before it sends the first byte to the device.

An endpoint is the resolved address, port and unit of a device behind Modbus TCP, or a serial line. Links of one process share it: several
parts on one line, a stage with a load frame, a link that is opened again. It is released

- with the last link to it, if the link was opened in the main thread (`semlive frame check`);
- at the end of the thread that opened it, in any other thread: a link thread closes and opens a failing link repeatedly, and no other
  process may command the device in between;
- by the operating system when the process ends, in any way.

The reservation does not detect other computers, nor a device with two addresses or several units.
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


@dataclass(slots=True, eq=False)
class _EndpointLock:
    """A lock of this process, and the number of links and threads that use it."""

    key: str
    lock: ProcessLock
    users: int = 0


_LOCKS: dict[str, _EndpointLock] = {}
_GUARD = threading.RLock()


@dataclass(eq=False)
class _ThreadUse:
    """Endpoints reserved by links of one thread; deleted with the local storage of the thread when it ends."""

    endpoints: set[_EndpointLock] = field(default_factory=set)


class _ThreadStorage(threading.local):
    """The `_ThreadUse` of the calling thread."""

    def __init__(self) -> None:
        self.use = _ThreadUse()
        weakref.finalize(self.use, _release, self.use.endpoints).atexit = False


class Reservation:
    """The use of an endpoint by one link; made by `reserve_tcp` and `reserve_serial`."""

    def __init__(self, endpoints: tuple[_EndpointLock, ...]) -> None:
        self._endpoints = endpoints

    def release(self) -> None:
        """Release the endpoint; never raises, can be repeated, in any thread."""
        endpoints, self._endpoints = self._endpoints, ()
        _release(endpoints)


def reserve_tcp(host: str, port: int, unit: int | None = None) -> Reservation:
    """Reserve a device behind a TCP port.

    Args:
        host: host name or address.
        port: TCP port.
        unit: Modbus unit; units behind one gateway are separate devices. None for a device without units.

    Raises:
        LinkRefused: if another process of this computer has reserved it.
    """
    where = f"{host}:{port}" if unit is None else f"{host}:{port} unit {unit}"
    return _reserve(tcp_names(host, port, unit), where)


def reserve_serial(path: str) -> Reservation:
    """Reserve a serial line.

    Args:
        path: ``/dev/ttyUSB0``, a symbolic link to it, or ``COM3``.

    Raises:
        LinkRefused: if another process of this computer has reserved it.
    """
    return _reserve([serial_name(path)], path)


def _reserve(keys: list[str], where: str) -> Reservation:
    with _GUARD:
        new: dict[str, _EndpointLock] = {}
        for key in keys:
            if key not in _LOCKS:
                lock = _lock(key, where)
                if isinstance(lock, Holder):
                    for endpoint in new.values():
                        endpoint.lock.release()
                    raise LinkRefused(f"{where} is driven by another semlive already, {lock}; stop that run first, or correct the endpoint")
                new[key] = _EndpointLock(key, lock)
        _LOCKS.update(new)
        endpoints = tuple(_LOCKS[key] for key in keys)
        in_main_thread = threading.current_thread() is threading.main_thread()
        of_thread = set() if in_main_thread else _THREAD_STORAGE.use.endpoints
        for endpoint in endpoints:
            endpoint.users += 1
            if not in_main_thread and endpoint not in of_thread:
                endpoint.users += 1
                of_thread.add(endpoint)
    return Reservation(endpoints)


def _lock(key: str, where: str) -> ProcessLock | Holder:
    try:
        return process_lock.acquire(key)
    except OSError as error:
        raise LinkRefused(
            f"{where} cannot be reserved for this run ({error.strerror or error}); "
            "allow semlive unix sockets (AF_UNIX), see docs/how-to/deploy.md"
        ) from error


def _release(endpoints: Iterable[_EndpointLock]) -> None:
    with _GUARD:
        for endpoint in endpoints:
            endpoint.users -= 1
            if endpoint.users == 0:
                if _LOCKS.get(endpoint.key) is endpoint:  # not where a test has removed it and the name is reserved again
                    del _LOCKS[endpoint.key]
                endpoint.lock.release()


_THREAD_STORAGE = _ThreadStorage()
