"""The printer's control session over its serial line."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from enum import IntEnum
from itertools import pairwise
from typing import Final, TypeVar

from tilefab.devices import printer_messages as messages
from tilefab.devices.endpoints import SerialEndpoint, parse_endpoint
from tilefab.devices.frames import MOST_BODY, Frame, FrameReader, encode_frame
from tilefab.devices.layouts import Message
from tilefab.devices.printer_messages import ArmStatus, ClearStatus, DisarmStatus, OutcomeState
from tilefab.devices.printer_values import (
    ArmCommand,
    ArmReply,
    Detection,
    Outcome,
    PrinterIdentity,
    PrinterStatus,
)
from tilefab.devices.sequences import memory_of
from tilefab.devices.streams import SerialStream
from tilefab.devices.turns import Turns
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout

_DEADLINE_S: Final = 0.2
_BITS_PER_CHAR: Final = 10
_STALE_SESSION: Final = 3
_PERMILLE: Final = 1000

E = TypeVar("E", bound=IntEnum)


class PrinterSession:
    """A session with the printer, fenced by its number: the printer refuses every lower one.

    A request that isn't answered by half its deadline is sent once more, the same to the last bit: the printer answers
    a duplicate of its last request with the same reply and doesn't act twice. A request that failed may have been
    acted on; ARM can be given again, as it is accepted once for each arm_id. Late replies don't fit a later request.

    Parameters
    ----------
    endpoint
        ``serial:///PATH?baud=N``.
    session
        Above that of every session before, 1 .. 2**32 - 1.
    deadline_s
        For each request, in seconds.
    name
        Of the device, for messages.

    Raises
    ------
    DeviceError
        If the endpoint is no serial line.
    """

    def __init__(self, endpoint: str, session: int, *, deadline_s: float = _DEADLINE_S, name: str = "printer") -> None:
        parsed = parse_endpoint(endpoint, device=name)
        if not isinstance(parsed, SerialEndpoint):
            raise DeviceError(f"{name}: {endpoint!r} must be a serial endpoint", device=name)
        self._stream = SerialStream(parsed, name)
        self._session, self._deadline_s, self.name = session, deadline_s, name
        self._char_s = _BITS_PER_CHAR / parsed.baud
        self._memory = memory_of(endpoint)
        self._reader = FrameReader()
        self._turns = Turns(deadline_s, name)
        self._inks = messages.INKS

    @property
    def connected(self) -> bool:
        """Whether the port is open."""
        return self._stream.is_open

    async def connect(self) -> None:
        """Open the port.

        Raises
        ------
        DeviceTimeout
            If there is no such port.
        DeviceRefused
            If another program uses it.
        """
        async with self._turns.mine() as deadline:
            await self._stream.open(deadline)
            self._reader.clear()

    async def close(self) -> None:
        """Give the port up."""
        self._stream.close()
        await asyncio.sleep(0)

    async def hello(self) -> PrinterIdentity:
        """Open the session; every lower one ends with this.

        Raises
        ------
        DeviceRefused
            If there is a newer session. This and all other calls also raise `DeviceTimeout` if the printer doesn't
            answer, and `DeviceProtocolError` if its answer makes no sense.
        """
        values, _ = await self._ask(messages.HELLO, {"version": messages.VERSION})
        if values["version"] != messages.VERSION:
            raise self._wrong(f"it speaks version {values['version']} of the protocol, not {messages.VERSION}")
        if not (1 <= values["inks"] <= messages.INKS and values["counts_per_mm_x1000"]):
            raise self._wrong("it tells of inks or an encoder that no printer has")
        counts_per_mm = values.pop("counts_per_mm_x1000") / 1000
        self._inks = values["inks"]
        return PrinterIdentity(counts_per_mm=counts_per_mm, **values)

    async def status(self) -> PrinterStatus:
        """Read the state; this is also the host's heartbeat."""
        values, _ = await self._ask(messages.STATUS)
        flags, inks = values["flags"], [values[f"ink_permille{i}"] for i in range(messages.INKS)]
        if flags >> len(messages.FLAGS) or max(inks) > _PERMILLE:
            raise self._wrong("its status holds what no printer shows")
        bits = {name: bool(flags >> bit & 1) for bit, name in enumerate(messages.FLAGS)}
        plain = ("boot_id", "detect_seq", "last_accepted_arm", "last_outcome_arm", "queued", "buffer_free")
        return PrinterStatus(
            encoder_counts=values["encoder"],
            ink_frac=tuple(ink / _PERMILLE for ink in inks[: self._inks]),
            fault_counter=values["fault_counter"],
            **{name: values[name] for name in plain},  # type: ignore[arg-type]
            **bits,
        )

    async def detections(self, from_seq: int) -> tuple[Detection, ...]:
        """Read tiles seen at the eye, from this number on or the oldest that is still known; at most 8."""
        _, items = await self._ask(messages.DETECTIONS, {"from_seq": from_seq})
        self._check_ascending([item["detect_seq"] for item in items], from_seq)
        return tuple(Detection(item["detect_seq"], item["encoder"], item["length_counts"]) for item in items)

    async def arm(self, command: ArmCommand) -> ArmReply:
        """Ask to print a face on a tile."""
        values, _ = await self._ask(messages.ARM, asdict(command))
        status = self._known(ArmStatus, values["status"])
        if status in (ArmStatus.ACCEPTED, ArmStatus.DUPLICATE) and values["last_accepted_arm"] < command.arm_id:
            raise self._wrong(f"it accepted arm {command.arm_id}, but remembers {values['last_accepted_arm']}")
        return ArmReply(status, values["last_accepted_arm"])

    async def disarm(self, arm_id: int) -> DisarmStatus:
        """Cancel an arm that hasn't begun."""
        values, _ = await self._ask(messages.DISARM, {"arm_id": arm_id})
        return self._known(DisarmStatus, values["status"])

    async def outcomes(self, from_arm: int) -> tuple[Outcome, ...]:
        """Read what became of arms, from this one on; at most 6."""
        _, items = await self._ask(messages.OUTCOMES, {"from_arm": from_arm})
        self._check_ascending([item["arm_id"] for item in items], from_arm)
        states = [self._known(OutcomeState, item.pop("state")) for item in items]
        return tuple(Outcome(state=state, **item) for state, item in zip(states, items, strict=True))

    async def hold(self) -> None:
        """Begin no further print."""
        values, _ = await self._ask(messages.HOLD)
        if values["status"]:
            raise DeviceRefused(f"{self.name}: won't hold", device=self.name, code=values["status"])

    async def clear(self, fault_counter: int) -> bool:
        """End holding; whether it did. It doesn't if there was a newer fault, or the cause persists."""
        values, _ = await self._ask(messages.CLEAR, {"fault_counter": fault_counter})
        return self._known(ClearStatus, values["status"]) is ClearStatus.CLEARED

    async def _ask(
        self, message: Message, values: Mapping[str, int] | None = None
    ) -> tuple[dict[str, int], Sequence[dict[str, int]]]:
        try:
            payload = message.request.pack(values or {})
        except ValueError as error:
            raise DeviceRefused(f"{self.name}: {message.name}: {error}", device=self.name) from None
        async with self._turns.mine() as deadline:
            reply = await self._exchange(message.code, payload, deadline)
        if reply.type == messages.ERROR_TYPE:
            raise self._refused(message, reply.payload)
        try:
            return message.unpack_reply(reply.payload)
        except ValueError as error:
            raise self._wrong(str(error)) from None

    async def _exchange(self, code: int, payload: bytes, deadline: float) -> Frame:
        """Send a request, once more if need be, and wait for its reply."""
        request = Frame(self._session, self._memory.next_sequence(), code, payload)
        wire = encode_frame(request)
        self._stream.discard()
        self._reader.clear()
        self._stream.write(wire)
        again = deadline - self._deadline_s / 2
        # Where the line is so slow that a second reply couldn't come in time, there is only one try.
        most_s = (len(wire) + MOST_BODY) * self._char_s
        if again + most_s < deadline:
            reply = await self._reply(request, again)
            if reply is not None:
                return reply
            # The zero ends whatever noise may have reached the printer before.
            self._stream.write(b"\0" + wire)
        reply = await self._reply(request, deadline)
        if reply is None:
            raise DeviceTimeout(f"{self.name}: didn't answer in time: check its power and its cable", device=self.name)
        return reply

    async def _reply(self, request: Frame, until: float) -> Frame | None:
        """The reply to a request, if it comes until then; everything else that comes is dropped."""
        loop = asyncio.get_running_loop()
        while loop.time() < until:
            try:
                data = await self._stream.read(until)
            except DeviceTimeout:
                if not self._stream.is_open:
                    raise
                return None
            for frame in self._reader.feed(data):
                if (frame.session, frame.seq) == (request.session, request.seq) and frame.type in (
                    request.type | messages.REPLY_BIT,
                    messages.ERROR_TYPE,
                ):
                    return frame
        return None

    def _check_ascending(self, numbers: Sequence[int], first: int) -> None:
        if any(number < first for number in numbers) or any(a >= b for a, b in pairwise(numbers)):
            raise self._wrong(f"its entries from {first} on aren't in order")

    def _known(self, kind: type[E], value: int) -> E:
        try:
            return kind(value)
        except ValueError:
            raise self._wrong(f"{value} is no {kind.__name__}") from None

    def _refused(self, message: Message, payload: bytes) -> DeviceError:
        if len(payload) != 1:
            return self._wrong("an error reply has another length than 1")
        code = payload[0]
        reason = messages.ERRORS.get(code, "for an unknown reason")
        hint = ": another daemon took the printer over" if code == _STALE_SESSION else ""
        return DeviceRefused(
            f"{self.name}: refused {message.name}: {code} ({reason}){hint}", device=self.name, code=code
        )

    def _wrong(self, what: str) -> DeviceProtocolError:
        return DeviceProtocolError(f"{self.name}: {what}: nothing of it was used", device=self.name)
