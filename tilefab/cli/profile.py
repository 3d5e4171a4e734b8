"""``tilefab profile``: charts, press profiles, device links, and what they are used for. A module each."""

from __future__ import annotations

import typer

from tilefab.cli.profile_apply import apply
from tilefab.cli.profile_build import build
from tilefab.cli.profile_chart import chart, read
from tilefab.cli.profile_check import check
from tilefab.cli.profile_drift import drift
from tilefab.cli.profile_link import link

app = typer.Typer(
    help="Press profiles: print and read a chart, build a profile, check it, link and apply it.", no_args_is_help=True
)


@app.callback()
def profile() -> None:
    """Press profiles: print and read a chart, build a profile, check it, link and apply it."""


app.command("chart")(chart)
app.command("read")(read)
app.command("build")(build)
app.command("check")(check)
app.command("apply")(apply)
app.command("link")(link)
app.command("drift")(drift)
