"""Endpoints as they stand in line files."""

from __future__ import annotations

import pytest

from tilefab.devices import GaugeSession, KilnSession, PlcSession, PrinterDataLink, PrinterSession, parse_endpoint
from tilefab.devices.endpoints import ModbusRtuEndpoint, ModbusTcpEndpoint, SerialEndpoint, TcpEndpoint
from tilefab.errors import DeviceError


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("modbus-tcp://127.0.0.1:1502?unit=2", ModbusTcpEndpoint("127.0.0.1", 1502, 2)),
        ("modbus-tcp://plc.local:502", ModbusTcpEndpoint("plc.local", 502, 1)),
        ("modbus-tcp://[::1]:502?unit=1&fc23=no", ModbusTcpEndpoint("::1", 502, 1, fc23=False)),
        ("modbus-rtu:///tmp/x?baud=38400&unit=7", ModbusRtuEndpoint("/tmp/x", 38400, 7)),
        ("modbus-rtu:///dev/ttyUSB0?fc23=no", ModbusRtuEndpoint("/dev/ttyUSB0", 19200, 1, fc23=False)),
        ("serial:///tmp/a%20b?baud=921600", SerialEndpoint("/tmp/a b", 921600)),
        ("tcp://127.0.0.1:9", TcpEndpoint("127.0.0.1", 9)),
    ],
)
def test_an_endpoint_is_read(text, wanted):
    assert parse_endpoint(text) == wanted


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is no endpoint"),
        ("http://127.0.0.1:80", "is no endpoint"),
        ("tcp://127.0.0.1", "host and a port"),
        ("tcp://:5", "host and a port"),
        ("tcp://127.0.0.1:0", "host and a port"),
        ("tcp://127.0.0.1:70000", "out of range"),
        ("tcp://127.0.0.1:5/path", "has a path"),
        ("tcp://me@127.0.0.1:5", "more than a place"),
        ("tcp://127.0.0.1:5?unit=1", "no option 'unit'"),
        ("modbus-tcp://127.0.0.1:5?unit=0", "unit must be"),
        ("modbus-tcp://127.0.0.1:5?unit=248", "unit must be"),
        ("modbus-tcp://127.0.0.1:5?unit=1.5", "unit must be"),
        ("modbus-tcp://127.0.0.1:5?fc23=maybe", "yes or no"),
        ("modbus-tcp://127.0.0.1:5?baud=9600", "no option 'baud'"),
        ("serial://tmp/x", "absolute path"),
        ("serial:///", "absolute path"),
        ("serial:///tmp/x?baud=-1", "baud must be"),
        ("serial:///tmp/x?baud=²", "baud must be"),
        ("serial:///tmp/x?fc23=no", "no option 'fc23'"),
    ],
)
def test_what_is_none_is_refused_with_a_reason(text, reason):
    with pytest.raises(DeviceError, match=reason) as caught:
        parse_endpoint(text, device="plc")
    assert caught.value.device == "plc"
    assert caught.value.exit_code == 10


@pytest.mark.parametrize(
    "make",
    [
        lambda: PlcSession("tcp://127.0.0.1:5"),
        lambda: KilnSession("serial:///tmp/x"),
        lambda: PrinterSession("tcp://127.0.0.1:5", 1),
        lambda: GaugeSession("tcp://127.0.0.1:5"),
        lambda: PrinterDataLink("serial:///tmp/x", 1),
    ],
)
def test_a_session_takes_only_endpoints_of_its_kind(make):
    with pytest.raises(DeviceError, match="endpoint"):
        make()
