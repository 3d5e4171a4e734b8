"""Nonsense on every wire: no device of the plant falls over, and none acts on it."""

from __future__ import annotations

import contextlib
import random

import pytest

from tests.unit.sim.plant.hosts import (
    ControlHost,
    DataHost,
    ModbusHost,
    PrinterHost,
    RtuHost,
    SerialHost,
    TcpHost,
    wait_until,
)

pytestmark = pytest.mark.xdist_group("line")


def test_nonsense_is_survived(running):
    chance = random.Random(5)
    ends = running.endpoints
    for round_ in range(40):
        for name in ("plc_tcp", "kiln", "printer_data", "control"):
            with contextlib.suppress(ConnectionError, BrokenPipeError), TcpHost(ends[name]) as host:
                host.socket.sendall(chance.randbytes(chance.randrange(1, 60)))
        for name in ("plc_rtu", "printer_control", "gauge"):
            with SerialHost(ends[name]) as line:
                line.send(chance.randbytes(chance.randrange(1, 40)))
        if round_ % 10 == 0:
            with contextlib.suppress(ConnectionError), DataHost(ends["printer_data"]) as data:
                data.socket.sendall(b"STRP" + chance.randbytes(40))
    state = running.state()
    assert state["plc"]["cmd_ack"] == 0
    assert state["printer"]["last_accepted_arm"] == 0
    with ModbusHost(ends["plc_tcp"]) as plc, ModbusHost(ends["kiln"]) as kiln, ControlHost(ends["control"]) as control:
        assert plc.poll()[3:5] == [0x0102, 0x0304]
        assert kiln.poll()[8] == 8
        assert control.do("state")["ok"]
    with RtuHost(ends["plc_rtu"]) as rtu, PrinterHost(ends["printer_control"]) as printer:

        def answered() -> bool:
            rtu.send_body(bytes.fromhex("0300030002"))
            return bytes.fromhex("030401020304") in rtu.read_some(0.2)

        # A request that follows nonsense without a pause is part of it.
        wait_until(answered)
        printer.send(b"\0")
        printer.open()
        with DataHost(ends["printer_data"]) as data:
            assert data.stat()[3] == 0
