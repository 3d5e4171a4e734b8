"""All of the plant's connections: opened together, their addresses written down, closed together."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sim.plant.config import PlantConfig
from sim.plant.network.data_link import DataLink
from sim.plant.network.line_ports import LinePort, gauge_port, printer_port
from sim.plant.network.modbus_ports import ModbusRtu, ModbusTcp
from sim.plant.network.service import CommandError, Service
from sim.plant.wire.window import Window

_TICK_S = 0.01
_MOST_LINE = 1 << 16


class PlantServer:
    """The plant on its wires, inside a running event loop.

    Parameters
    ----------
    config
        What the plant is like, and where it listens.
    """

    def __init__(self, config: PlantConfig) -> None:
        self.config = config
        self.service = Service(config)
        self.endpoints: dict[str, str] = {}
        self.stopped = asyncio.Event()
        self._servers: list[asyncio.Server] = []
        self._serial: list[ModbusRtu | LinePort] = []
        self._data: DataLink | None = None
        self._hosts: set[asyncio.StreamWriter] = set()
        self._ticking: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Open everything, and write the addresses to the endpoints file.

        Raises
        ------
        OSError
            If something can't be opened; what was opened is closed again.
        """
        try:
            await self._open()
        except BaseException:
            await self.close()
            raise
        if self.config.endpoints_file:
            path = Path(self.config.endpoints_file)
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f".{path.name}.{os.getpid()}")
            part.write_text(json.dumps(self.endpoints) + "\n", encoding="utf-8")
            part.replace(path)

    async def _open(self) -> None:
        config, service, loop = self.config, self.service, asyncio.get_running_loop()
        service.on_stop = _in(loop, self.stopped.set)
        if config.plc.tcp:
            self.endpoints["plc_tcp"] = await self._open_modbus("plc", service.plc, config.plc.tcp)
        if config.plc.rtu:
            path, baud = _pty(config.plc.rtu), config.plc.baud
            self._add_serial("plc", ModbusRtu(service, service.plc, path, baud))
            self.endpoints["plc_rtu"] = f"modbus-rtu://{path}?baud={baud}&unit=1"
        if config.kiln.tcp:
            self.endpoints["kiln"] = await self._open_modbus("kiln", service.kiln, config.kiln.tcp)
        if config.printer.control:
            path, baud = _pty(config.printer.control), config.printer.baud
            self._add_serial("printer", printer_port(service, path, baud))
            self.endpoints["printer_control"] = f"serial://{path}?baud={baud}"
        if config.printer.data:
            host, port = _address(config.printer.data)
            self._data = DataLink(service, host, port)
            self.endpoints["printer_data"] = f"tcp://{host}:{self._data.port}"
        if config.gauge.pty:
            path, baud = _pty(config.gauge.pty), config.gauge.baud
            self._add_serial("gauge", gauge_port(service, path, baud))
            self.endpoints["gauge"] = f"serial://{path}?baud={baud}"
        if config.control.tcp:
            host, port = _address(config.control.tcp)
            server = await asyncio.start_server(self._control, host, port, limit=_MOST_LINE)
            self._servers.append(server)
            self.endpoints["control"] = f"tcp://{host}:{server.sockets[0].getsockname()[1]}"
        self._ticking = asyncio.create_task(self._tick())

    async def _open_modbus(self, device: str, window: Window, address: str) -> str:
        host, port = _address(address)
        loop = asyncio.get_running_loop()
        peers: set[ModbusTcp] = set()

        def drop() -> None:
            for peer in [*peers]:
                peer.drop()

        self.service.on_drop(device, _in(loop, drop))
        server = await loop.create_server(lambda: ModbusTcp(self.service, device, window, peers), host, port)
        self._servers.append(server)
        return f"modbus-tcp://{host}:{server.sockets[0].getsockname()[1]}?unit={window.unit}"

    def _add_serial(self, device: str, port: ModbusRtu | LinePort) -> None:
        loop = asyncio.get_running_loop()
        self._serial.append(port)
        self.service.on_drop(device, _in(loop, port.reset))

    async def _tick(self) -> None:
        """Let things happen that nobody asks after."""
        while True:
            with self.service.now():
                pass
            await asyncio.sleep(_TICK_S)

    async def _control(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._hosts.add(writer)
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self.do(line)).encode() + b"\n")
                await writer.drain()
        except (ConnectionError, ValueError):
            pass
        finally:
            self._hosts.discard(writer)
            writer.close()

    def do(self, line: bytes) -> dict[str, Any]:
        """Carry out a line of the control port; what is wrong with it is said in the answer."""
        try:
            command = json.loads(line)
            if not isinstance(command, Mapping):
                raise CommandError("a command is a JSON object")
            return self.service.do(command)
        except (ValueError, CommandError) as error:
            return {"ok": False, "error": str(error)}

    async def close(self) -> None:
        """Close everything; closing again does nothing."""
        if self._ticking is not None:
            self._ticking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._ticking
        for server in self._servers:
            server.close()
        for device in ("plc", "kiln"):
            self.service.drop(device)
        for writer in [*self._hosts]:
            writer.close()
        for port in self._serial:
            port.close()
        if self._data is not None:
            self._data.close()
        for server in self._servers:
            await server.wait_closed()
        # Connections that were ended say so in the loop's next turns.
        for _ in range(3):
            await asyncio.sleep(0)
        self._servers, self._serial, self._data, self._ticking = [], [], None, None
        self.service.close()


def _in(loop: asyncio.AbstractEventLoop, call: Callable[[], None]) -> Callable[[], None]:
    """Make of a call one that any thread may make."""

    def from_anywhere() -> None:
        loop.call_soon_threadsafe(call)

    return from_anywhere


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host or "127.0.0.1", int(port)


def _pty(text: str) -> Path:
    path = Path(text.removeprefix("pty:"))
    return path.parent.resolve() / path.name
