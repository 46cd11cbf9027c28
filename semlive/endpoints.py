"""What a device is called in locks: one name for one device, by whatever host name, address or link it is reached."""

from __future__ import annotations

import ipaddress
import os
import socket
import stat

_LOCAL = "localhost"


def tcp_names(host: str, port: int, unit: int | None) -> list[str]:
    """The names of a device behind a TCP port, one for each address that the host resolves to.

    Args:
        host: name or address.
        port: TCP port.
        unit: Modbus unit; None for devices without.
    """
    return [f"tcp {address} {port} {unit}" for address in addresses_of(host)]


def serial_name(path: str) -> str:
    """The name of a serial line, whose path may be a link."""
    return f"serial {line_of(path)}"


def addresses_of(host: str) -> list[str]:
    """Names of a host in locks: its numeric addresses, or one name for all addresses of this computer.

    A host name that cannot be resolved is used as it is.
    """
    try:
        found = {str(entry[4][0]) for entry in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except (OSError, UnicodeError):
        return [host.strip().rstrip(".").lower()]
    return sorted({_LOCAL if _is_local(address) else _plain(address) for address in found})


def line_of(path: str) -> str:
    """What a serial line is called in locks: the device's own number, so that links and copies of its node are one; else its real path."""
    if os.name == "nt":
        return path.upper().removeprefix("\\\\.\\").removesuffix(":")
    real = os.path.realpath(path)
    try:
        status = os.stat(real)
    except OSError:
        return real
    return f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}" if stat.S_ISCHR(status.st_mode) else real


def _plain(address: str) -> str:
    """IPv4 also where it is written as IPv6."""
    parsed = ipaddress.ip_address(address)
    mapped = parsed.ipv4_mapped if isinstance(parsed, ipaddress.IPv6Address) else None
    return str(mapped or parsed)


def _is_local(address: str) -> bool:
    """Whether a packet to this address stays on this computer: only its own addresses can be bound to."""
    plain = _plain(address)
    parsed = ipaddress.ip_address(plain)
    if parsed.is_loopback or parsed.is_unspecified:
        return True
    with socket.socket(socket.AF_INET6 if parsed.version == 6 else socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind((plain, 0))
        except OSError:
            return False
    return True
