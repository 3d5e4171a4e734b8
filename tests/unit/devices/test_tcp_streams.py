"""TCP connections: deadlines of connecting, peers that close, and connections that lead back to themselves."""

from __future__ import annotations

import asyncio
import contextlib
import socket

import pytest

from tests.unit.devices import peers
from tilefab.devices import PlcSession, PrinterDataLink
from tilefab.devices.endpoints import TcpEndpoint
from tilefab.devices.streams import TcpStream
from tilefab.errors import DeviceTimeout


def test_connecting_ends_at_its_deadline():
    """A listener whose queue is full doesn't answer, as a host that is switched off doesn't."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        address = listener.getsockname()
        for _ in range(3):
            one = stack.enter_context(socket.socket())
            one.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                one.connect(address)

        async def run() -> None:
            session = PlcSession(f"modbus-tcp://127.0.0.1:{address[1]}", deadline_s=0.05)
            async with asyncio.timeout(5):
                with pytest.raises(DeviceTimeout, match="in time"):
                    await session.connect()
            assert not session.connected

        asyncio.run(run())
        link = PrinterDataLink(f"tcp://127.0.0.1:{address[1]}", 1)
        with pytest.raises(DeviceTimeout, match="no answer"):
            link.open(0.05)


def test_what_a_former_connection_still_tells_doesnt_reach_the_next():
    async def run() -> None:
        async with peers.tcp_port(peers.plc()) as port:
            stream = TcpStream(TcpEndpoint("127.0.0.1", port.port), "plc")
            loop = asyncio.get_running_loop()
            for _ in range(5):
                await stream.open(loop.time() + 1)
                assert stream.is_open
            # The ends of the former ones have been told by now.
            await asyncio.sleep(0.01)
            assert stream.is_open
            stream.close()
            assert not stream.is_open

    asyncio.run(run())


@pytest.mark.parametrize("way", ["close", "abort", "half"])
def test_a_peer_that_leaves_ends_the_wait(way):
    async def run() -> None:
        async with peers.tcp_port(peers.plc()) as port:
            stream = TcpStream(TcpEndpoint("127.0.0.1", port.port), "plc")
            loop = asyncio.get_running_loop()
            await stream.open(loop.time() + 1)
            async with asyncio.timeout(5):
                while not port.transports:
                    await asyncio.sleep(0.001)
            peer = port.transports[0]
            {"close": peer.close, "abort": peer.abort, "half": peer.write_eof}[way]()
            with pytest.raises(DeviceTimeout, match=r"closed the connection|was lost"):
                async with asyncio.timeout(5):
                    await stream.read(loop.time() + 60)
            with pytest.raises(DeviceTimeout):
                stream.write(b"x")
            stream.close()

    asyncio.run(run())


def free_address() -> tuple[str, int]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return "127.0.0.1", free.getsockname()[1]


def test_a_connection_that_leads_back_to_itself_is_none(monkeypatch):
    here = free_address()

    async def run() -> None:
        loop = asyncio.get_running_loop()
        create = loop.create_connection
        monkeypatch.setattr(
            loop, "create_connection", lambda make, host, port: create(make, host, port, local_addr=here)
        )
        stream = TcpStream(TcpEndpoint(*here), "plc")
        with pytest.raises(DeviceTimeout, match="nobody listens"):
            await stream.open(loop.time() + 1)
        assert not stream.is_open

    asyncio.run(run())
    connect, there = socket.create_connection, free_address()
    monkeypatch.setattr(socket, "create_connection", lambda to, timeout: connect(to, timeout, source_address=there))
    link = PrinterDataLink(f"tcp://127.0.0.1:{there[1]}", 1)
    with pytest.raises(DeviceTimeout, match="nobody listens"):
        link.open(1.0)
