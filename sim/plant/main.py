"""The command `tilefab-sim`: starts a simulated plant and runs it until it is told to stop."""

from __future__ import annotations

import argparse
import asyncio
import dataclasses
import json
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from sim.plant.config import PlantConfig, read_plant
from sim.plant.network.server import PlantServer


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; its exit code is 0, 2 for a wrong plant file or 1 for addresses that can't be had."""
    parser = argparse.ArgumentParser(prog="tilefab-sim", description="Run a simulated plant on real wires.")
    parser.add_argument("plant", type=Path, help="plant file, TOML")
    parser.add_argument("--endpoints", type=Path, help="where to write the addresses, JSON")
    parser.add_argument("--rate", type=float, help="plant seconds a wall second, 1 to 1000")
    parsed = parser.parse_args(arguments)
    try:
        config = read_plant(parsed.plant)
    except (OSError, ValueError) as error:
        _end(2, f"{parsed.plant}: {error}")
    if parsed.endpoints:
        config = dataclasses.replace(config, endpoints_file=str(parsed.endpoints))
    if parsed.rate:
        config = dataclasses.replace(config, clock=dataclasses.replace(config.clock, rate=parsed.rate))
    try:
        asyncio.run(_run(config))
    except OSError as error:
        _end(1, str(error))


async def _run(config: PlantConfig) -> None:
    server = PlantServer(config)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, server.stopped.set)
    await server.start()
    try:
        sys.stdout.write(json.dumps(server.endpoints) + "\n")
        sys.stdout.flush()
        await server.stopped.wait()
    finally:
        await server.close()


def _end(code: int, message: str) -> NoReturn:
    sys.stderr.write(f"error: {message}\n")
    raise SystemExit(code)
