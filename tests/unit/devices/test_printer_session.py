"""The printer's control session: bytes on the wire, and what is taken of what comes back."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.unit.devices import peers
from tilefab.devices import (
    ArmCommand,
    ArmReply,
    ArmStatus,
    Detection,
    DisarmStatus,
    Outcome,
    OutcomeState,
    PrinterIdentity,
    PrinterSession,
    PrinterStatus,
)
from tilefab.errors import DeviceProtocolError, DeviceRefused, DeviceTimeout

STATUS = struct.pack("<IHQIQQBI8HH", 77, 0b10000101, 1 << 40, 9, 1 << 33, 6, 2, 4096, *range(0, 800, 100), 5)
ARM = ArmCommand(1 << 33, 1 << 34, 7, 1 << 35, 100, 50, 1389, 4, 2)


def with_printer(
    printer: peers.Printer,
    work: Callable[[PrinterSession], Awaitable[Any]],
    *,
    session: int = 5,
    baud: int = 921600,
    deadline_s: float = 0.2,
) -> Any:
    async def run() -> Any:
        async with peers.serial_port(printer) as pair:
            one = PrinterSession(f"serial://{pair.path}?baud={baud}", session, deadline_s=deadline_s)
            await one.connect()
            try:
                return await work(one)
            finally:
                await one.close()

    return asyncio.run(run())


def replying(kind: int, payload: bytes) -> peers.Printer:
    return peers.Printer({1: peers.HELLO_REPLY, kind: payload})


def test_hello_tells_what_the_printer_is():
    printer = peers.Printer()
    assert with_printer(printer, lambda session: session.hello()) == PrinterIdentity(
        version=1,
        boot_id=77,
        inks=4,
        bits=2,
        counts_per_mm=20.0,
        eye_to_head_counts=9000,
        min_lead_counts=100,
        queue_len=8,
        buffer_bytes=1 << 20,
    )
    ((session, _, kind, payload),) = printer.requests
    assert (session, kind, payload) == (5, 1, b"\1")


def test_status_has_the_inks_that_there_are():
    printer = replying(2, STATUS)

    async def work(session: PrinterSession) -> tuple[PrinterStatus, PrinterStatus]:
        before = await session.status()
        await session.hello()
        return before, await session.status()

    before, status = with_printer(printer, work)
    assert before.ink_frac == (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
    assert status == PrinterStatus(
        boot_id=77,
        ready=True,
        held=False,
        e_stop=True,
        ink_out=False,
        nozzle_out=False,
        deadman=False,
        printing=False,
        underrun=True,
        encoder_counts=1 << 40,
        detect_seq=9,
        last_accepted_arm=1 << 33,
        last_outcome_arm=6,
        queued=2,
        buffer_free=4096,
        ink_frac=(0, 0.1, 0.2, 0.3),
        fault_counter=5,
    )
    assert printer.requests[0][2:] == (2, b"")


def test_detections():
    printer = replying(3, b"\2" + struct.pack("<IQI", 7, 1 << 40, 12000) + struct.pack("<IQI", 8, 1 << 41, 0))
    found = with_printer(printer, lambda session: session.detections(7))
    assert found == (Detection(7, 1 << 40, 12000), Detection(8, 1 << 41, 0))
    assert printer.requests[0][2:] == (3, b"\7\0\0\0")
    assert with_printer(replying(3, b"\0"), lambda session: session.detections(7)) == ()


@pytest.mark.parametrize("status", ArmStatus)
def test_arm(status):
    printer = replying(4, struct.pack("<BQ", status, 1 << 33))
    assert with_printer(printer, lambda session: session.arm(ARM)) == ArmReply(status, 1 << 33)
    wanted = struct.pack("<QQIQIIIBB", 1 << 33, 1 << 34, 7, 1 << 35, 100, 50, 1389, 4, 2)
    assert printer.requests[0][2:] == (4, wanted)


@pytest.mark.parametrize("status", DisarmStatus)
def test_disarm(status):
    printer = replying(5, bytes((status,)))
    assert with_printer(printer, lambda session: session.disarm(1 << 33)) is status
    assert printer.requests[0][2:] == (5, struct.pack("<Q", 1 << 33))


def test_outcomes():
    one = struct.pack("<QQIBIII", 5, 1 << 34, 7, 4, 30, 60, 0xDEADBEEF)
    printer = replying(6, b"\2" + one + struct.pack("<QQIBIII", 9, 1, 8, 0, 0, 0, 0))
    first, second = with_printer(printer, lambda session: session.outcomes(5))
    assert first == Outcome(5, 1 << 34, 7, OutcomeState.PARTIAL, 30, 60, 0xDEADBEEF)
    assert (second.arm_id, second.state) == (9, OutcomeState.QUEUED)
    assert printer.requests[0][2:] == (6, struct.pack("<Q", 5))


def test_hold():
    printer = replying(7, b"\0")
    assert with_printer(printer, lambda session: session.hold()) is None
    assert printer.requests[0][2:] == (7, b"")
    with pytest.raises(DeviceRefused, match="won't hold"):
        with_printer(replying(7, b"\1"), lambda session: session.hold())


@pytest.mark.parametrize(("status", "cleared"), [(0, True), (1, False), (2, False)])
def test_clear(status, cleared):
    printer = replying(8, bytes((status,)))
    assert with_printer(printer, lambda session: session.clear(0x1234)) is cleared
    assert printer.requests[0][2:] == (8, b"\x34\x12")


@pytest.mark.parametrize(
    ("kind", "payload", "call"),
    [
        (1, b"\2" + peers.HELLO_REPLY[1:], lambda s: s.hello()),
        (1, peers.HELLO_REPLY[:5] + b"\0" + peers.HELLO_REPLY[6:], lambda s: s.hello()),
        (1, peers.HELLO_REPLY[:5] + b"\x09" + peers.HELLO_REPLY[6:], lambda s: s.hello()),
        (1, peers.HELLO_REPLY[:-1], lambda s: s.hello()),
        (2, STATUS + b"\0", lambda s: s.status()),
        (2, STATUS[:5] + b"\1" + STATUS[6:], lambda s: s.status()),
        (2, STATUS[:39] + struct.pack("<H", 1001) + STATUS[41:], lambda s: s.status()),
        (3, b"", lambda s: s.detections(1)),
        (3, b"\1", lambda s: s.detections(1)),
        (3, b"\0" + bytes(16), lambda s: s.detections(1)),
        (3, b"\x09" + bytes(9 * 16), lambda s: s.detections(1)),
        (3, b"\1" + struct.pack("<IQI", 6, 0, 0), lambda s: s.detections(7)),
        (3, b"\2" + 2 * struct.pack("<IQI", 7, 0, 0), lambda s: s.detections(7)),
        (4, struct.pack("<BQ", 8, 1), lambda s: s.arm(ARM)),
        (4, struct.pack("<BQ", 0, 1), lambda s: s.arm(ARM)),
        (5, b"\3", lambda s: s.disarm(1)),
        (6, b"\1" + struct.pack("<QQIBIII", 5, 1, 7, 6, 30, 60, 1), lambda s: s.outcomes(5)),
        (6, b"\1" + struct.pack("<QQIBIII", 4, 1, 7, 2, 30, 60, 1), lambda s: s.outcomes(5)),
        (8, b"\3", lambda s: s.clear(1)),
    ],
)
def test_a_reply_that_makes_no_sense_is_not_used(kind, payload, call):
    with pytest.raises(DeviceProtocolError):
        with_printer(replying(kind, payload), call)


@pytest.mark.parametrize("code", [1, 2, 3, 4, 9])
def test_an_error_reply_is_a_refusal_with_its_code(code):
    def refuse(frame: bytes, send: peers.Send) -> None:
        session, seq = struct.unpack_from("<IH", peers.unstuffed(frame[:-1]))
        send(peers.tfp_frame(session, seq, 0xFF, bytes((code,))))

    with pytest.raises(DeviceRefused, match=f"refused STATUS: {code}") as caught:
        with_printer(peers.Printer(script=refuse), lambda session: session.status())
    assert caught.value.code == code


def test_a_newer_session_ends_this_one():
    printer = replying(2, STATUS)
    printer.session = 6
    with pytest.raises(DeviceRefused, match="another daemon") as caught:
        with_printer(printer, lambda session: session.status())
    assert caught.value.code == 3
    assert printer.acted == []


@pytest.mark.parametrize("value", [-1, 1 << 64])
def test_what_fits_in_no_field_is_never_sent(value):
    printer = peers.Printer()
    with pytest.raises(DeviceRefused, match="from_arm must be"):
        with_printer(printer, lambda session: session.outcomes(value))
    assert printer.requests == []


def losing(first: int) -> peers.Script:
    """Lose the first replies."""
    replies = iter(range(1000))

    def script(frame: bytes, send: peers.Send) -> None:
        if next(replies) >= first:
            send(frame)

    return script


def test_a_lost_reply_is_asked_for_once_more_and_nothing_happens_twice():
    printer = replying(4, struct.pack("<BQ", 0, ARM.arm_id))
    printer.script = losing(1)
    assert with_printer(printer, lambda session: session.arm(ARM)).status is ArmStatus.ACCEPTED
    assert len(printer.requests) == 2
    assert printer.requests[0] == printer.requests[1]
    assert len(printer.acted) == 1


def test_it_is_asked_no_third_time():
    printer = replying(4, struct.pack("<BQ", 0, ARM.arm_id))
    printer.script = losing(2)

    async def work(session: PrinterSession) -> None:
        with pytest.raises(DeviceTimeout, match="didn't answer in time"):
            await session.arm(ARM)
        assert session.connected
        assert len(printer.requests) == 2
        await session.arm(ARM)

    with_printer(printer, work)
    assert printer.requests[2][1] == printer.requests[0][1] % 65535 + 1, "another request"


def test_on_a_slow_line_there_is_one_try():
    printer = replying(2, STATUS)
    printer.script = peers.mute
    with pytest.raises(DeviceTimeout):
        with_printer(printer, lambda session: session.status(), baud=9600)
    assert len(printer.requests) == 1


def test_noise_before_a_request_cant_spoil_the_second_try():
    """That is led by a zero, which ends what the printer has heard before."""
    printer = replying(2, STATUS)
    answers = iter(range(10))

    def noisy(frame: bytes, send: peers.Send) -> None:
        if next(answers):
            send(frame)
        else:
            printer._rest = b"\x55\x55"

    printer.script = noisy
    assert with_printer(printer, lambda session: session.status()).boot_id == 77


def test_late_and_strange_replies_are_dropped():
    other = peers.tfp_frame(5, 9, 0x82, STATUS)
    held: list[bytes] = []

    def script(frame: bytes, send: peers.Send) -> None:
        body = peers.unstuffed(frame[:-1])
        session, seq, kind = struct.unpack_from("<IHB", body)
        wrong = struct.pack("<I", 1) + STATUS[4:]
        for strange in (
            b"\x55\0",
            b"\0\0\0",
            other,
            peers.tfp_frame(session + 1, seq, kind, wrong),
            peers.tfp_frame(session, seq ^ 1, kind, wrong),
            peers.tfp_frame(session, seq, kind ^ 1, wrong),
            peers.tfp_frame(session, seq, kind & 0x7F, wrong),
            frame[:20] + bytes((frame[20] ^ 0xFF or 1,)) + frame[21:],
            *held,
        ):
            send(strange)
        held.append(frame)
        send(frame)

    printer = replying(2, STATUS)
    printer.script = script

    async def work(session: PrinterSession) -> None:
        for number in range(10):
            printer.replies[2] = struct.pack("<I", 100 + number) + STATUS[4:]
            assert (await session.status()).boot_id == 100 + number

    with_printer(printer, work)
    assert len(printer.requests) == 10


def test_requests_at_the_same_time_take_turns():
    printer = replying(2, STATUS)
    found = with_printer(printer, lambda session: asyncio.gather(*(session.status() for _ in range(5))))
    assert len(found) == len(printer.requests) == 5


def test_a_turn_that_doesnt_come_within_the_deadline_is_an_error():
    printer = peers.Printer(script=peers.mute)

    async def work(session: PrinterSession) -> list[BaseException]:
        return await asyncio.gather(*(session.status() for _ in range(2)), return_exceptions=True)

    assert [type(error) for error in with_printer(printer, work, deadline_s=0.05)] == [DeviceTimeout] * 2


def test_a_new_session_object_doesnt_begin_with_the_numbers_of_the_last():
    printer = replying(2, STATUS)

    async def run() -> None:
        async with peers.serial_port(printer) as pair:
            for _ in range(3):
                session = PrinterSession(f"serial://{pair.path}", 5)
                await session.connect()
                await session.status()
                await session.close()

    asyncio.run(run())
    assert len({seq for _, seq, _, _ in printer.requests}) == 3
