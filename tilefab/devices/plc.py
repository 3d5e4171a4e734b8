"""The conveyor's controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from tilefab.devices.maps import PLC_MAP
from tilefab.devices.register_session import DEADLINE_S, RegisterSession
from tilefab.devices.registers import Value


@dataclass(frozen=True)
class PlcStatus:
    """What the conveyor's controller shows at one moment.

    Attributes
    ----------
    boot_id
        Another at each start.
    scan_counter
        Advances while its program runs.
    belt_running, e_stop, jam, deadman_tripped, double_feed, feed_enabled, ready, diverter_fault, kiln_full
        Its flags.
    belt_speed_mm_s
        Now.
    position_counts
        Of the belt since the start, 0 .. 2**32 - 1, wraps.
    tile_seq, tile_position_counts
        Last tile seen at the eye, 1 being the first, and the position at its leading edge.
    decided_seq, passed_bits
        Last tile decided at the diverter; bit i tells whether tile ``decided_seq - i`` passed.
    cmd_ack
        Number of the last command acted on.
    fault_counter
        Faults latched since the start.
    tiles_fed
        By the loader since the start.
    """

    boot_id: int
    scan_counter: int
    belt_running: bool
    e_stop: bool
    jam: bool
    deadman_tripped: bool
    double_feed: bool
    feed_enabled: bool
    ready: bool
    diverter_fault: bool
    kiln_full: bool
    belt_speed_mm_s: float
    position_counts: int
    tile_seq: int
    tile_position_counts: int
    decided_seq: int
    passed_bits: int
    cmd_ack: int
    fault_counter: int
    tiles_fed: int


@dataclass(frozen=True)
class PlcCommand:
    """What the conveyor shall do from now on; repeating it changes nothing.

    Attributes
    ----------
    run_belt, feed
        Whether the belt runs, and whether the loader feeds it.
    speed_mm_s
        Of the belt, 0 .. 3000.
    tile_length_mm
        Along the travel, 50 .. 3000.
    tile_pitch_mm
        From one leading edge to the next, 60 .. 4000.
    release_base, release_bits
        Bit i: tile ``release_base + i`` may pass; 32 bits. Releases add up.
    ack_fault
        The fault counter that the operator acknowledges, 0 .. 65535.
    """

    run_belt: bool
    feed: bool
    speed_mm_s: float
    tile_length_mm: float
    tile_pitch_mm: float
    release_base: int = 0
    release_bits: int = 0
    ack_fault: int = 0


class PlcSession(RegisterSession):
    """A session with the conveyor's controller.

    Parameters
    ----------
    endpoint
        ``modbus-tcp://…`` or ``modbus-rtu://…``.
    deadline_s
        For each poll, connection or write, in seconds.
    name
        Of the device, for messages.
    """

    def __init__(self, endpoint: str, *, deadline_s: float = DEADLINE_S, name: str = "plc") -> None:
        super().__init__(PLC_MAP, endpoint, deadline_s=deadline_s, name=name)

    async def poll(self) -> PlcStatus:
        """Read the state; this is also the host's heartbeat.

        Raises
        ------
        DeviceTimeout
            If it didn't answer within the deadline.
        DeviceProtocolError
            If what it answered can't be the answer, or its program has stopped.
        DeviceRefused
            If it answered with an exception.
        """
        values, _ = await self._poll_values()
        return _status(values)

    async def command(self, command: PlcCommand) -> PlcStatus:
        """Write a command, read it back and wait until it was acted on: at most two deadlines.

        A command that failed may have been acted on, or may still be. Give it again: it gets a newer number.

        Raises
        ------
        DeviceRefused
            If a value is outside its limits, or the controller answered with an exception.
        DeviceTimeout
            If it didn't answer, or didn't act on it in time.
        DeviceProtocolError
            If what it answered can't be the answer, or reads back as something else.
        """
        values, _ = await self._command(
            {
                "run": command.run_belt | command.feed << 1,
                "speed_set": command.speed_mm_s,
                "tile_length_set": command.tile_length_mm,
                "tile_pitch_set": command.tile_pitch_mm,
                "release_base": command.release_base,
                "release_bits": command.release_bits,
                "ack_fault": command.ack_fault,
            }
        )
        return _status(values)


def _status(values: Mapping[str, Value]) -> PlcStatus:
    number = cast(Mapping[str, int], values)
    return PlcStatus(
        boot_id=number["boot_id"],
        scan_counter=number["scan_counter"],
        belt_running=bool(number["belt_running"]),
        e_stop=bool(number["e_stop"]),
        jam=bool(number["jam"]),
        deadman_tripped=bool(number["deadman_tripped"]),
        double_feed=bool(number["double_feed"]),
        feed_enabled=bool(number["feed_enabled"]),
        ready=bool(number["ready"]),
        diverter_fault=bool(number["diverter_fault"]),
        kiln_full=bool(number["kiln_full"]),
        belt_speed_mm_s=number["belt_speed"],
        position_counts=number["position"],
        tile_seq=number["tile_seq"],
        tile_position_counts=number["tile_position"],
        decided_seq=number["decided_seq"],
        passed_bits=number["passed_bits"],
        cmd_ack=number["cmd_ack"],
        fault_counter=number["fault_counter"],
        tiles_fed=number["tiles_fed"],
    )
