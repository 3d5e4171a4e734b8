"""The kiln's controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from tilefab.devices.maps import KILN_MAP
from tilefab.devices.register_session import DEADLINE_S, RegisterSession
from tilefab.devices.registers import Value


@dataclass(frozen=True)
class KilnStatus:
    """What the kiln's controller shows at one moment.

    Attributes
    ----------
    boot_id
        Another at each start.
    heating, burner_fault, over_temp, at_set_point, blocked
        Its flags.
    tiles_inside
        Tiles in the kiln.
    cycle_time_min
        Expected minutes from entry to exit.
    temperatures_degc, set_points_degc
        Of the eight zones.
    ramp_limit_degc_min
        Fastest change of a zone.
    """

    boot_id: int
    heating: bool
    burner_fault: bool
    over_temp: bool
    at_set_point: bool
    blocked: bool
    tiles_inside: int
    cycle_time_min: float
    temperatures_degc: tuple[float, ...]
    set_points_degc: tuple[float, ...]
    ramp_limit_degc_min: float


@dataclass(frozen=True)
class KilnCommand:
    """What the kiln shall do from now on.

    Attributes
    ----------
    set_points_degc
        Of the eight zones, 20 .. 1250.
    ramp_limit_degc_min
        Fastest change of a zone, 0.1 .. 15.
    cycle_min
        Wanted minutes from entry to exit, 35 .. 75.
    """

    set_points_degc: tuple[float, ...]
    ramp_limit_degc_min: float
    cycle_min: float


class KilnSession(RegisterSession):
    """A session with the kiln's controller.

    Parameters
    ----------
    endpoint
        ``modbus-tcp://…`` or ``modbus-rtu://…``.
    deadline_s
        For each poll, connection or write, in seconds.
    name
        Of the device, for messages.
    """

    def __init__(self, endpoint: str, *, deadline_s: float = DEADLINE_S, name: str = "kiln") -> None:
        super().__init__(KILN_MAP, endpoint, deadline_s=deadline_s, name=name)

    async def poll(self) -> KilnStatus:
        """Read the state; raises as `PlcSession.poll` does."""
        values, _ = await self._poll_values()
        return _status(values)

    async def command(self, command: KilnCommand) -> KilnStatus:
        """Write a command, read it back and wait until it was acted on; raises as `PlcSession.command` does."""
        values, _ = await self._command(
            {
                "set_point": command.set_points_degc,
                "ramp_limit": command.ramp_limit_degc_min,
                "cycle_set": command.cycle_min,
            }
        )
        return _status(values)


def _status(values: Mapping[str, Value]) -> KilnStatus:
    number = cast(Mapping[str, int], values)
    return KilnStatus(
        boot_id=number["boot_id"],
        heating=bool(number["heating"]),
        burner_fault=bool(number["burner_fault"]),
        over_temp=bool(number["over_temp"]),
        at_set_point=bool(number["at_set_point"]),
        blocked=bool(number["blocked"]),
        tiles_inside=number["tiles_inside"],
        cycle_time_min=number["cycle_time"],
        temperatures_degc=cast(tuple[float, ...], values["temperature"]),
        set_points_degc=cast(tuple[float, ...], values["set_point"]),
        ramp_limit_degc_min=number["ramp_limit"],
    )
