"""``tilefab line``: runs a factory line, shows how it is doing, and gives it orders."""

from __future__ import annotations

import dataclasses
import json
import time
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from tilefab.cli.common import JsonOption, print_json
from tilefab.cli.line_view import status_view
from tilefab.cli.progress import Bars
from tilefab.config import LineFile, load_job, load_line
from tilefab.control.ledger import MOST_FACES, ArmState
from tilefab.errors import ConfigError, DeviceError, InterlockError, Problem, TilefabError
from tilefab.web.client import LineClient
from tilefab.web.token import read_token

_WATCH_PERIOD_S = 0.5

app = typer.Typer(help="A factory line: run it, look at it, give it orders.", no_args_is_help=True)

LineOption = Annotated[
    Path, typer.Option("--line", envvar="TILEFAB_LINE", metavar="LINE", help="The line's file (TOML).")
]
TokenOption = Annotated[
    Path | None,
    typer.Option(
        "--token-file",
        envvar="TILEFAB_LINE_TOKEN_FILE",
        metavar="FILE",
        help="File of the token that orders need. [default: the line's own]",
    ),
]
FaceArgument = Annotated[int, typer.Argument(metavar="FACE", min=0, max=MOST_FACES - 1, help="Number of the face.")]
RunOption = Annotated[
    int | None, typer.Option("--run", metavar="N", min=1, help="Number of the run, as `line status` shows it.")
]
_LINE = Path("line.toml")


class Settled(StrEnum):
    """What became of a face that was in doubt."""

    PASSED = ArmState.PASSED.value
    DIVERTED = ArmState.DIVERTED.value
    UNPRINTED = ArmState.UNPRINTED.value


@app.command("run")
def run(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="[JOB]... LINE", help="Job files, printed in this order, if any, and last the line's file (TOML)."
        ),
    ],
) -> None:
    """Run a line until it is interrupted. Nothing moves before an operator says `tilefab line start`."""
    # Of all commands only this one needs the journal, the devices' libraries and a web server.
    from tilefab.pipeline.line.service import serve_line
    from tilefab.web.api import serve_api

    with Bars() as bars:
        serve_line(files[:-1], files[-1], bars, open_api=serve_api)


