"""What the loops of conveyor and printer make of moments that a whole line rarely meets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest

from tilefab.control.ledger import ArmState, FaceQueue, FaceStates
from tilefab.control.tile_tracking import Calibration
from tilefab.devices import PlcCommand, PlcStatus, PrinterStatus
from tilefab.errors import DeviceTimeout
from tilefab.io.journal import ArmChange, Intent
from tilefab.pipeline.line.book import ActiveArm, FaceBook
from tilefab.pipeline.line.conveyor_loop import BeltSettings, ConveyorLoop
from tilefab.pipeline.line.printer_loop import PrinterLoop

CALIBRATION = Calibration(printer_boot=1, plc_boot=2, seq_offset=0, position_offset_counts=0, detect_seq=0)
PLC = PlcStatus(
    boot_id=2,
    scan_counter=1,
    belt_running=False,
    e_stop=False,
    jam=False,
    deadman_tripped=False,
    double_feed=False,
    feed_enabled=False,
    ready=True,
    diverter_fault=False,
    kiln_full=False,
    belt_speed_mm_s=0.0,
    position_counts=0,
    tile_seq=0,
    tile_position_counts=0,
    decided_seq=0,
    passed_bits=0,
    cmd_ack=0,
    fault_counter=0,
    tiles_fed=0,
)
PRINTER = PrinterStatus(
    boot_id=1,
    ready=True,
    held=True,
    e_stop=False,
    ink_out=False,
    nozzle_out=False,
    deadman=False,
    printing=False,
    underrun=False,
    encoder_counts=500,
    detect_seq=0,
    last_accepted_arm=0,
    last_outcome_arm=0,
    queued=0,
    buffer_free=1,
    ink_frac=(1.0,) * 8,
    fault_counter=0,
)


@dataclass
class Host:
    """The line, as the loops see it."""

    moving: bool = False
    may_print: bool = False
    book: FaceBook | None = None
    streamer: None = None
    told: list[str] = field(default_factory=list)
    on_e_stop: Callable[[bool], None] = lambda _: None

    def e_stop(self, device: str, pressed: bool) -> None:
        self.told.append(f"e_stop {device} {pressed}")
        self.on_e_stop(pressed)

    def doubt(self, code: str, _: str) -> None:
        self.told.append(code)

    def fault(self, code: str, _: str) -> None:
        self.told.append(f"fault {code}")

    def tiles_moved(self, code: str) -> None:
        self.told.append(f"moved {code}")

    def print_spoilt(self, code: str) -> None:
        self.told.append(f"spoilt {code}")

    def tile_done(self, passed: bool) -> None:
        self.told.append(f"tile {passed}")


class Keeper:
    """A journal that takes what it is given once it is let."""

    def __init__(self) -> None:
        self.marked: list[ArmChange] = []
        self.may = asyncio.Event()

    async def mark(self, changes: Sequence[ArmChange], _: str) -> None:
        await self.may.wait()
        self.marked += changes


class Plc:
    """A conveyor's session: what is polled next, and what comes of commands."""

    def __init__(self) -> None:
        self.now = PLC
        self.after: PlcStatus | DeviceTimeout | None = None
        self.commands: list[PlcCommand] = []

    async def poll(self) -> PlcStatus:
        return self.now

    async def command(self, command: PlcCommand) -> PlcStatus:
        self.commands.append(command)
        after, self.after = self.after, None
        if isinstance(after, DeviceTimeout):
            raise after
        self.now = after if after is not None else self.now
        return self.now


def conveyor(host: Host, keeper: Keeper | None = None) -> ConveyorLoop:
    loop = ConveyorLoop(cast(Any, host), cast(Any, keeper))
    loop.settings = BeltSettings(200.0, 60.0, 100.0)
    return loop


def printed(*tiles: int) -> FaceBook:
    book = FaceBook(1, FaceQueue(FaceStates(faces=100, next_new=100)))
    for tile in tiles:
        intent = Intent(tile, 1, tile, 1)
        book.active[tile] = ActiveArm(intent, tile, tile, ArmState.PRINTED, recorded=True)
    return book


def go(loop: ConveyorLoop, plc: Plc, times: int = 1) -> None:
    async def work() -> None:
        for _ in range(times):
            await loop.cycle(cast(Any, plc))

    asyncio.run(work())


def test_a_command_is_given_once_and_again_after_a_restart() -> None:
    loop, plc = conveyor(Host()), Plc()
    go(loop, plc, 3)
    assert len(plc.commands) == 1
    plc.now = replace(PLC, boot_id=3)
    go(loop, plc, 2)
    assert len(plc.commands) == 2


