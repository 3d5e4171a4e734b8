"""The API of a line's daemon: anybody may look, only who has the token may order.

========  =====================  =====  ==================================================================
method    path                   token  answer
========  =====================  =====  ==================================================================
GET       /v1/status             no     a `tilefab.pipeline.line.status.LineStatus`
GET       /v1/alarms             no     ``{"alarms": [...]}``: those that are up, oldest first
GET       /v1/faces?last=N       no     ``{"faces": [...]}``: the latest attempts, newest first; N is 1 to 200
GET       /v1/corrections?run=N  no     ``{"run_id": N, "corrections": [...]}``: a run's, in order
GET       /metrics               no     Prometheus' text format
POST      /v1/commands           yes    ``{"done": "..."}``; asked with ``{"command": NAME, ...its arguments}``
POST      /v1/corrections        yes    ``{"number": N}``; asked with ``{"run_id", "drift", "reason"}``
POST      /v1/warnings           yes    ``{"done": "..."}``; asked with ``{"code", "text"}``
========  =====================  =====  ==================================================================

Every error is ``{"error": "..."}`` with 400 (asked wrongly), 401 (no token), 403 (wrong token), 404, 405, 413 (too
long) or 409: the line can't do so now, with ``exit_code`` as the command line has it.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

from aiohttp import hdrs, web

from tilefab.config.line import LineFile
from tilefab.errors import ConfigError, TilefabError
from tilefab.pipeline.line.log import LineLog
from tilefab.pipeline.line.metrics import CONTENT_TYPE
from tilefab.pipeline.line.orders import (
    MOST_FACES_TOLD,
    LineControl,
    check_correction,
    check_order,
    check_warning,
)
from tilefab.web.token import make_token, same_token

_LARGEST_BODY = 16 << 10
_LARGEST_CORRECTION = 2 << 20
"""A drift state of 8 inks with its covariance is half a megabyte."""
_BODY_TIMEOUT_S = 5.0
_KEEPALIVE_S = 15.0
_SHUTDOWN_S = 1.0
_LINGERING_S = 0.5
_MOST_CONNECTIONS = 32
"""On each of socket and HTTP: whoever forgets to close his can't take the descriptors that the devices need."""
_REFUSALS_LOGGED_S = 1.0
_BACKLOG = 8
"""Connections taken in one go: those just taken don't count yet, so that twice as many may be open in the end."""
_SOCKET_MODE = 0o660

_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
_Asked = TypeVar("_Asked")