@app.command("status")
def status(
    line: LineOption = _LINE,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Go on showing it, until interrupted.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show state, alarms, job, belt, ink, kiln, devices and the last faces of a line."""
    client = _client(load_line(line))
    if as_json:
        _print_statuses(client, watch)
        return
    console = Console()
    if not watch:
        console.print(status_view(client.status(), datetime.now(UTC), width=console.width))
        return
    with suppress(KeyboardInterrupt), Live(console=console, auto_refresh=False, screen=console.is_terminal) as live:
        while True:
            try:
                view = status_view(client.status(), datetime.now(UTC), width=console.width)
            except DeviceError as error:
                # A daemon may be restarted while somebody watches.
                view = Text(error.message, style="bold red")
            live.update(view, refresh=True)
            time.sleep(_WATCH_PERIOD_S)


@app.command("start")
def start(line: LineOption = _LINE, token: TokenOption = None) -> None:
    """Begin to print the first job of the queue."""
    _order(line, token, "start")


@app.command("hold")
def hold(line: LineOption = _LINE, token: TokenOption = None) -> None:
    """Stop the belt at once and keep everything as it is."""
    _order(line, token, "hold")


@app.command("resume")
def resume(line: LineOption = _LINE, token: TokenOption = None) -> None:
    """Go on from a hold, once its alarms are acknowledged."""
    _order(line, token, "resume")


@app.command("stop")
def stop(line: LineOption = _LINE, token: TokenOption = None) -> None:
    """Feed no further tile, bring those with a face through, and stop."""
    _order(line, token, "stop")


@app.command("ack")
def ack(
    line: LineOption = _LINE,
    token: TokenOption = None,
    up_to: Annotated[
        int | None, typer.Option("--up-to", metavar="NO", min=0, help="Number of the newest alarm to acknowledge.")
    ] = None,
) -> None:
    """Acknowledge the alarms that are up, and show them; ones that come later are not covered."""
    client = _trusted_client(line, token)
    seen = client.status()
    last = seen.last_alarm if up_to is None else min(up_to, seen.last_alarm)
    for alarm in seen.alarms:
        if alarm.number <= last and not alarm.acked:
            typer.echo(f"{alarm.number} {alarm.code}: {alarm.message}")
    typer.echo(client.command("ack", {"up_to": last}))


@app.command("queue")
def queue(
    job: Annotated[Path, typer.Argument(metavar="JOB", help="Job file (TOML).")],
    line: LineOption = _LINE,
    token: TokenOption = None,
) -> None:
    """Prepare a job and print it after those that wait already."""
    load_job(job)
    _order(line, token, "queue", job=str(job.absolute()))


@app.command("reprint")
def reprint(face: FaceArgument, run_id: RunOption = None, line: LineOption = _LINE, token: TokenOption = None) -> None:
    """Print a face of the present job, or of another run, once more."""
    _order(line, token, "reprint", face=face, **_named(run_id))


@app.command("settle")
def settle(
    face: FaceArgument,
    state: Annotated[Settled, typer.Argument(metavar="passed|diverted|unprinted", help="What became of it.")],
    run_id: RunOption = None,
    line: LineOption = _LINE,
    token: TokenOption = None,
) -> None:
    """Say what became of a face that is in doubt; an unprinted one is printed again."""
    _order(line, token, "settle", face=face, state=state.value, **_named(run_id))


@app.command("correct")
def correct(
    state: Annotated[Path, typer.Argument(metavar="STATE.json", help="Drift state, from `tilefab profile drift`.")],
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="Why; goes into log, journal and reports.")],
    line: LineOption = _LINE,
    token: TokenOption = None,
) -> None:
    """Print the coming faces of the present job for a press that has drifted so: their colours stay."""
    from tilefab.io.drift_file import drift_text, read_drift_file  # slow to import, with NumPy

    drift, _ = read_drift_file(state)
    client = _trusted_client(line, token)
    run_id = client.status().run_id
    if run_id is None:
        raise InterlockError("no job is open: there is nothing to correct", device="line")
    number = client.correct(run_id, json.loads(drift_text(drift)), reason)
    typer.echo(f"correction {number} of run {run_id} is in use: faces that aren't put down yet are printed with it")


@app.command("check")
def check(
    line: Annotated[Path, typer.Argument(metavar="LINE", help="The line's file (TOML).")] = _LINE,
    as_json: JsonOption = False,
) -> None:
    """Check a line's file; print what it says, or every problem at once."""
    try:
        file = load_line(line)
        problems = _endpoint_problems(file)
        if problems:
            raise ConfigError(problems)
    except TilefabError as error:
        if not as_json:
            raise
        found = error.problems if isinstance(error, ConfigError) else [Problem(str(line), None, "", error.message)]
        print_json({"valid": False, "problems": [dataclasses.asdict(problem) for problem in found]})
        raise typer.Exit(error.exit_code) from error
    facts = {
        "valid": True,
        **file.line.model_dump(mode="json"),
        "paths": {
            "state": str(file.state_directory),
            "socket": str(file.socket_path),
            "token": str(file.token_path),
            "log": str(file.log_path),
        },
    }
    if as_json:
        print_json(facts)
    else:
        typer.echo(f"{line}: in order; recipes: {', '.join(file.line.recipes)}; state in {file.state_directory}")


def _named(run_id: int | None) -> dict[str, object]:
    return {} if run_id is None else {"run": run_id}


def _print_statuses(client: LineClient, watch: bool) -> None:
    """Print a status as JSON, or with ``watch`` one a line for as long as somebody reads them."""
    if not watch:
        print_json(client.status().to_json())
        return
    with suppress(KeyboardInterrupt):
        while True:
            typer.echo(json.dumps(client.status().to_json(), ensure_ascii=False))
            time.sleep(_WATCH_PERIOD_S)


def _client(file: LineFile, token: str = "") -> LineClient:
    return LineClient(file.socket_path, token)


def _trusted_client(line: Path, token_file: Path | None) -> LineClient:
    """A client that may give orders."""
    file = load_line(line)
    try:
        token = read_token(token_file if token_file is not None else file.token_path)
    except ConfigError:
        # Without a daemon that is what is wrong, not a token that it would have made.
        _client(file).status()
        raise
    return _client(file, token)


def _order(line: Path, token_file: Path | None, name: str, **arguments: object) -> None:
    typer.echo(_trusted_client(line, token_file).command(name, arguments))


def _endpoint_problems(file: LineFile) -> list[Problem]:
    """Endpoints that are no such, beyond what their model sees."""
    from tilefab.devices import parse_endpoint  # slow to import, with the libraries of the devices

    line = file.line
    endpoints = [
        ("plc", "endpoint", line.plc.endpoint),
        ("printer", "control", line.printer.control),
        ("printer", "data", line.printer.data),
    ]
    endpoints += [("kiln", "endpoint", line.kiln.endpoint)] if line.kiln is not None else []
    endpoints += [("gauge", "endpoint", line.gauge.endpoint)] if line.gauge is not None else []
    problems = []
    for section, key, text in endpoints:
        try:
            parse_endpoint(text)
        except DeviceError as error:
            problems.append(file.problem(section, key, error.message.removeprefix("endpoint: ")))
    return problems
