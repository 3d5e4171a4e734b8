"""Where a device is reached: short URLs, as they stand in a line file."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, unquote, urlsplit

from tilefab.errors import DeviceError

_MOST_BAUD = 12_000_000
_FORMS = {
    "modbus-tcp": "modbus-tcp://HOST:PORT?unit=N",
    "modbus-rtu": "modbus-rtu:///PATH?baud=N&unit=N",
    "serial": "serial:///PATH?baud=N",
    "tcp": "tcp://HOST:PORT",
}


@dataclass(frozen=True)
class ModbusTcpEndpoint:
    """A Modbus unit behind a TCP port; ``fc23`` tells whether it knows function 23."""

    host: str
    port: int
    unit: int
    fc23: bool = True


@dataclass(frozen=True)
class ModbusRtuEndpoint:
    """A Modbus unit on a serial line; ``fc23`` tells whether it knows function 23."""

    path: str
    baud: int
    unit: int
    fc23: bool = True


@dataclass(frozen=True)
class SerialEndpoint:
    """A device of its own on a serial line."""

    path: str
    baud: int


@dataclass(frozen=True)
class TcpEndpoint:
    """A TCP port."""

    host: str
    port: int


Endpoint = ModbusTcpEndpoint | ModbusRtuEndpoint | SerialEndpoint | TcpEndpoint


def parse_endpoint(text: str, *, device: str = "") -> Endpoint:
    """Read an endpoint.

    Parameters
    ----------
    text
        One of ``modbus-tcp://HOST:PORT?unit=N``, ``modbus-rtu:///PATH?baud=N&unit=N``, ``serial:///PATH?baud=N`` and
        ``tcp://HOST:PORT``; ``&fc23=no`` may follow a Modbus unit. ``unit`` is 1 and ``baud`` 19200 if not given.
    device
        Name of the device, for messages.

    Raises
    ------
    DeviceError
        If it is none of these.
    """
    try:
        return _parsed(text)
    except ValueError as error:
        forms = ", ".join(_FORMS.values())
        raise DeviceError(f"{device or 'endpoint'}: {text!r}: {error}: give one of {forms}", device=device) from None


def _parsed(text: str) -> Endpoint:
    url = urlsplit(text)
    if url.scheme not in _FORMS:
        raise ValueError("is no endpoint of a device")
    options = dict(parse_qsl(url.query, keep_blank_values=True, strict_parsing=bool(url.query)))
    if url.fragment or url.username is not None:
        raise ValueError("names more than a place and options")
    modbus = url.scheme.startswith("modbus-")
    serial = url.scheme in ("modbus-rtu", "serial")
    unit = _whole(options.pop("unit", "1"), "unit", 1, 247) if modbus else 0
    fc23 = _yes(options.pop("fc23", "yes")) if modbus else True
    baud = _whole(options.pop("baud", "19200"), "baud", 50, _MOST_BAUD) if serial else 0
    if options:
        raise ValueError(f"has no option {sorted(options)[0]!r}")
    if serial:
        path = unquote(url.path)
        if url.netloc or len(path) < 2:
            raise ValueError("needs the absolute path of a serial port after three slashes")
        return ModbusRtuEndpoint(path, baud, unit, fc23) if modbus else SerialEndpoint(path, baud)
    if url.path not in ("", "/"):
        raise ValueError("has a path, which a TCP port hasn't")
    host, port = url.hostname, url.port
    if not host or not port:
        raise ValueError("needs a host and a port from 1 to 65535")
    return ModbusTcpEndpoint(host, port, unit, fc23) if modbus else TcpEndpoint(host, port)


def _whole(text: str, name: str, low: int, high: int) -> int:
    if not (text.isascii() and text.isdigit() and low <= int(text[:12]) <= high):
        raise ValueError(f"{name} must be a whole number from {low} to {high}")
    return int(text)


def _yes(text: str) -> bool:
    if text not in ("yes", "no"):
        raise ValueError("fc23 must be yes or no")
    return text == "yes"