class LineApi:
    """Answers requests.

    Parameters
    ----------
    control
        The line.
    token
        That orders need.
    log
        Every order, and who was refused one.
    allow_remote
        Whether HTTP requests may name this machine by any name.
    """

    def __init__(self, control: LineControl, token: str, log: LineLog, *, allow_remote: bool = False) -> None:
        self._control, self._token, self._log, self._allow_remote = control, token, log, allow_remote
        self._refused = 0
        self._refusal_logged_s = float("-inf")
        log.hide(token)
        self.app = web.Application(client_max_size=_LARGEST_BODY, middlewares=[self._guard])
        self.app.router.add_get("/v1/status", self._status)
        self.app.router.add_get("/v1/alarms", self._alarms)
        self.app.router.add_get("/v1/faces", self._faces)
        self.app.router.add_get("/v1/corrections", self._corrections)
        self.app.router.add_get("/metrics", self._metrics)
        self.app.router.add_post("/v1/commands", self._command)
        self.app.router.add_post("/v1/corrections", self._correct)
        self.app.router.add_post("/v1/warnings", self._warn)

    async def _status(self, _: web.Request) -> web.Response:
        return _json(self._control.status().to_json())

    async def _alarms(self, _: web.Request) -> web.Response:
        return _json({"alarms": [asdict(alarm) for alarm in self._control.alarms()]})

    async def _faces(self, request: web.Request) -> web.Response:
        text = request.query.get("last", "50")
        if not (text.isascii() and text.isdigit() and len(text) <= 4 and 1 <= int(text) <= MOST_FACES_TOLD):
            return _error(400, f"last must be a whole number from 1 to {MOST_FACES_TOLD}")
        return _json({"faces": [asdict(face) for face in await self._control.faces(int(text))]})

    async def _metrics(self, _: web.Request) -> web.Response:
        return web.Response(body=self._control.metrics(), headers={hdrs.CONTENT_TYPE: CONTENT_TYPE})

    async def _corrections(self, request: web.Request) -> web.Response:
        text = request.query.get("run")
        if text is not None and not (text.isascii() and text.isdigit() and len(text) <= 9 and int(text) >= 1):
            return _error(400, "run must be the number of a run")
        run_id, found = await self._control.corrections(None if text is None else int(text))
        return _json({"run_id": run_id, "corrections": [asdict(correction) for correction in found]})

    async def _command(self, request: web.Request) -> web.Response:
        asked = await self._asked(request, _checked_order)
        if isinstance(asked, web.Response):
            return asked
        name, arguments = asked
        facts = {"command": name, "arguments": arguments, "via": _via(request)}
        try:
            done = await self._control.command(name, arguments)
        except TilefabError as error:
            self._log("order refused", **facts, why=error.message)
            return _error(409, error.message, exit_code=error.exit_code)
        self._log("order", **facts, done=done)
        return _json({"done": done})

    async def _correct(self, request: web.Request) -> web.Response:
        asked = await self._asked(request, check_correction, _LARGEST_CORRECTION)
        if isinstance(asked, web.Response):
            return asked
        run_id, drift, reason = asked
        facts = {"run_id": run_id, "reason": reason, "via": _via(request)}
        try:
            number = await self._control.correct(run_id, drift, reason)
        except TilefabError as error:
            self._log("correction refused", **facts, why=error.message)
            return _error(409, error.message, exit_code=error.exit_code)
        return _json({"number": number})

    async def _warn(self, request: web.Request) -> web.Response:
        asked = await self._asked(request, check_warning)
        if isinstance(asked, web.Response):
            return asked
        code, text = asked
        self._control.warn(code, text)
        return _json({"done": f"{code} is up"})

    async def _asked(
        self, request: web.Request, check: Callable[[object], _Asked], largest: int = _LARGEST_BODY
    ) -> _Asked | web.Response:
        """What somebody with the token asks for, or the answer to whoever hasn't it, or asks wrongly."""
        # Before anything of the body is read.
        refusal = self._unauthorised(request)
        if refusal is not None:
            return refusal
        try:
            async with asyncio.timeout(_BODY_TIMEOUT_S):
                body = await request.clone(client_max_size=largest).read()
            return check(json.loads(body))
        except TimeoutError:
            return _error(400, "the request came too slowly")
        except (ValueError, RecursionError) as error:
            return _error(400, str(error) or "not JSON")

    def _unauthorised(self, request: web.Request) -> web.Response | None:
        scheme, _, given = request.headers.get(hdrs.AUTHORIZATION, "").partition(" ")
        if scheme.lower() != "bearer" or not given.strip():
            response = _error(401, "orders need the line's token: Authorization: Bearer TOKEN")
            response.headers[hdrs.WWW_AUTHENTICATE] = "Bearer"
        elif not same_token(given.strip(), self._token):
            response = _error(403, "this isn't the line's token")
        else:
            return None
        self._refused += 1
        now_s = time.monotonic()
        # Whoever tries in a loop must not fill the log.
        if now_s - self._refusal_logged_s >= _REFUSALS_LOGGED_S:
            self._log("order without right", via=_via(request), status=response.status, times=self._refused)
            self._refusal_logged_s, self._refused = now_s, 0
        return response

    @web.middleware
    async def _guard(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        if not self._allow_remote and _via(request) != "socket" and not _is_loopback(request.headers.get("Host", "")):
            # A page in somebody's browser whose name was made to point here.
            return _error(403, "ask by the address 127.0.0.1")
        try:
            response = await handler(request)
        except web.HTTPException as error:
            response = _error(error.status, error.reason, headers=error.headers)
        except TilefabError as error:
            response = _error(409, error.message, exit_code=error.exit_code)
        except Exception as error:  # a defect here must not end a daemon that moves tiles
            self._log("defect", where=request.path, error=f"{type(error).__name__}: {error}")
            response = _error(500, "a defect of tilefab; the daemon's log says more")
        response.headers["Cache-Control"] = "no-store"
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response


@asynccontextmanager
async def serve_api(control: LineControl, line_file: LineFile, log: LineLog) -> AsyncIterator[None]:
    """Answer requests at a line's socket, and at its HTTP address if it has one, while the context lasts.

    Raises
    ------
    ConfigError
        If the token can't be used, or the socket or the address can't be had.
    """
    line_file.state_directory.mkdir(parents=True, exist_ok=True)
    settings = line_file.line.api
    api = LineApi(control, make_token(line_file.token_path), log, allow_remote=settings.allow_remote)
    # The library's own log would show requests as they came.
    silent = logging.Logger("tilefab.web", level=logging.CRITICAL + 1)
    runner = web.AppRunner(
        api.app,
        access_log=None,
        logger=silent,
        keepalive_timeout=_KEEPALIVE_S,
        shutdown_timeout=_SHUTDOWN_S,
        lingering_time=_LINGERING_S,
        auto_decompress=False,
    )
    listeners: list[asyncio.Server] = []
    await runner.setup()
    try:
        try:
            listeners.append(await _listen(runner, _bound_socket(line_file.socket_path)))
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError([line_file.problem("api", "socket", f"{line_file.socket_path}: {reason}")]) from error
        if settings.http_address is not None:
            try:
                listeners.append(await _listen(runner, _bound_port(*settings.http_address)))
            except OSError as error:
                reason = error.strerror or str(error)
                raise ConfigError([line_file.problem("api", "http", f"{settings.http}: {reason}")]) from error
        yield
    finally:
        if listeners:
            line_file.socket_path.unlink(missing_ok=True)
        for listener in listeners:
            listener.close()
        await runner.cleanup()


async def _listen(runner: web.AppRunner, bound: socket.socket) -> asyncio.Server:
    server = runner.server
    if server is None:
        raise ValueError("the runner isn't set up")
    own: set[asyncio.BaseProtocol] = set()

    def protocol() -> asyncio.BaseProtocol:
        own.intersection_update(server.connections)
        if len(own) >= _MOST_CONNECTIONS:
            return _Full()
        made = server()
        own.add(made)
        return made

    try:
        return await asyncio.get_running_loop().create_server(protocol, sock=bound, backlog=_BACKLOG)
    except BaseException:
        bound.close()
        raise


class _Full(asyncio.Protocol):
    """Hangs up."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


def _bound_socket(path: Path) -> socket.socket:
    """A Unix socket for its owner and group; one that a dead daemon left is replaced."""
    with suppress(FileNotFoundError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.settimeout(1.0)
            probe.connect(str(path))
        except ConnectionRefusedError:
            if path.is_socket():
                path.unlink()
        else:
            raise OSError("another daemon answers there")
    bound = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        bound.bind(str(path))
        # Nobody can connect before it listens.
        path.chmod(_SOCKET_MODE)
    except BaseException:
        bound.close()
        raise
    return bound


def _bound_port(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except BaseException:
        bound.close()
        raise
    return bound


def _via(request: web.Request) -> str:
    """How a request came: ``socket``, or the address of who asked."""
    transport = request.transport
    place = transport.get_extra_info("sockname") if transport is not None else None
    return str(request.remote) if isinstance(place, tuple) else "socket"


def _is_loopback(host: str) -> bool:
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name.strip("[]")).is_loopback
    except ValueError:
        return False


def _checked_order(value: object) -> tuple[str, dict[str, object]]:
    if not isinstance(value, dict) or not isinstance(name := value.pop("command", None), str):
        raise ValueError('give a JSON object with a "command"')  # noqa: TRY004 - wrong data, not a wrong call
    return name, check_order(name, value)


def _json(value: Mapping[str, object]) -> web.Response:
    return web.json_response(value)


def _error(status: int, message: str, *, headers: Mapping[str, str] | None = None, **facts: object) -> web.Response:
    response = web.json_response({"error": message, **facts}, status=status)
    allow = headers.get(hdrs.ALLOW) if headers is not None else None
    if allow:
        response.headers[hdrs.ALLOW] = allow
    return response
