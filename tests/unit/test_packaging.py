"""The service's file against the commands and the daemon's habits."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from tilefab.cli.main import app
from tilefab.errors import ConfigError
from tilefab.pipeline.line.watchdog import Watchdog

UNIT = Path(__file__).parents[2] / "packaging" / "tilefab-line@.service"
INSPECTOR = UNIT.with_name("tilefab-inspect@.service")


def settings(unit: Path = UNIT) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in re.findall(r"^([A-Za-z]+)=(.*)$", unit.read_text(encoding="utf-8"), re.MULTILINE):
        found.setdefault(name, []).append(value)
    return found


@pytest.mark.parametrize("jobs", [[], ["/srv/tilefab/a.toml", "/srv/tilefab/b.toml"]])
def test_its_command_is_one_that_exists(jobs: list[str]) -> None:
    program, *words = settings()["ExecStart"][0].replace("$JOBS", " ".join(jobs)).replace("%i", "line1").split()
    assert Path(program).name == "tilefab"
    command = typer.main.get_command(app)
    for _ in range(2):
        command = command.commands[words.pop(0)]  # type: ignore[attr-defined]
    context = command.make_context("run", words)
    assert [str(path) for path in context.params["files"]] == [*jobs, "/etc/tilefab/line1.toml"]


def test_the_inspector_has_a_unit_of_its_own() -> None:
    program, *words = settings(INSPECTOR)["ExecStart"][0].replace("%i", "line1").split()
    assert Path(program).name == "tilefab"
    command = typer.main.get_command(app).commands["line"].commands["inspect"]  # type: ignore[attr-defined]
    assert words[:2] == ["line", "inspect"]
    context = command.make_context("inspect", words[2:])
    assert str(context.params["line"]) == "/etc/tilefab/line1.toml"
    found = settings(INSPECTOR)
    assert found["StateDirectory"] == settings()["StateDirectory"], "it keeps its store beside the journal"
    assert int(found["Nice"][0]) > int(settings()["Nice"][0])


def test_systemd_watches_it_as_the_daemon_expects() -> None:
    found = settings()
    assert found["Type"] == ["notify"]
    assert found["Restart"] == ["on-failure"]
    limit_s = int(found["WatchdogSec"][0])
    assert limit_s == 10
    now_s = [0.0]
    with Watchdog(["a"], environ={"WATCHDOG_USEC": str(limit_s * 1_000_000)}, now_s=lambda: now_s[0]) as watchdog:
        now_s[0] = limit_s / 3
        watchdog.went_round("a")
        assert watchdog._fed_s == now_s[0], "fed at least twice within the limit"


@pytest.mark.parametrize("unit", [UNIT, INSPECTOR])
def test_what_another_start_wont_change_isnt_started_again(unit: Path) -> None:
    assert str(ConfigError.exit_code) in settings(unit)["RestartPreventExitStatus"][0].split()


@pytest.mark.parametrize("unit", [UNIT, INSPECTOR])
def test_it_may_reach_nothing_but_what_it_needs(unit: Path) -> None:
    found = settings(unit)
    for name, value in (
        ("NoNewPrivileges", "yes"),
        ("CapabilityBoundingSet", ""),
        ("ProtectSystem", "strict"),
        ("ProtectHome", "yes"),
        ("PrivateTmp", "yes"),
        ("DevicePolicy", "closed"),
        ("RestrictAddressFamilies", "AF_UNIX AF_INET AF_INET6"),
        ("SystemCallFilter", "@system-service"),
        ("User", "tilefab"),
    ):
        assert found[name] == [value]
