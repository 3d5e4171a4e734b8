"""What pymodbus' own client does wrong, and that our sessions on its framers don't.

Each test first shows the trap on the plain client, so that it fails, and tells, once upstream has mended it.
"""

from __future__ import annotations

import asyncio

import pytest
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusIOException

from tests.unit.devices import peers
from tilefab.devices import Backoff, PlcCommand, PlcSession
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceTimeout

COMMAND = PlcCommand(True, True, 500.0, 600.0, 650.0)


def plain_serial(pair: peers.Pty, **options: object) -> AsyncModbusSerialClient:
    settings = {"baudrate": 115200, "parity": "N", "timeout": 0.05, "retries": 0, "reconnect_delay": 0} | options
    return AsyncModbusSerialClient(pair.path, **settings)


def rtu(pair: peers.Pty, **options: float) -> PlcSession:
    return PlcSession(f"modbus-rtu://{pair.path}?baud=115200", **options)


def late() -> peers.Script:
    """Keep the first answer back, and send it just before the second."""
    held: list[bytes] = []
    answers = iter(range(1000))

    def script(frame: bytes, send: peers.Send) -> None:
        which = next(answers)
        if which == 0:
            held.append(frame)
        elif which == 1:
            send(held.pop())
            asyncio.get_running_loop().call_later(0.005, send, frame)
        else:
            send(frame)

    return script


def test_a_late_answer_to_an_earlier_poll_is_taken_for_this_one():
    async def plain() -> None:
        unit = peers.plc(rtu=True, script=late())
        async with peers.serial_port(unit) as pair:
            client = plain_serial(pair)
            await client.connect()
            unit.words[7:9] = (0, 111)
            with pytest.raises(ModbusIOException):
                await client.readwrite_registers(read_count=64, address=0, values=[1], device_id=1)
            unit.words[7:9] = (0, 222)
            answer = await client.readwrite_registers(read_count=64, address=0, values=[2], device_id=1)
            assert not answer.isError()
            assert answer.registers[8] == 111, "the position before"
            client.close()

    async def ours() -> None:
        unit = peers.plc(rtu=True, script=late())
        async with peers.serial_port(unit) as pair:
            session = rtu(pair)
            await session.connect()
            unit.words[7:9] = (0, 111)
            with pytest.raises(DeviceTimeout):
                await session.poll()
            unit.words[7:9] = (0, 222)
            with pytest.raises(DeviceProtocolError, match="is to poll"):
                await session.poll()
            assert (await session.poll()).position_counts == 222
            await session.close()

    asyncio.run(plain())
    asyncio.run(ours())


def test_a_late_answer_to_a_read_is_taken_for_that_to_a_write():
    async def plain() -> None:
        async with peers.serial_port(peers.plc(rtu=True, script=late())) as pair:
            client = plain_serial(pair)
            await client.connect()
            with pytest.raises(ModbusIOException):
                await client.read_holding_registers(0, count=64, device_id=1)
            answer = await client.write_registers(32, [1, 2], device_id=1)
            assert not answer.isError()
            assert answer.function_code == 3, "an answer to a read"
            client.close()

    async def ours() -> None:
        unit = peers.plc(rtu=True)
        async with peers.serial_port(unit) as pair:
            session = rtu(pair)
            await session.connect()
            await session.poll()
            unit.script = late()
            with pytest.raises(DeviceTimeout):
                await session.poll()
            with pytest.raises(DeviceProtocolError, match="function 23 answered function 16"):
                await session.command(COMMAND)
            assert (await session.command(COMMAND)).cmd_ack == unit.words[32]
            await session.close()

    asyncio.run(plain())
    asyncio.run(ours())


def test_a_write_without_an_answer_is_sent_four_times():
    def writes(unit: peers.Unit) -> int:
        return sum(pdu[0] == 16 for pdu in unit.requests)

    async def plain() -> None:
        unit = peers.plc(script=peers.mute)
        async with peers.tcp_port(unit) as port:
            client = AsyncModbusTcpClient("127.0.0.1", port=port.port, timeout=0.02)
            await client.connect()
            with pytest.raises(ModbusIOException):
                await client.write_registers(32, [1, 2], device_id=1)
            assert writes(unit) == 4
            client.close()

    async def ours() -> None:
        unit = peers.plc()
        async with peers.tcp_unit(unit) as endpoint:
            session = PlcSession(endpoint)
            await session.connect()
            await session.poll()
            unit.script = peers.mute
            with pytest.raises(DeviceTimeout):
                await session.command(COMMAND)
            assert writes(unit) == 1
            await session.close()

    asyncio.run(plain())
    asyncio.run(ours())