def test_a_command_that_failed_is_given_again() -> None:
    loop, plc = conveyor(Host()), Plc()
    plc.after = DeviceTimeout("silent", device="plc")
    with pytest.raises(DeviceTimeout):
        go(loop, plc)
    go(loop, plc, 2)
    assert len(plc.commands) == 2


def test_an_acknowledgement_that_came_too_early_can_be_given_again() -> None:
    loop, plc = conveyor(Host()), Plc()
    plc.now = replace(PLC, e_stop=True, fault_counter=4)
    go(loop, plc)
    for _ in range(2):
        loop.acknowledge()
        go(loop, plc, 2)
    assert [command.ack_fault for command in plc.commands] == [0, 4, 4]


def test_a_fault_that_nobody_saw_is_not_acknowledged() -> None:
    loop, plc = conveyor(Host()), Plc()
    plc.now = replace(PLC, fault_counter=4)
    go(loop, plc)
    loop.acknowledge()
    plc.now = replace(PLC, jam=True, fault_counter=5)
    go(loop, plc, 3)
    assert all(command.ack_fault == 0 for command in plc.commands)


def test_an_acknowledgement_does_not_outlive_a_restart() -> None:
    loop, plc = conveyor(Host()), Plc()
    plc.now = replace(PLC, e_stop=True, fault_counter=1)
    go(loop, plc)
    loop.acknowledge()
    go(loop, plc)
    plc.now = replace(PLC, boot_id=3, jam=True, fault_counter=1)
    go(loop, plc, 3)
    assert plc.commands[-1].ack_fault == 0


def test_an_emergency_stop_that_a_commands_answer_tells_of_first_is_told_of() -> None:
    host = Host()
    loop, plc = conveyor(host), Plc()
    plc.after = replace(PLC, e_stop=True, fault_counter=1)
    go(loop, plc, 2)
    assert host.told == ["e_stop plc False", "e_stop plc True"]


def test_tiles_are_released_within_a_window_and_the_rest_later() -> None:
    host = Host(book=printed(*range(1, 41)))
    loop, plc = conveyor(host), Plc()
    loop.begin_at(CALIBRATION)
    go(loop, plc)
    assert (plc.commands[-1].release_base, plc.commands[-1].release_bits) == (1, (1 << 32) - 1)
    book = host.book
    assert book is not None
    assert [arm.intent.arm_id for arm in book.active.values() if arm.released] == [*range(1, 33)]
    for tile in range(1, 21):
        del book.active[tile]
    go(loop, plc)
    assert (plc.commands[-1].release_base, plc.commands[-1].release_bits) == (21, (1 << 20) - 1)
    assert all(arm.released for arm in book.active.values())


def test_tiles_that_the_journal_has_not_yet_are_not_released() -> None:
    book = printed(1, 2)
    book.update(2, recorded=False)
    loop, plc = conveyor(Host(book=book)), Plc()
    loop.begin_at(CALIBRATION)
    go(loop, plc)
    assert (plc.commands[-1].release_base, plc.commands[-1].release_bits) == (1, 1)
    assert not book.active[2].asked_release


def test_a_release_that_was_not_answered_was_asked_for_all_the_same() -> None:
    book = printed(1)
    loop, plc = conveyor(Host(book=book)), Plc()
    loop.begin_at(CALIBRATION)
    plc.after = DeviceTimeout("silent", device="plc")
    with pytest.raises(DeviceTimeout):
        go(loop, plc)
    assert (book.active[1].asked_release, book.active[1].released) == (True, False)


def test_releases_that_another_boot_took_are_remembered() -> None:
    host = Host(book=printed(5))
    loop, plc = conveyor(host), Plc()
    loop.begin_at(CALIBRATION)
    plc.after = replace(PLC, boot_id=9)
    go(loop, plc, 2)
    assert loop.spoilt_boot == 9
    assert "plc_rebooted" in host.told
    assert plc.commands[-1].release_bits == 0


def test_a_restart_is_told_of_once() -> None:
    host = Host()
    loop, plc = conveyor(host), Plc()
    loop.begin_at(CALIBRATION)
    go(loop, plc)
    plc.now = replace(PLC, boot_id=9)
    go(loop, plc, 3)
    assert host.told.count("plc_rebooted") == 1


