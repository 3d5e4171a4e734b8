"""The simulated plant inside a test's own process, its connections served by a thread and an event loop of its own."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

from sim.plant.config import PlantConfig, parse_plant
from sim.plant.network.server import PlantServer
from sim.plant.network.service import Service
from sim.plant.physics.plant import Plant

_START_S = 10.0


class RunningPlant:
    """A plant that runs: its addresses, its faults, its truth. Every method may be called from any thread.

    Attributes
    ----------
    endpoints
        Addresses by name, as `tilefab-sim` prints them.
    service
        The plant behind its wires.
    """

    def __init__(self, endpoints: Mapping[str, str], service: Service) -> None:
        self.endpoints = dict(endpoints)
        self.service = service

    def do(self, name: str, **arguments: Any) -> dict[str, Any]:
        """Carry out a command of the control port; `CommandError` if it can't be."""
        return self.service.do({"do": name, **arguments})

    def fault(self, device: str, kind: str, **arguments: Any) -> None:
        """Set a fault, as the control port does."""
        self.do("fault", device=device, kind=kind, **arguments)

    def clear(self) -> None:
        """Take the faults of messages away."""
        self.do("clear")

    def set_rate(self, rate: float) -> None:
        """Let the plant's clock run at another rate."""
        self.do("rate", rate=rate)

    def power_cut(self, seconds: float = 1.0) -> None:
        """Take all power away for some wall seconds."""
        self.do("power_cut", seconds=seconds)

    def state(self) -> dict[str, Any]:
        """How the plant is now."""
        return self.do("state")

    def truth(self, since: int = 0, limit: int | None = None) -> dict[str, Any]:
        """Tiles that changed after change `since`, and counts of everything."""
        return self.do("truth", since=since, limit=limit)

    def summary(self) -> dict[str, Any]:
        """Counts of everything."""
        counts: dict[str, Any] = self.do("truth", summary=True)["summary"]
        return counts

    @contextmanager
    def physics(self) -> Iterator[Plant]:
        """The plant itself, brought up to now; nothing else moves while it is held."""
        with self.service.now() as plant:
            yield plant


def plant_in(folder: Path, **tables: Any) -> PlantConfig:
    """A plant all of whose connections are offered, its serial lines in a folder.

    Parameters
    ----------
    folder
        Where the names of the serial lines are put.
    tables
        Tables and values of the plant file that are to differ.
    """
    content: dict[str, Any] = {
        "printer": {"control": f"pty:{folder / 'printer'}"},
        "plc": {"rtu": f"pty:{folder / 'plc'}"},
        "gauge": {"pty": f"pty:{folder / 'gauge'}"},
    }
    for name, value in tables.items():
        content[name] = content.get(name, {}) | value if isinstance(value, Mapping) else value
    return parse_plant(content)


@contextmanager
def running_plant_here(config: PlantConfig) -> Iterator[RunningPlant]:
    """Run a plant for as long as the block lasts.

    Raises
    ------
    OSError
        If a connection can't be opened.
    RuntimeError
        At the end, if something in the plant's event loop or its camera failed on the way.
    """
    ready = threading.Event()
    outcome: dict[str, Any] = {}
    defects: list[str] = []

    async def serve() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: defects.append(str(context)))
        server = PlantServer(config)
        try:
            await server.start()
        except OSError as error:
            outcome["error"] = error
            return
        finally:
            outcome["server"], outcome["loop"] = server, asyncio.get_running_loop()
            ready.set()
        await server.stopped.wait()
        try:
            await server.close()
        except RuntimeError as error:
            defects.append(str(error))

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="sim-plant", daemon=True)
    thread.start()
    if not ready.wait(_START_S):
        raise TimeoutError("the plant doesn't start")
    try:
        if "error" in outcome:
            raise outcome["error"]
        server: PlantServer = outcome["server"]
        yield RunningPlant(server.endpoints, server.service)
    finally:
        with contextlib.suppress(RuntimeError):
            outcome["loop"].call_soon_threadsafe(outcome["server"].stopped.set)
        thread.join(_START_S)
    if defects:
        raise RuntimeError(f"defects of the simulated plant: {defects}")


@asynccontextmanager
async def running_plant(config: PlantConfig) -> AsyncIterator[RunningPlant]:
    """Run a plant for as long as the block lasts, without sharing the caller's event loop.

    Raises
    ------
    OSError
        If a connection can't be opened.
    """
    plant = running_plant_here(config)
    running = await asyncio.to_thread(plant.__enter__)
    try:
        yield running
    finally:
        await asyncio.to_thread(plant.__exit__, None, None, None)