def test_a_call_goes_on_for_long_after_its_peer_died():
    def unit_that_dies() -> tuple[peers.Unit, list[peers.TcpPort]]:
        ports: list[peers.TcpPort] = []

        def die(frame: bytes, send: peers.Send) -> None:
            for transport in ports[0].transports:
                transport.abort()

        return peers.plc(script=die), ports

    async def plain() -> None:
        unit, ports = unit_that_dies()
        async with peers.tcp_port(unit) as port:
            ports.append(port)
            client = AsyncModbusTcpClient("127.0.0.1", port=port.port, reconnect_delay=0)
            await client.connect()
            call = asyncio.ensure_future(client.read_holding_registers(0, count=1, device_id=1))
            done, _ = await asyncio.wait([call], timeout=1)
            assert not done, "it would go on for 12 s"
            call.cancel()
            await asyncio.wait([call])
            client.close()

    async def ours() -> None:
        unit, ports = unit_that_dies()
        async with peers.tcp_port(unit) as port:
            ports.append(port)
            session = PlcSession(f"modbus-tcp://127.0.0.1:{port.port}")
            await session.connect()
            async with asyncio.timeout(1):
                with pytest.raises(DeviceTimeout):
                    await session.poll()
            assert not session.connected
            await session.close()

    asyncio.run(plain())
    asyncio.run(ours())


def test_pauses_before_a_new_connection_grow_without_end():
    async def plain() -> float:
        async with peers.tcp_port(peers.plc()) as port:
            client = AsyncModbusTcpClient("127.0.0.1", port=port.port, reconnect_delay=0.001)
            assert client.comm_params.reconnect_delay_max == 300
            await client.connect()
            await port.stop()
            async with asyncio.timeout(10):
                while client.ctx.reconnect_delay_current <= 0.5:
                    await asyncio.sleep(0.01)
            client.close()
            await port.start()
            return client.ctx.reconnect_delay_current

    asyncio.run(plain())
    backoff = Backoff()
    assert max(backoff.next_s() for _ in range(1000)) == 0.5


def test_transaction_0_is_taken_for_any():
    def as_0(frame: bytes, send: peers.Send) -> None:
        send(b"\0\0" + frame[2:])

    async def plain() -> None:
        async with peers.tcp_port(peers.plc(script=as_0)) as port:
            client = AsyncModbusTcpClient("127.0.0.1", port=port.port, timeout=0.2, retries=0)
            await client.connect()
            answer = await client.read_holding_registers(3, count=2, device_id=1)
            assert answer.registers == [0x0102, 0x0304]
            client.close()

    async def ours() -> None:
        async with peers.tcp_unit(peers.plc(script=as_0)) as endpoint:
            session = PlcSession(endpoint)
            await session.connect()
            with pytest.raises(DeviceProtocolError, match="is to request 0"):
                await session.poll()
            assert not session.connected
            await session.close()

    asyncio.run(plain())
    asyncio.run(ours())


@pytest.mark.parametrize("noise", [b"\x01\x17\x04", b"\x01\x83", b"\x01\x10\x00\x00\xff"], ids=bytes.hex)
def test_noise_before_an_answer_loses_it(noise):
    def noisy(frame: bytes, send: peers.Send) -> None:
        send(noise + frame)

    async def plain() -> None:
        async with peers.serial_port(peers.plc(rtu=True, script=noisy)) as pair:
            client = plain_serial(pair)
            await client.connect()
            with pytest.raises(ModbusIOException):
                await client.readwrite_registers(read_count=64, address=0, values=[1], device_id=1)
            client.close()

    async def ours() -> None:
        unit = peers.plc(rtu=True, script=noisy)
        unit.words[7:9] = (0, 222)
        async with peers.serial_port(unit) as pair:
            session = rtu(pair)
            await session.connect()
            assert (await session.poll()).position_counts == 222
            await session.close()

    asyncio.run(plain())
    asyncio.run(ours())


def test_every_error_of_a_session_is_a_device_error():
    assert issubclass(DeviceTimeout, DeviceError)
    assert issubclass(DeviceProtocolError, DeviceError)
