"""The conveyor's session over TCP and RTU: what a poll takes and refuses, what a command writes and waits for."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace

import pytest

from tests.unit.devices import peers
from tests.unit.devices.wire_faults import command_words, status_of
from tilefab.devices import PlcCommand, PlcSession
from tilefab.devices.sequences import memory_of
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout

COMMAND = PlcCommand(True, False, 250.3, 600.0, 650.0, 70000, 0x80000005, 3)
WIRES = ["tcp", "rtu"]


@contextlib.asynccontextmanager
async def wired(unit: peers.Unit, wire: str, options: str = "") -> AsyncIterator[str]:
    """A unit on a wire, by its endpoint."""
    if wire == "tcp":
        async with peers.tcp_unit(unit) as endpoint:
            yield endpoint + options
    else:
        unit.rtu = True
        async with peers.serial_port(unit) as pair:
            yield f"modbus-rtu://{pair.path}?baud=921600{options}"


def with_session(
    unit: peers.Unit,
    wire: str,
    work: Callable[[PlcSession], Awaitable[None]],
    options: str = "",
    deadline_s: float = 0.2,
) -> None:
    """Run something with a connected session."""

    async def run() -> None:
        async with wired(unit, wire, options) as endpoint:
            session = PlcSession(endpoint, deadline_s=deadline_s)
            await session.connect()
            try:
                await work(session)
            finally:
                await session.close()

    asyncio.run(run())


def answers(change: Callable[[bytes], bytes], unit: peers.Unit) -> None:
    """Change the message of every answer; sums are right again afterwards."""

    def script(frame: bytes, send: peers.Send) -> None:
        if unit.rtu:
            body = frame[:1] + change(frame[1:-2])
            send(body + peers.crc16(body))
        else:
            pdu = change(frame[7:])
            send(frame[:4] + struct.pack(">H", len(pdu) + 1) + frame[6:7] + pdu)

    unit.script = script


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("options", ["", "&fc23=no"])
@pytest.mark.parametrize("sums", [True, False])
def test_a_poll_reads_everything(wire, options, sums):
    unit = peers.plc(sums=sums, fc23=not options)
    unit.words[5:23] = range(100, 118)

    async def work(session: PlcSession) -> None:
        for _ in range(3):
            status = await session.poll()
            assert status == status_of(unit.words)
        assert session.connected

    with_session(unit, wire, work, options)


@pytest.mark.parametrize("wire", WIRES)
def test_a_poll_is_one_request_with_a_new_number_each_time(wire):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        for _ in range(5):
            await session.poll()

    with_session(unit, wire, work)
    numbers = [struct.unpack(">BHHHHBH", pdu) for pdu in unit.requests]
    assert {one[:6] for one in numbers} == {(23, 0, 64, 0, 1, 2)}
    assert len({one[6] for one in numbers}) == 5


@pytest.mark.parametrize("wire", WIRES)
def test_numbers_go_on_in_the_next_session(wire):
    unit = peers.plc()

    async def run() -> None:
        async with wired(unit, wire) as endpoint:
            for _ in range(4):
                session = PlcSession(endpoint)
                await session.connect()
                await session.poll()
                await session.close()

    asyncio.run(run())
    assert len({pdu[-2:] for pdu in unit.requests}) == 4


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("options", ["", "&fc23=no"])
def test_a_command_is_written_read_back_and_acknowledged(wire, options):
    unit = peers.plc(fc23=not options)

    async def work(session: PlcSession) -> None:
        status = await session.command(COMMAND)
        assert unit.words[33:42] == command_words(COMMAND)
        assert status.cmd_ack == unit.words[32] != 0
        again = await session.command(COMMAND)
        assert again.cmd_ack == status.cmd_ack + 1

    with_session(unit, wire, work, options)
    assert [pdu[1:3] for pdu in unit.requests if pdu[0] == 16] == [b"\0\x20"] * 2


@pytest.mark.parametrize(
    ("acted", "there", "wanted"), [(5, 5, 6), (5, 6, 7), (65535, 65535, 1), (65534, 65535, 1), (0, 0, 1), (0, 40000, 1)]
)
def test_a_command_is_newer_than_what_was_acted_on_and_another_than_what_stands_there(acted, there, wanted):
    unit = peers.plc()
    unit.words[19], unit.words[32] = acted, there

    async def work(session: PlcSession) -> None:
        assert (await session.command(COMMAND)).cmd_ack == wanted

    with_session(unit, "tcp", work)


def test_a_command_that_may_still_be_acted_on_isnt_given_the_same_number_again():
    unit = peers.plc(acts=False)

    async def work(session: PlcSession) -> None:
        for number in (1, 2):
            with pytest.raises(DeviceTimeout, match="didn't act"):
                await session.command(COMMAND)
            assert unit.words[32] == number
        unit.acts = True
        assert (await session.command(COMMAND)).cmd_ack == 3
        # Another start of the controller: it acts on any number.
        unit.words[2], unit.words[19], unit.words[32] = 4711, 0, 0
        assert (await session.command(COMMAND)).cmd_ack == 4

    with_session(unit, "tcp", work)


@pytest.mark.parametrize("wire", WIRES)
def test_a_controller_that_acts_a_little_later_is_waited_for(wire):
    unit = peers.plc(acts=False)

    async def work(session: PlcSession) -> None:
        await session.poll()
        asyncio.get_running_loop().call_later(0.03, lambda: unit.words.__setitem__(19, unit.words[32]))
        assert (await session.command(COMMAND)).cmd_ack == 1

    with_session(unit, wire, work)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("place", range(32, 42))
def test_a_command_that_reads_back_otherwise_is_an_error(wire, place):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        await session.poll()
        write = unit.write

        def forgetful(address: int, words: tuple[int, ...]) -> None:
            write(address, words)
            if address:
                unit.words[place] ^= 1

        unit.write = forgetful  # type: ignore[method-assign]
        with pytest.raises(DeviceProtocolError, match="read back other"):
            await session.command(COMMAND)

    with_session(unit, wire, work)


@pytest.mark.parametrize(
    "change",
    [
        {"speed_mm_s": 3000.1},
        {"speed_mm_s": float("nan")},
        {"tile_length_mm": 49.0},
        {"tile_pitch_mm": 5000.0},
        {"release_bits": 1 << 32},
        {"release_base": -1},
        {"ack_fault": 65536},
    ],
)
def test_a_command_outside_the_limits_is_never_sent(change):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        with pytest.raises(DeviceRefused, match="must be from"):
            await session.command(replace(COMMAND, **change))

    with_session(unit, "tcp", work)
    assert unit.requests == []


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda pdu: b"\x03" + pdu[1:], "function 3 answered function 23"),
        (lambda _: b"\x10\x00\x20\x00\x0a", "answered function 23|announces"),
        (lambda pdu: pdu[:1] + b"\x7e" + pdu[2:-2], "bytes instead of"),
        (lambda pdu: pdu[:1] + b"\x82" + pdu[2:] + b"\0\0", "bytes instead of"),
        (lambda pdu: pdu[:2] + bytes((pdu[2], pdu[3] ^ 1)) + pdu[4:], "is to poll"),
        (lambda pdu: pdu[:8] + b"\x03" + pdu[9:], "the sum of an answer is wrong"),
        (lambda pdu: pdu[:-1] + bytes((pdu[-1] ^ 1,)), "the sum of an answer is wrong"),
    ],
)
def test_an_answer_that_isnt_to_this_poll_is_refused(wire, change, reason):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        await session.poll()
        script = unit.script
        answers(change, unit)
        with pytest.raises(DeviceProtocolError, match=reason):
            await session.poll()
        assert session.connected == (wire == "rtu"), "only a stream is given up"
        unit.script = script
        if wire == "tcp":
            with pytest.raises(DeviceTimeout, match="not connected"):
                await session.poll()
            await session.connect()
        assert (await session.poll()).boot_id == unit.words[2]

    with_session(unit, wire, work)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize(
    "change",
    [
        lambda pdu: pdu[:2] + b"\x21" + pdu[3:],
        lambda pdu: pdu[:4] + b"\x09",
    ],
    ids=["address", "count"],
)
def test_an_answer_to_another_write_is_refused(wire, change):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        await session.poll()
        answers(lambda pdu: change(pdu) if pdu[0] == 16 else pdu, unit)
        with pytest.raises(DeviceProtocolError, match="isn't to the write at 32"):
            await session.command(COMMAND)

    with_session(unit, wire, work)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("place", [2, 4], ids=["address", "value"])
def test_an_answer_to_another_write_of_one_register_is_refused(wire, place):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        answers(
            lambda pdu: pdu[:place] + bytes((pdu[place] ^ 1,)) + pdu[place + 1 :] if pdu[0] == 6 else pdu,
            unit,
        )
        with pytest.raises(DeviceProtocolError, match="isn't to the write at 0"):
            await session.poll()

    with_session(unit, wire, work, "&fc23=no")


def test_a_controller_that_has_sent_sums_must_go_on_to():
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        await session.poll()
        unit.sums = False
        with pytest.raises(DeviceProtocolError, match="sum"):
            await session.poll()

    with_session(unit, "rtu", work)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda frame: b"\0\7" + frame[2:],
        lambda frame: frame[:2] + b"\0\1" + frame[4:],
        lambda frame: frame[:6] + b"\2" + frame[7:],
        lambda frame: frame[:4] + b"\0\3" + frame[6:],
        lambda frame: frame + b"\0",
        lambda frame: b"\0" + frame,
    ],
    ids=["transaction", "protocol", "unit", "length", "more", "shifted"],
)
def test_a_tcp_frame_must_fit_to_the_last_byte(spoil):
    unit = peers.plc(script=lambda frame, send: send(spoil(frame)))

    async def work(session: PlcSession) -> None:
        with pytest.raises(DeviceProtocolError):
            await session.poll()
        assert not session.connected

    with_session(unit, "tcp", work)


def test_bytes_that_nobody_asked_for_end_a_tcp_connection():
    unit = peers.plc()

    async def run() -> None:
        async with peers.tcp_port(unit) as port:
            session = PlcSession(f"modbus-tcp://127.0.0.1:{port.port}")
            await session.connect()
            await session.poll()
            port.transports[0].write(b"hello")
            async with asyncio.timeout(5):
                while not session._link.stream._connection.inbox._bytes:  # type: ignore[union-attr]
                    await asyncio.sleep(0.001)
            with pytest.raises(DeviceProtocolError, match="nobody had asked for"):
                await session.poll()
            assert len(unit.requests) == 1
            assert not session.connected
            await session.close()

    asyncio.run(run())


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("size", [1, 2, 3, 7, 64, 1000])
def test_an_answer_may_come_in_pieces(wire, size):
    def in_pieces(frame: bytes, send: peers.Send) -> None:
        loop = asyncio.get_running_loop()
        for number, place in enumerate(range(0, len(frame), size)):
            loop.call_later(0.0003 * number, send, frame[place : place + size])

    unit = peers.plc(script=in_pieces)

    async def work(session: PlcSession) -> None:
        assert (await session.poll()).boot_id == unit.words[2]

    with_session(unit, wire, work)


@pytest.mark.parametrize("wire", WIRES)
def test_an_exception_is_a_refusal_and_the_connection_stays(wire):
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        for code in (1, 2, 3, 4, 6, 11):
            unit.refuse = code
            with pytest.raises(DeviceRefused, match=f"exception {code}") as caught:
                await session.poll()
            assert caught.value.code == code
        unit.refuse = 0
        assert session.connected
        await session.poll()

    with_session(unit, wire, work)


def test_swapped_words_and_a_controller_not_ready_are_refused_on_a_sound_connection():
    unit = peers.plc()

    async def work(session: PlcSession) -> None:
        unit.words[3:5] = 0x0304, 0x0102
        with pytest.raises(DeviceProtocolError, match="other order"):
            await session.poll()
        unit.words[3:5] = 0x0102, 0x0304
        boot, unit.words[2] = unit.words[2], 0
        with pytest.raises(DeviceProtocolError, match="boot_id is 0"):
            await session.poll()
        unit.words[2] = boot
        assert session.connected
        await session.poll()

    with_session(unit, "tcp", work)


def test_a_scan_counter_that_stands_still_means_that_the_program_has_stopped():
    unit = peers.plc(counts=False)

    async def run() -> None:
        async with peers.tcp_unit(unit) as endpoint:
            session = PlcSession(endpoint)
            await session.connect()
            await session.poll()
            await session.poll()
            memory = memory_of(endpoint)
            assert memory.scan_since_s is not None
            memory.scan_since_s -= 0.31
            with pytest.raises(DeviceProtocolError, match="stood still for 0"):
                await session.poll()
            # Neither a new connection nor a new session makes it move.
            await session.close()
            session = PlcSession(endpoint)
            await session.connect()
            with pytest.raises(DeviceProtocolError, match="stood still"):
                await session.poll()
            unit.words[1] += 1
            await session.poll()
            await session.close()

    asyncio.run(run())


@pytest.mark.parametrize("wire", WIRES)
def test_polls_at_the_same_time_take_turns(wire):
    unit = peers.plc()
    under_way = itertools.count()

    def slowly(frame: bytes, send: peers.Send) -> None:
        assert len(unit.requests) == next(under_way) + 1, "the one before was answered"
        asyncio.get_running_loop().call_later(0.005, send, frame)

    unit.script = slowly

    async def work(session: PlcSession) -> None:
        assert len(await asyncio.gather(*(session.poll() for _ in range(4)))) == 4

    with_session(unit, wire, work)
    assert len(unit.requests) == 4


def test_a_turn_that_doesnt_come_within_the_deadline_is_an_error():
    unit = peers.plc(script=peers.mute)

    async def work(session: PlcSession) -> None:
        polls = await asyncio.gather(*(session.poll() for _ in range(2)), return_exceptions=True)
        assert [type(poll) for poll in polls] == [DeviceTimeout, DeviceTimeout]
        assert any("busy" in str(poll) for poll in polls)

    with_session(unit, "tcp", work, deadline_s=0.05)
    assert len(unit.requests) == 1


@pytest.mark.parametrize("wire", WIRES)
def test_a_call_that_is_cancelled_leaves_nothing_that_the_next_could_take(wire):
    unit = peers.plc(script=peers.mute)

    async def work(session: PlcSession) -> None:
        call = asyncio.ensure_future(session.poll())
        async with asyncio.timeout(5):
            while not unit.requests:
                await asyncio.sleep(0.001)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        unit.script = peers.plainly
        if wire == "tcp":
            assert not session.connected
            await session.connect()
        assert (await session.poll()) == status_of(unit.words)

    with_session(unit, wire, work)


def test_a_port_that_nobody_listens_on():
    async def run() -> None:
        async with peers.tcp_port(peers.plc()) as port:
            await port.stop()
            session = PlcSession(f"modbus-tcp://127.0.0.1:{port.port}")
            with pytest.raises(DeviceTimeout, match="Connection refused"):
                await session.connect()
            assert not session.connected
            with pytest.raises(DeviceTimeout, match="not connected"):
                await session.poll()
            await port.start()
            await session.connect()
            await session.poll()
            await session.close()

    asyncio.run(run())


def test_a_session_that_isnt_connected_says_so():
    async def run() -> None:
        for endpoint in ("modbus-tcp://127.0.0.1:9", "modbus-rtu:///dev/null"):
            session = PlcSession(endpoint)
            assert not session.connected
            with pytest.raises(DeviceTimeout, match="not connected"):
                await session.poll()
            with pytest.raises(DeviceTimeout, match="not connected"):
                await session.command(COMMAND)
            await session.close()

    asyncio.run(run())


def test_a_line_too_slow_for_its_deadline_is_refused():
    PlcSession("modbus-rtu:///tmp/x?baud=9600")
    with pytest.raises(DeviceError, match="more baud"):
        PlcSession("modbus-rtu:///tmp/x?baud=4800")
