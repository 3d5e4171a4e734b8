"""Line files: every problem at once, each with its line; nothing but a line or a ConfigError ever comes out."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from tilefab.config import LineFile, load_line
from tilefab.config.reference import line_reference
from tilefab.control.ramp import RampLimits
from tilefab.errors import ConfigError, Problem

ROOT = Path(__file__).parents[3]

VALID = """\
schema_version = 1

[line]
name = "line 1"
state_directory = "state"
stream_strip_rows = 128

[plc]
endpoint = "modbus-rtu:///dev/ttyS0?baud=19200&unit=1"

[printer]
control = "serial:///dev/ttyUSB0?baud=921600"
data = "tcp://10.0.0.7:9100"

[kiln]
endpoint = "modbus-tcp://10.0.0.8:502?unit=2"
lowest_degc = 100
highest_degc = 1200
ramp_degc_min = 2.5
tolerance_degc = 3

[gauge]
endpoint = "serial:///dev/ttyUSB1?baud=9600"

[journal]
url = "postgresql+psycopg://tilefab@db.plant/lines"

[api]
socket = "run/line.sock"
http = "127.0.0.1:8765"
token_file = "secret/token"

[recipes.default]
belt_speed_mm_s = 500
tile_gap_mm = 150

[recipes."600 x 600"]
belt_speed_mm_s = 2200.5
tile_gap_mm = 60
kiln_set_points_degc = [450, 780, 960, 1080, 1160, 1195, 1195, 1150]
cycle_min = 48
"""

LEAST = """\
[line]
name = "a"
[plc]
endpoint = "modbus-tcp://127.0.0.1:502"
[printer]
control = "serial:///dev/ttyUSB0"
data = "tcp://127.0.0.1:9100"
[recipes.default]
belt_speed_mm_s = 500
tile_gap_mm = 150
"""


def swap(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, (old, text.count(old))
    return text.replace(old, new)


def line_of(text: str, start: str) -> int:
    (found,) = [number for number, line in enumerate(text.split("\n"), start=1) if line.startswith(start)]
    return found


def load(folder: Path, text: str) -> LineFile:
    path = folder / "line.toml"
    path.write_text(text)
    return load_line(path)


def problems_of(folder: Path, text: str) -> list[Problem]:
    with pytest.raises(ConfigError) as caught:
        load(folder, text)
    return caught.value.problems


def only(folder: Path, text: str) -> Problem:
    (problem,) = problems_of(folder, text)
    return problem


def test_every_setting_arrives(tmp_path: Path) -> None:
    file = load(tmp_path, VALID)
    line = file.line
    assert (file.name, line.line.stream_strip_rows) == ("line 1", 128)
    assert line.plc.endpoint == "modbus-rtu:///dev/ttyS0?baud=19200&unit=1"
    assert (line.printer.control, line.printer.data) == ("serial:///dev/ttyUSB0?baud=921600", "tcp://10.0.0.7:9100")
    assert line.kiln is not None
    assert (line.kiln.limits, line.kiln.tolerance_degc) == (RampLimits(100, 1200, 2.5), 3.0)
    assert line.gauge is not None
    assert line.gauge.endpoint == "serial:///dev/ttyUSB1?baud=9600"
    assert file.journal_url == "postgresql+psycopg://tilefab@db.plant/lines"
    assert line.api.http_address == ("127.0.0.1", 8765)
    assert list(line.recipes) == ["default", "600 x 600"]
    recipe = line.recipes["600 x 600"]
    assert (recipe.belt_speed_mm_s, recipe.tile_gap_mm, recipe.cycle_min) == (2200.5, 60.0, 48.0)
    assert recipe.kiln_set_points_degc == [450, 780, 960, 1080, 1160, 1195, 1195, 1150]
    assert file.state_directory == tmp_path / "state"
    assert file.socket_path == tmp_path / "run/line.sock"
    assert file.token_path == tmp_path / "secret/token"
    assert file.log_path == tmp_path / "state/line.log"


def test_all_but_the_least_has_a_default(tmp_path: Path) -> None:
    file = load(tmp_path, LEAST)
    line = file.line
    assert (line.kiln, line.gauge, line.api.http, line.api.http_address) == (None, None, None, None)
    assert (line.line.state_directory, line.line.stream_strip_rows) == ("line_state", 64)
    assert file.journal_url == f"sqlite:///{tmp_path}/line_state/journal.db"
    assert file.socket_path == tmp_path / "line_state/line.sock"
    assert file.token_path == tmp_path / "line_state/token"


def test_a_line_can_t_be_changed_once_read(tmp_path: Path) -> None:
    file = load(tmp_path, LEAST)
    with pytest.raises(ValidationError):
        file.line.plc.endpoint = "tcp://elsewhere:1"  # type: ignore[misc]


@pytest.mark.parametrize("state", ["/var/lib/tilefab", "~/state"])
def test_paths_may_be_whole_or_start_at_home(tmp_path: Path, state: str) -> None:
    file = load(tmp_path, swap(LEAST, 'name = "a"', f'name = "a"\nstate_directory = "{state}"'))
    assert file.state_directory == Path(state).expanduser()


def test_home_of_nobody_is_a_name_like_any_other(tmp_path: Path) -> None:
    file = load(tmp_path, swap(LEAST, 'name = "a"', 'name = "a"\nstate_directory = "~nobody-at-all/x"'))
    assert file.state_directory == tmp_path / "~nobody-at-all/x"


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "words"),
    [
        ('name = "line 1"', 'name = "line/1"', "name", "line.name", "'line/1' is not allowed. Name of the line"),
        ("stream_strip_rows = 128", "stream_strip_rows = 0", "stream_strip_rows", "line.stream_strip_rows", "0 is not"),
        ('"modbus-rtu:///dev', '"serial:///dev', "endpoint", "plc.endpoint", "modbus-tcp://HOST:PORT?unit=N"),
        ('"tcp://10', '"udp://10', "data", "printer.data", "is not allowed. Where it takes faces"),
        ("lowest_degc = 100", "lowest_degc = 1200", "lowest_degc", "kiln.lowest_degc", "must be below highest_degc"),
        (
            "ramp_degc_min = 2.5",
            "ramp_degc_min = 16",
            "ramp_degc_min",
            "kiln.ramp_degc_min",
            "less than or equal to 15",
        ),
        ("tilefab@db", "tilefab:hush@db", "url", "journal.url", "take the password out"),
        ('"postgresql+psycopg:', '"mysql:', "url", "journal.url", "is not allowed"),
        ('"127.0.0.1:8765"', '"127.0.0.1"', "http", "api.http", "write it as 127.0.0.1:8765"),
        ('"127.0.0.1:8765"', '"127.0.0.1:0"', "http", "api.http", "write it as 127.0.0.1:8765"),
        ('"127.0.0.1:8765"', '"127.0.0.1:65536"', "http", "api.http", "write it as 127.0.0.1:8765"),
        ('"127.0.0.1:8765"', '"localhost:8765"', "http", "api.http", "is no number of a host"),
        ('"127.0.0.1:8765"', '"0.0.0.0:8765"', "http", "api.http", "can be reached from other machines"),
        ('"127.0.0.1:8765"', '"[::]:8765"', "http", "api.http", "can be reached from other machines"),
        ("cycle_min = 48", "cycle_min = 76", "cycle_min", "recipes.600 x 600.cycle_min", "less than or equal to 75"),
        (", 1150]", "]", "kiln_set_points_degc", "recipes.600 x 600.kiln_set_points_degc", "at least 8 items"),
        (
            ", 1150]",
            ", 2000]",
            "kiln_set_points_degc",
            "recipes.600 x 600.kiln_set_points_degc",
            "2000 (item 8) is not allowed",
        ),
        (
            ", 1150]",
            ", 1201]",
            "kiln_set_points_degc",
            "recipes.600 x 600.kiln_set_points_degc",
            "zone 8: 1201 °C is outside 100 .. 1200 °C, the limits in [kiln]",
        ),
        ("cycle_min = 48", "cycle = 48", "cycle", "recipes.600 x 600.cycle", "did you mean cycle_min?"),
        ("schema_version = 1", "schema_version = 2", "schema_version", "schema_version", "2 is not allowed"),
    ],
)
def test_a_wrong_value_is_named_with_its_line(
    tmp_path: Path, old: str, new: str, line: str, key: str, words: str
) -> None:
    text = swap(VALID, old, new)
    problem = only(tmp_path, text)
    assert problem.key == key
    assert words in problem.message
    wanted = [number for number, row in enumerate(text.split("\n"), start=1) if row.startswith(line)]
    assert problem.line in wanted
    assert text.split("\n")[problem.line - 1].partition(" ")[0] == line


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    problems = problems_of(tmp_path, '[line]\nname = "a"\n[recipes.default]\ntile_gap_mm = 20\n')
    assert [str(problem).partition(": ")[2] for problem in problems] == [
        "recipes.default.belt_speed_mm_s: missing: Speed of the belt, mm/s.",
        "plc: missing: the line needs a section [plc]",
        "printer: missing: the line needs a section [printer]",
    ]
    without = LEAST[: LEAST.index("[recipes")]
    assert only(tmp_path, without).message == "missing: the line needs a section [recipes.NAME]"


def test_a_recipe_can_t_ask_for_a_kiln_that_isn_t_there(tmp_path: Path) -> None:
    for key, value in (("cycle_min", "50"), ("kiln_set_points_degc", "[500, 500, 500, 500, 500, 500, 500, 500]")):
        problem = only(tmp_path, f"{LEAST}{key} = {value}\n")
        assert (problem.key, problem.line) == (f"recipes.default.{key}", LEAST.count("\n") + 1)
        assert problem.message == "the line has no [kiln] to bring there"


def test_an_unfit_name_of_a_recipe_is_a_problem(tmp_path: Path) -> None:
    text = swap(LEAST, "[recipes.default]", '[recipes."a/b"]')
    problem = only(tmp_path, text)
    assert "a/b" in str(problem)
    assert problem.line == line_of(text, "[recipes")


def test_other_machines_are_let_in_only_by_name(tmp_path: Path) -> None:
    text = swap(VALID, 'http = "127.0.0.1:8765"', 'http = "10.0.0.1:80"\nallow_remote = true')
    assert load(tmp_path, text).line.api.http_address == ("10.0.0.1", 80)
    text = swap(VALID, '"127.0.0.1:8765"', '"[::1]:80"')
    assert load(tmp_path, text).line.api.http_address == ("::1", 80)


def test_a_socket_s_name_may_not_be_too_long(tmp_path: Path) -> None:
    room = 107 - len(f"{tmp_path}/")
    fits = swap(VALID, "run/line.sock", "s" * room)
    assert len(str(load(tmp_path, fits).socket_path)) == 107
    problem = only(tmp_path, swap(VALID, "run/line.sock", "s" * (room + 1)))
    assert (problem.key, problem.line) == ("api.socket", line_of(VALID, "socket"))
    assert "108 bytes" in problem.message


def test_a_problem_found_later_gets_its_line_too(tmp_path: Path) -> None:
    file = load(tmp_path, VALID)
    assert str(file.problem("printer", "data", "x")) == (
        f"{tmp_path / 'line.toml'}:{line_of(VALID, 'data')}: printer.data: x"
    )
    assert file.problem("printer", "absent", "x").line == line_of(VALID, "[printer]")


def test_a_picture_in_place_of_a_line_is_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "line.toml"
    path.write_bytes(b"#" * ((1 << 20) + 1))
    with pytest.raises(ConfigError, match="larger than 1 MiB: not a line file"):
        load_line(path)


def test_the_example_is_in_order() -> None:
    file = load_line(ROOT / "jobs/line.toml")
    assert "default" in file.line.recipes


def test_the_reference_is_made_from_the_models() -> None:
    assert (ROOT / "docs/line_files.md").read_text() == line_reference()


@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)
def test_any_change_of_bytes_gives_a_line_or_problems(tmp_path: Path, data: st.DataObject) -> None:
    raw = VALID.encode()
    start = data.draw(st.integers(0, len(raw)))
    length = data.draw(st.integers(0, 30))
    path = tmp_path / "line.toml"
    path.write_bytes(raw[:start] + data.draw(st.binary(max_size=20)) + raw[start + length :])
    found: list[Problem] = []
    try:
        load_line(path)
    except ConfigError as error:
        found = error.problems or [Problem("", None, "", "")]
    assert all(problem.message for problem in found)