def test_tiles_that_were_decided_are_put_down_without_holding_up_the_loop() -> None:
    async def work() -> None:
        host, keeper, plc = Host(book=printed(1, 2, 3)), Keeper(), Plc()
        loop = conveyor(host, keeper)
        loop.begin_at(CALIBRATION)
        plc.now = replace(PLC, tile_seq=3, decided_seq=2, passed_bits=0b10)
        for _ in range(3):
            await loop.cycle(cast(Any, plc))
        assert not keeper.marked
        book = host.book
        assert book is not None
        assert set(book.active) == {1, 2, 3}
        keeper.may.set()
        await loop.written()
        assert [(change.arm_id, change.state) for change in keeper.marked] == [
            (1, ArmState.PASSED),
            (2, ArmState.DIVERTED),
        ]
        assert set(book.active) == {3}
        assert host.told.count("tile True") == host.told.count("tile False") == 1
        assert "good_tile_diverted" in host.told

    asyncio.run(work())


def test_a_tile_decided_too_long_ago_is_in_doubt() -> None:
    async def work() -> None:
        host, keeper, plc = Host(book=printed(1)), Keeper(), Plc()
        loop = conveyor(host, keeper)
        loop.begin_at(CALIBRATION)
        keeper.may.set()
        plc.now = replace(PLC, tile_seq=80, decided_seq=65, passed_bits=0)
        await loop.cycle(cast(Any, plc))
        await loop.written()
        assert [change.state for change in keeper.marked] == [ArmState.IN_DOUBT]
        assert "tile_lost" in host.told

    asyncio.run(work())


class Printer:
    """A printer's session that writes down what it is asked."""

    def __init__(self) -> None:
        self.now = PRINTER
        self.asked: list[str] = []
        self.before_clear: Callable[[], None] = lambda: None

    async def status(self) -> PrinterStatus:
        return self.now

    async def hold(self) -> None:
        self.asked.append("hold")

    async def clear(self, fault_counter: int) -> bool:
        self.before_clear()
        self.asked.append(f"clear {fault_counter}")
        return True


def go_printer(loop: PrinterLoop, printer: Printer, times: int = 1) -> None:
    async def work() -> None:
        for _ in range(times):
            await loop.cycle(cast(Any, printer))

    asyncio.run(work())


def printer_loop(host: Host) -> PrinterLoop:
    return PrinterLoop(cast(Any, host), cast(Any, None))


def test_an_acknowledged_printer_is_cleared_at_rest_only_and_goes_on_holding() -> None:
    loop, printer = printer_loop(Host()), Printer()
    printer.now = replace(PRINTER, ink_out=True, fault_counter=3)
    go_printer(loop, printer)
    loop.acknowledge()
    for encoder in (600, 650, 700):
        printer.now = replace(printer.now, encoder_counts=encoder)
        go_printer(loop, printer)
    assert not printer.asked
    go_printer(loop, printer, 3)
    assert printer.asked == ["clear 3", "hold"]


def test_a_printers_acknowledgement_does_not_outlive_its_restart() -> None:
    loop, printer = printer_loop(Host()), Printer()
    printer.now = replace(PRINTER, ink_out=True, fault_counter=1)
    go_printer(loop, printer)
    loop.acknowledge()
    printer.now = replace(PRINTER, boot_id=8, nozzle_out=True, fault_counter=1)
    go_printer(loop, printer, 3)
    assert not printer.asked


def test_a_printer_is_not_cleared_over_an_emergency_stop_seen_just_then() -> None:
    host = Host()
    loop, printer = printer_loop(host), Printer()
    host.on_e_stop = lambda pressed: loop.hold() if pressed else None
    go_printer(loop, printer)
    loop.clear()
    printer.now = replace(PRINTER, e_stop=True, fault_counter=1)
    go_printer(loop, printer, 2)
    assert printer.asked == ["hold"]


def test_a_printer_held_while_it_is_cleared_is_held_again() -> None:
    loop, printer = printer_loop(Host()), Printer()
    go_printer(loop, printer)
    loop.clear()
    printer.before_clear = loop.hold
    go_printer(loop, printer, 2)
    assert printer.asked == ["clear 0", "hold"]


def test_a_printers_restart_is_told_of_once() -> None:
    host = Host()
    loop, printer = printer_loop(host), Printer()
    loop.calibration = CALIBRATION
    go_printer(loop, printer)
    printer.now = replace(PRINTER, boot_id=8)
    go_printer(loop, printer, 3)
    assert host.told.count("printer_rebooted") == 1
