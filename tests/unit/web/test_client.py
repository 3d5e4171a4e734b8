"""The client of the commands against a daemon, against none, and against what is none."""

import asyncio
import socket
import threading
from pathlib import Path

import pytest

from tests.unit.pipeline.line.test_status import FULL
from tests.unit.web.line_at_work import Control, at_work
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout
from tilefab.web import client as client_module
from tilefab.web.client import LineClient, OrderRefusedError
from tilefab.web.token import read_token


def test_it_looks_and_orders(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            client = LineClient(file.socket_path, read_token(file.token_path))
            assert await asyncio.to_thread(client.status) == FULL
            assert await asyncio.to_thread(client.command, "ack", {"up_to": 4}) == "ack done"
            assert control.orders == [("ack", {"up_to": 4})]
            control.refuse = "not now"
            with pytest.raises(OrderRefusedError, match="not now") as caught:
                await asyncio.to_thread(client.command, "start", {})
            assert caught.value.exit_code == 10
            with pytest.raises(DeviceRefused, match="no command"):
                await asyncio.to_thread(client.command, "explode", {})
            stranger = LineClient(file.socket_path, "x" * 43)
            with pytest.raises(DeviceRefused, match="isn't the line's token") as refused:
                await asyncio.to_thread(stranger.command, "start", {})
            assert refused.value.code == 403
            assert await asyncio.to_thread(stranger.status) == FULL
            nobody = LineClient(file.socket_path)
            with pytest.raises(DeviceRefused, match="need the line's token"):
                await asyncio.to_thread(nobody.command, "start", {})

    asyncio.run(scenario())


def test_it_corrects_and_warns(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            client = LineClient(file.socket_path, read_token(file.token_path))
            drift = {"mean": [0.25] * 20_000}
            assert await asyncio.to_thread(client.correct, 7, drift, "fired darker") == 1
            assert control.corrected == [(7, drift, "fired darker")]
            await asyncio.to_thread(client.warn, "camera_silent", "no image for 10 min")
            assert control.warned == [("camera_silent", "no image for 10 min")]
            with pytest.raises(DeviceRefused, match="code must be one of"):
                await asyncio.to_thread(client.warn, "e_stop", "boo")
            control.refuse = "too soon"
            with pytest.raises(OrderRefusedError, match="too soon"):
                await asyncio.to_thread(client.correct, 7, drift, "again")

    asyncio.run(scenario())


def test_without_a_daemon_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(DeviceTimeout, match="no daemon runs on this line") as caught:
        LineClient(tmp_path / "line.sock").status()
    assert caught.value.exit_code == 10
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "dead.sock"))
    with pytest.raises(DeviceTimeout, match="no daemon runs on this line"):
        LineClient(tmp_path / "dead.sock").status()


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        (b"", DeviceError, "hung up"),
        (b"SSH-2.0-OpenSSH\r\n", DeviceError, "hung up"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n[]", DeviceProtocolError, "no daemon of a line"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\nmoin", DeviceProtocolError, "no daemon of a line"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 99\r\n\r\n{}", DeviceError, "hung up"),
        (b'HTTP/1.1 200 OK\r\nContent-Length: 11\r\n\r\n{"line": 1}', DeviceProtocolError, "another version"),
    ],
)
def test_what_answers_otherwise_is_no_daemon(tmp_path: Path, answer: bytes, error: type[Exception], words: str) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "odd.sock"))
        listener.listen()

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with pytest.raises(error, match=words):
                LineClient(tmp_path / "odd.sock").status()
        finally:
            thread.join()


def test_a_daemon_that_hangs_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "_LOOK_TIMEOUT_S", 0.05)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "mute.sock"))
        listener.listen()
        with pytest.raises(DeviceTimeout, match="doesn't answer"):
            LineClient(tmp_path / "mute.sock").status()
