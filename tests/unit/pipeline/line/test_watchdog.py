import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tilefab.pipeline.line.watchdog import Watchdog


class _Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        yield listener


def _environ(listener: socket.socket, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": listener.getsockname(), "WATCHDOG_USEC": "10000000", **more}


def _told(listener: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(listener.recv(4096).decode())
        except BlockingIOError:
            return found


def test_it_says_ready_and_stopping(systemd: socket.socket) -> None:
    with Watchdog(["plc"], environ=_environ(systemd)) as watchdog:
        watchdog.ready("idle")
        watchdog.tell("running\nREADY=0")
        watchdog.stopping()
    assert _told(systemd) == ["READY=1\nSTATUS=idle", "STATUS=running READY=0", "STOPPING=1"]


def test_it_is_fed_only_once_every_loop_went_round(systemd: socket.socket) -> None:
    clock = _Clock()
    with Watchdog(["plc", "printer"], environ=_environ(systemd), now_s=clock) as watchdog:
        for _ in range(100):
            clock.now_s += 1.0
            watchdog.went_round("plc")
        assert _told(systemd) == [], "one loop that goes round doesn't hide another that stands still"
        watchdog.went_round("printer")
        assert _told(systemd) == ["WATCHDOG=1"]
        clock.now_s += 100.0
        watchdog.went_round("printer")
        assert _told(systemd) == [], "what went round before it was fed doesn't count again"
        watchdog.went_round("plc")
        assert _told(systemd) == ["WATCHDOG=1"]


def test_it_is_fed_four_times_within_its_limit_not_at_each_round(systemd: socket.socket) -> None:
    clock = _Clock()
    with Watchdog(["plc"], environ=_environ(systemd), now_s=clock) as watchdog:
        for _ in range(1000):
            clock.now_s += 0.01
            watchdog.went_round("plc")
        assert len(_told(systemd)) in (3, 4)


def test_a_loop_that_nobody_asked_for_is_a_defect() -> None:
    with Watchdog(["plc"], environ={}) as watchdog, pytest.raises(ValueError, match="oven"):
        watchdog.went_round("oven")


@pytest.mark.parametrize(
    "more", [{"WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": ""}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "0"}]
)
def test_without_a_watchdog_it_is_never_fed(systemd: socket.socket, more: dict[str, str]) -> None:
    clock = _Clock()
    with Watchdog(["plc"], environ=_environ(systemd, **more), now_s=clock) as watchdog:
        clock.now_s += 1000.0
        watchdog.went_round("plc")
    assert _told(systemd) == []


def test_its_own_process_is_meant_by_its_number(systemd: socket.socket) -> None:
    clock = _Clock()
    with Watchdog(["plc"], environ=_environ(systemd, WATCHDOG_PID=str(os.getpid())), now_s=clock) as watchdog:
        clock.now_s += 1000.0
        watchdog.went_round("plc")
    assert _told(systemd) == ["WATCHDOG=1"]


def test_a_systemd_that_is_gone_or_doesnt_read_holds_nobody_up(tmp_path: Path, systemd: socket.socket) -> None:
    with Watchdog(["plc"], environ={"NOTIFY_SOCKET": str(tmp_path / "nobody")}) as watchdog:
        watchdog.ready()
    with Watchdog(["plc"], environ=_environ(systemd)) as watchdog:
        for _ in range(10_000):
            watchdog.ready()
    assert len(_told(systemd)) < 10_000


def test_an_abstract_socket_is_found() -> None:
    name = f"tilefab-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + name)
        listener.setblocking(False)
        with Watchdog([], environ={"NOTIFY_SOCKET": "@" + name}) as watchdog:
            watchdog.ready()
        assert _told(listener) == ["READY=1"]
