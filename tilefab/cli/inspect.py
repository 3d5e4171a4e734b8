"""``tilefab line inspect``: watches a line's camera, and closes the loop of its colours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from tilefab.config.line import LineFile
from tilefab.errors import ConfigError
from tilefab.web.client import LineClient
from tilefab.web.token import read_token


class DaemonLink:
    """The daemon of a line, by its socket; the token is read when it is needed, since the daemon makes it.

    Parameters
    ----------
    line_file
        The line.
    token_file
        File of the token, if not the line's own.
    """

    def __init__(self, line_file: LineFile, token_file: Path | None = None) -> None:
        self._socket = line_file.socket_path
        self._token = line_file.token_path if token_file is None else token_file

    def correct(self, run_id: int, drift: Mapping[str, Any], reason: str) -> int:
        """See `tilefab.pipeline.inspection.messages.Daemon`."""
        return self._client().correct(run_id, drift, reason)

    def warn(self, code: str, text: str) -> None:
        """See `tilefab.pipeline.inspection.messages.Daemon`."""
        self._client().warn(code, text)

    def _client(self) -> LineClient:
        try:
            token = read_token(self._token)
        except ConfigError:
            # Without a daemon that is what is wrong, not a token that it would have made.
            LineClient(self._socket).status()
            raise
        return LineClient(self._socket, token)


def inspect(
    line: Annotated[Path, typer.Argument(metavar="LINE", help="The line's file (TOML).")] = Path("line.toml"),
    token_file: Annotated[
        Path | None,
        typer.Option(
            "--token-file",
            envvar="TILEFAB_LINE_TOKEN_FILE",
            metavar="FILE",
            help="File of the token that corrections need. [default: the line's own]",
        ),
    ] = None,
) -> None:
    """Inspect the tiles that a line's camera sees, and correct its colours, until interrupted."""
    # Only this command needs the colour models and the devices' log.
    from tilefab.pipeline.inspection.service import serve_inspection

    serve_inspection(line, lambda line_file: DaemonLink(line_file, token_file))
