"""The API of a line: who may do what, and what becomes of requests that nobody should send."""

import asyncio
import json
import os
import socket
import stat
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from tests.unit.pipeline.line.test_status import FULL
from tests.unit.web.line_at_work import LINE, Control, ask, at_work, free_port, line_file
from tilefab.errors import ConfigError
from tilefab.pipeline.line.orders import ORDERS
from tilefab.pipeline.line.status import LineStatus
from tilefab.web import api as api_module
from tilefab.web.token import read_token

ARGUMENTS: dict[str, dict[str, object]] = {
    "ack": {"up_to": 4},
    "queue": {"job": "/jobs/demo.toml"},
    "reprint": {"face": 3},
    "settle": {"face": 3, "state": "passed"},
}


def _body(name: str, **more: object) -> bytes:
    return json.dumps({"command": name, **ARGUMENTS.get(name, {}), **more}).encode()


def test_anybody_may_look(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            code, headers, body = await ask(file.socket_path, "GET /v1/status")
            assert code == 200
            assert LineStatus.from_json(json.loads(body)) == FULL
            assert headers["cache-control"] == "no-store"
            code, _, body = await ask(file.socket_path, "GET /v1/alarms")
            assert code == 200
            assert [alarm["code"] for alarm in json.loads(body)["alarms"]] == ["jam"]
            code, _, body = await ask(file.socket_path, "GET /v1/faces?last=7")
            assert code == 200
            assert [face["face"] for face in json.loads(body)["faces"]] == [11]
            assert control.asked_for == 7
            code, headers, body = await ask(file.socket_path, "GET /metrics")
            assert code == 200
            assert headers["content-type"].startswith("text/plain; version=0.0.4")
            assert body == control.metrics()

    asyncio.run(scenario())


@pytest.mark.parametrize("name", ORDERS)
def test_no_order_without_the_token(tmp_path: Path, name: str) -> None:
    async def scenario() -> str:
        control = Control()
        async with at_work(tmp_path, control) as (file, stream):
            token = read_token(file.token_path)
            for given in ("", f"Basic {token}", "Bearer", "Bearer ", token):
                headers = {"Authorization": given} if given else {}
                code, told, body = await ask(file.socket_path, "POST /v1/commands", _body(name), **headers)
                assert code == 401, given
                assert told["www-authenticate"] == "Bearer"
                assert "token" in json.loads(body)["error"]
            for given in (token[:-1], token + "x", token.swapcase(), "é" * 43, "x" * 4000):
                code, _, body = await ask(
                    file.socket_path, "POST /v1/commands", _body(name), Authorization=f"Bearer {given}"
                )
                assert code == 403, given
            assert control.orders == []
            code, _, body = await ask(
                file.socket_path, "POST /v1/commands", _body(name), Authorization=f"Bearer {token}"
            )
            assert (code, json.loads(body)) == (200, {"done": f"{name} done"})
            assert control.orders == [(name, ARGUMENTS.get(name, {}))]
            # Neither in the query, nor in the body, nor as another method.
            for request, content in (
                (f"POST /v1/commands?token={token}", _body(name)),
                ("POST /v1/commands", _body(name, token=token)),
            ):
                code, _, _ = await ask(file.socket_path, request, content)
                assert code == 401
            code, told, _ = await ask(
                file.socket_path, f"GET /v1/commands?command={name}", Authorization=f"Bearer {token}"
            )
            assert (code, told["allow"]) == (405, "POST")
            assert len(control.orders) == 1
        return token + "\n" + stream.getvalue()

    token, _, log = asyncio.run(scenario()).partition("\n")
    assert '"kind": "order"' in log
    assert '"kind": "order without right"' in log
    assert token not in log


def test_the_token_isnt_logged_even_if_the_line_itself_tells_it(tmp_path: Path) -> None:
    async def scenario() -> tuple[str, str]:
        control = Control()
        async with at_work(tmp_path, control) as (file, stream):
            token = read_token(file.token_path)
            control.refuse = f"what is {token}?"
            right = {"Authorization": f"Bearer {token}"}
            assert (await ask(file.socket_path, "POST /v1/commands", _body("start"), **right))[0] == 409
        return token, stream.getvalue()

    token, log = asyncio.run(scenario())
    assert "what is ***?" in log
    assert token not in log


def test_what_the_line_wont_do_now_is_told_with_its_exit_code(tmp_path: Path) -> None:
    async def scenario() -> str:
        control = Control()
        control.refuse = "the line is running already"
        async with at_work(tmp_path, control) as (file, stream):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            code, _, body = await ask(file.socket_path, "POST /v1/commands", _body("start"), **right)
            assert code == 409
            assert json.loads(body) == {"error": "the line is running already", "exit_code": 10}
        return stream.getvalue()

    assert '"why": "the line is running already"' in asyncio.run(scenario())


WRONG: list[tuple[bytes, str]] = [
    (b"", "JSON"),
    (b"{", "JSON"),
    (b"[]", "JSON object"),
    (b'{"command": 3}', "JSON object"),
    (b'{"command": "explode"}', "no command 'explode'"),
    (b'{"command": "ack"}', "ack needs 'up_to'"),
    (b'{"command": "ack", "up_to": 1e3}', "whole number"),
    (b'{"command": "ack", "up_to": NaN}', "whole number"),
    (b'{"command": "ack", "up_to": ' + b"9" * 5000 + b"}", ""),
    (b"[" * 10_000, ""),
    (b"\xff\xfe", ""),
    (b"\x1f\x8b\x08\x00", ""),
]


def test_what_is_no_order_is_refused_in_words(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            for body, words in WRONG:
                code, _, answer = await ask(file.socket_path, "POST /v1/commands", body, **right)
                assert code == 400, body[:40]
                assert words.lower() in json.loads(answer)["error"].lower() or words == "JSON", body[:40]
            assert control.orders == []

    asyncio.run(scenario())


def test_bodies_are_bounded(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            body = json.dumps({"command": "start", "x": "y" * (17 << 10)}).encode()
            code, _, _ = await ask(file.socket_path, "POST /v1/commands", body, **right)
            assert code == 413
            # Packed ones aren't unpacked.
            code, _, _ = await ask(
                file.socket_path, "POST /v1/commands", _body("start"), **right, Content_Encoding="gzip"
            )
            assert code == 200
            assert [name for name, _ in control.orders] == ["start"]

    asyncio.run(scenario())


CORRECTION = {"run_id": 7, "drift": {"mean": [0.0]}, "reason": "fired darker"}
WARNING = {"code": "defect_run", "text": "a line at 41 mm"}


@pytest.mark.parametrize(("path", "value"), [("/v1/corrections", CORRECTION), ("/v1/warnings", WARNING)])
def test_corrections_and_warnings_need_the_token(tmp_path: Path, path: str, value: dict[str, object]) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            body = json.dumps(value).encode()
            token = read_token(file.token_path)
            assert (await ask(file.socket_path, f"POST {path}", body))[0] == 401
            assert (await ask(file.socket_path, f"POST {path}", body, Authorization=f"Bearer {token}x"))[0] == 403
            assert not control.corrected
            assert not control.warned
            code, _, answer = await ask(file.socket_path, f"POST {path}", body, Authorization=f"Bearer {token}")
            assert code == 200
            if path == "/v1/corrections":
                assert json.loads(answer) == {"number": 1}
                assert control.corrected == [(7, {"mean": [0.0]}, "fired darker")]
            else:
                assert control.warned == [("defect_run", "a line at 41 mm")]

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("/v1/corrections", [], "give a JSON object"),
        ("/v1/corrections", {}, "run_id, drift, reason, and nothing else"),
        ("/v1/corrections", {**CORRECTION, "command": "start"}, "nothing else"),
        ("/v1/corrections", {**CORRECTION, "run_id": 0}, "run_id must be a whole number"),
        ("/v1/corrections", {**CORRECTION, "run_id": True}, "run_id must be a whole number"),
        ("/v1/corrections", {**CORRECTION, "drift": [1]}, "drift must be"),
        ("/v1/corrections", {**CORRECTION, "reason": ""}, "reason must be 1 to 500"),
        ("/v1/corrections", {**CORRECTION, "reason": "a\nb"}, "printable"),
        ("/v1/corrections", {**CORRECTION, "reason": "x" * 501}, "reason must be"),
        ("/v1/warnings", {"code": "defect_run"}, "code, text, and nothing else"),
        ("/v1/warnings", {"code": "e_stop", "text": "x"}, "code must be one of camera_folder"),
        ("/v1/warnings", {"code": ["defect_run"], "text": "x"}, "code must be one of"),
        ("/v1/warnings", {"code": "defect_run", "text": 3}, "text must be"),
    ],
)
def test_wrong_corrections_and_warnings_are_refused_in_words(
    tmp_path: Path, path: str, value: object, words: str
) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            code, _, answer = await ask(file.socket_path, f"POST {path}", json.dumps(value).encode(), **right)
            assert code == 400
            assert words in json.loads(answer)["error"]
            assert not control.corrected
            assert not control.warned

    asyncio.run(scenario())


def test_a_refused_correction_tells_why_and_is_logged(tmp_path: Path) -> None:
    async def scenario() -> str:
        control = Control()
        control.refuse = "the last one is too recent"
        async with at_work(tmp_path, control) as (file, stream):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            body = json.dumps(CORRECTION).encode()
            code, _, answer = await ask(file.socket_path, "POST /v1/corrections", body, **right)
            assert (code, json.loads(answer)) == (409, {"error": "the last one is too recent", "exit_code": 10})
        return stream.getvalue()

    log = asyncio.run(scenario())
    assert '"kind": "correction refused"' in log
    assert "fired darker" in log


def test_corrections_may_be_larger_than_orders_but_not_too_large(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            for size, wanted in ((1 << 20, 200), (3 << 20, 413)):
                body = json.dumps({**CORRECTION, "drift": {"note": "x" * size}}).encode()
                assert (await ask(file.socket_path, "POST /v1/corrections", body, **right))[0] == wanted
            assert len(control.corrected) == 1
            body = json.dumps({**WARNING, "text": "x" * (17 << 10)}).encode()
            assert (await ask(file.socket_path, "POST /v1/warnings", body, **right))[0] == 413

    asyncio.run(scenario())


def test_anybody_may_see_the_corrections_of_a_run(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with at_work(tmp_path, Control()) as (file, _):
            for query, run_id in (("", 7), ("?run=3", 3)):
                code, _, answer = await ask(file.socket_path, f"GET /v1/corrections{query}")
                assert code == 200
                told = json.loads(answer)
                assert told["run_id"] == run_id
                assert [found["number"] for found in told["corrections"]] == [3]
            for run in ("0", "-1", "x", "1.5", "9999999999", ""):
                assert (await ask(file.socket_path, f"GET /v1/corrections?run={quote(run)}"))[0] == 400
            assert (await ask(file.socket_path, "GET /v1/corrections?run=99"))[0] == 409

    asyncio.run(scenario())


def test_a_body_that_never_comes_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(api_module, "_BODY_TIMEOUT_S", 0.1)

    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            code, _, body = await ask(file.socket_path, "POST /v1/commands", b"{", **right, Content_Length="10")
            assert (code, json.loads(body)["error"]) == (400, "the request came too slowly")

    asyncio.run(scenario())


@pytest.mark.parametrize("last", ["0", "-1", "1001", "x", "", "1.5", "٣", "99999999999999999999"])
def test_a_wrong_number_of_faces_is_refused(tmp_path: Path, last: str) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            code, _, _ = await ask(file.socket_path, f"GET /v1/faces?last={quote(last)}")
            assert (code, control.asked_for) == (400, 0)

    asyncio.run(scenario())


def test_a_defect_is_logged_and_doesnt_end_the_daemon(tmp_path: Path) -> None:
    async def scenario() -> str:
        control = Control()
        async with at_work(tmp_path, control) as (file, stream):
            control.defect = "seven by nought"
            code, _, body = await ask(file.socket_path, "GET /v1/status")
            assert code == 500
            assert b"seven" not in body
            control.defect = ""
            assert (await ask(file.socket_path, "GET /v1/status"))[0] == 200
            code, _, body = await ask(file.socket_path, "GET /v2/nothing")
            assert (code, set(json.loads(body))) == (404, {"error"})
        return stream.getvalue()

    assert "ZeroDivisionError: seven by nought" in asyncio.run(scenario())


def test_whoever_never_closes_doesnt_take_all_descriptors(tmp_path: Path) -> None:
    async def scenario() -> None:
        control = Control()
        async with at_work(tmp_path, control) as (file, _):
            before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - as the kernel counts
            idle = []
            try:
                for _ in range(200):
                    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                    idle.append(connection)
                    connection.setblocking(False)
                    connection.connect(str(file.socket_path))
                    await asyncio.sleep(0)
                await _until(lambda: _hung_up(idle) >= 120)
                kept = len(os.listdir("/proc/self/fd")) - before - len(idle)  # noqa: PTH208
                assert kept <= 80
            finally:
                for connection in idle:
                    connection.close()

            async def answers() -> bool:
                try:
                    return (await ask(file.socket_path, "GET /v1/status"))[0] == 200
                except (OSError, IndexError, ValueError):
                    return False

            deadline = asyncio.get_running_loop().time() + 5
            while not await answers():
                assert asyncio.get_running_loop().time() < deadline
                await asyncio.sleep(0.01)

    asyncio.run(scenario())


def _hung_up(connections: list[socket.socket]) -> int:
    count = 0
    for connection in connections:
        try:
            count += connection.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            continue
        except OSError:
            count += 1
    return count


async def _until(condition: Any) -> None:
    deadline = asyncio.get_running_loop().time() + 5
    while not condition():
        assert asyncio.get_running_loop().time() < deadline
        await asyncio.sleep(0.01)


def test_over_http_as_over_the_socket_but_by_its_own_address(tmp_path: Path) -> None:
    async def scenario() -> str:
        control, port = Control(), free_port()
        async with at_work(tmp_path, control, LINE + f'[api]\nhttp = "127.0.0.1:{port}"\n') as (file, stream):
            place = ("127.0.0.1", port)
            for host in ("localhost", f"127.0.0.1:{port}", "[::1]"):
                assert (await ask(place, "GET /v1/status", Host=host))[0] == 200
            # A page in a browser whose name was made to point here.
            for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", ""):
                assert (await ask(place, "GET /v1/status", Host=host))[0] == 403
            assert (await ask(place, "POST /v1/commands", _body("start")))[0] == 401
            right = {"Authorization": f"Bearer {read_token(file.token_path)}"}
            assert (await ask(place, "POST /v1/commands", _body("start"), **right))[0] == 200
        with pytest.raises(ConnectionRefusedError):
            await ask(place, "GET /v1/status")
        return stream.getvalue()

    assert '"via": "127.0.0.1"' in asyncio.run(scenario())


def test_from_other_machines_only_if_the_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="other machines"):
        line_file(tmp_path, LINE + '[api]\nhttp = "0.0.0.0:8765"\n')


def test_the_socket_is_for_its_owner_and_group_and_goes_with_the_daemon(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with at_work(tmp_path, Control()) as (file, _):
            facts = file.socket_path.stat()
            assert stat.S_ISSOCK(facts.st_mode)
            assert stat.S_IMODE(facts.st_mode) == 0o660
        assert not file.socket_path.exists()

    asyncio.run(scenario())


def test_a_dead_daemons_socket_is_replaced_a_living_ones_is_not(tmp_path: Path) -> None:
    async def scenario() -> None:
        file = line_file(tmp_path)
        file.state_directory.mkdir()
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(file.socket_path))
        async with at_work(tmp_path, Control()):
            assert (await ask(file.socket_path, "GET /v1/status"))[0] == 200
            with pytest.raises(ConfigError, match="another daemon"):
                async with at_work(tmp_path, Control()):
                    pytest.fail("two daemons at one socket")
            assert (await ask(file.socket_path, "GET /v1/status"))[0] == 200

    asyncio.run(scenario())


def test_what_lies_in_the_sockets_place_is_left_alone(tmp_path: Path) -> None:
    async def scenario() -> None:
        file = line_file(tmp_path)
        file.state_directory.mkdir()
        file.socket_path.write_text("precious")
        with pytest.raises(ConfigError, match="socket"):
            async with at_work(tmp_path, Control()):
                pytest.fail("a file was taken for a socket")
        assert file.socket_path.read_text() == "precious"

    asyncio.run(scenario())


def test_a_port_that_is_taken_is_said_so(tmp_path: Path) -> None:
    async def scenario() -> None:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            port = taken.getsockname()[1]
            with pytest.raises(ConfigError, match=rf"api.http: 127.0.0.1:{port}: Address already in use"):
                async with at_work(tmp_path, Control(), LINE + f'[api]\nhttp = "127.0.0.1:{port}"\n'):
                    pytest.fail("two at one port")

    asyncio.run(scenario())
