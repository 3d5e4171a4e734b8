"""Talks to a line's daemon over its Unix socket, for the commands."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Mapping
from pathlib import Path

from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout
from tilefab.pipeline.line.status import LineStatus

_DEVICE = "daemon"
_LARGEST_ANSWER = 4 << 20
_LOOK_TIMEOUT_S = 3.0
_ORDER_TIMEOUT_S = 15.0
_MAPS_TIMEOUT_S = 3600.0
"""A queued job is prepared, and a correction's map made, before the daemon answers."""


class OrderRefusedError(DeviceRefused):
    """The line can't do so now.

    Parameters
    ----------
    message
        The daemon's words.
    exit_code
        That the error has there.
    """

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message, device=_DEVICE)
        self.exit_code = exit_code


class LineClient:
    """A daemon, as seen from outside.

    Parameters
    ----------
    socket_path
        Its socket.
    token
        That orders need.
    """

    def __init__(self, socket_path: Path, token: str = "") -> None:
        self._path, self._token = socket_path, token

    def status(self) -> LineStatus:
        """How the line is doing.

        Raises
        ------
        DeviceError
            If no daemon answers, or what it answers makes no sense.
        """
        try:
            return LineStatus.from_json(self._ask("GET", "/v1/status", None, _LOOK_TIMEOUT_S))
        except ValueError as error:
            message = f"{self._path}: the daemon is of another version of tilefab: {error}"
            raise DeviceProtocolError(message, device=_DEVICE) from error

    def command(self, name: str, arguments: Mapping[str, object]) -> str:
        """Give an order; what was done.

        Raises
        ------
        OrderRefusedError
            If the line can't do so now.
        DeviceError
            If no daemon answers, or it doesn't take the order from us.
        """
        timeout_s = _MAPS_TIMEOUT_S if name == "queue" else _ORDER_TIMEOUT_S
        answer = self._ask("POST", "/v1/commands", {**arguments, "command": name}, timeout_s)
        return str(answer.get("done", ""))

    def correct(self, run_id: int, drift: Mapping[str, object], reason: str) -> int:
        """Have the coming faces of the present run printed for a press that has drifted; returns once they are.

        Parameters
        ----------
        run_id
            The present run.
        drift
            The drift, as in a drift state file.
        reason
            For people.

        Returns
        -------
        int
            Number of the correction.

        Raises
        ------
        OrderRefusedError
            If the line won't do so now.
        DeviceError
            As for `command`.
        """
        value = {"run_id": run_id, "drift": drift, "reason": reason}
        answer = self._ask("POST", "/v1/corrections", value, _MAPS_TIMEOUT_S)
        if not isinstance(number := answer.get("number"), int):
            raise DeviceProtocolError(f"{self._path}: the daemon is of another version of tilefab", device=_DEVICE)
        return number

    def warn(self, code: str, text: str) -> None:
        """Raise an alarm of an inspector; see `tilefab.pipeline.line.alarms.FROM_INSPECTION`.

        Raises
        ------
        DeviceError
            As for `command`.
        """
        self._ask("POST", "/v1/warnings", {"code": code, "text": text}, _ORDER_TIMEOUT_S)

    def _ask(
        self, method: str, path: str, value: Mapping[str, object] | None, timeout_s: float
    ) -> Mapping[str, object]:
        connection = _UnixConnection(self._path, timeout_s)
        headers = {"Authorization": f"Bearer {self._token}"} if value is not None else {}
        try:
            connection.request(method, path, None if value is None else json.dumps(value), headers)
            response = connection.getresponse()
            body, code = response.read(_LARGEST_ANSWER), response.status
            if response.length:
                raise http.client.IncompleteRead(body, response.length)
        except TimeoutError as error:
            raise DeviceTimeout(f"{self._path}: the daemon doesn't answer", device=_DEVICE) from error
        except (FileNotFoundError, ConnectionRefusedError) as error:
            message = f"no daemon runs on this line ({self._path}); start it with: tilefab line run JOB LINE.toml"
            raise DeviceTimeout(message, device=_DEVICE) from error
        except PermissionError as error:
            message = f"{self._path}: this user may not talk to the daemon; ask for its group"
            raise DeviceError(message, device=_DEVICE) from error
        except (OSError, http.client.HTTPException) as error:
            raise DeviceError(f"{self._path}: the daemon hung up: {error!r}", device=_DEVICE) from error
        finally:
            connection.close()
        try:
            answer = json.loads(body)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise DeviceProtocolError(f"{self._path}: what answers there is no daemon of a line", device=_DEVICE)
        if code != http.client.OK:
            message, exit_code = str(answer.get("error", f"code {code}")), answer.get("exit_code")
            if isinstance(exit_code, int):
                raise OrderRefusedError(message, exit_code)
            raise DeviceRefused(message, device=_DEVICE, code=code)
        return answer


class _UnixConnection(http.client.HTTPConnection):
    def __init__(self, path: Path, timeout_s: float) -> None:
        super().__init__("localhost", timeout=timeout_s)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self._path))
