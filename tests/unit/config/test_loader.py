"""Job files: every problem at once, each with its line; nothing but a Job or a ConfigError ever comes out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from tilefab.config import Job, JobFile, load_job
from tilefab.errors import ConfigError, Problem

JOBS = Path(__file__).parents[3] / "jobs"

VALID = """\
# A comment first
schema_version = 1

[job]
name = "Gravel"

[slab]
scans = ["a.tif", "b.tif"]
dpi = 60
masks = ["m.png", ""]
trim_mm = 2.5
target_lab = [62, 3.0, -11]

[texture]
design = "tile"
map_size_mm = [50, 50]
feature_mm = 12
patches = 40
active_per_cell = 9
seed = 7

[tile]
size_mm = [20, 24.5]
dpi = 60
count = 8
layout = "continuous"
columns = 3
bleed_mm = 1

[colour]
press_profile = "demo_ceramic.icc"
intent = "relative"
ink_limit_percent = 260
ink_names = ["C", "M", "Y", "K"]

[output]
directory = "out"
bits = 16
compression = "lzw"
proofs = false

[report]
pdf = false
faces = 5
"""

LEAST = """\
[slab]
scans = ["a.tif"]
[tile]
size_mm = [200, 100]
dpi = 75
[colour]
press_profile = "demo_ceramic.icc"
[output]
directory = "out"
"""


def line_of(text: str, start: str) -> int:
    """Number of the only line that starts so."""
    found = [number for number, line in enumerate(text.split("\n"), start=1) if line.startswith(start)]
    assert len(found) == 1, (start, found)
    return found[0]


def swap(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, (old, text.count(old))
    return text.replace(old, new)


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "job.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def problems_of(folder: Path, text: str | bytes) -> list[Problem]:
    path = write(folder, text)
    with pytest.raises(ConfigError) as caught:
        load_job(path)
    error = caught.value
    assert error.problems
    assert error.exit_code == 3
    assert error.path == str(path)
    assert error.message == "\n".join(str(problem) for problem in error.problems)
    assert {problem.file for problem in error.problems} == {str(path)}
    lines = [problem.line or 10**9 for problem in error.problems]
    assert lines == sorted(lines)
    for problem in error.problems:
        assert "\n" not in str(problem)
    return error.problems


def only(folder: Path, text: str | bytes) -> Problem:
    (problem,) = problems_of(folder, text)
    return problem


def test_every_setting_arrives(tmp_path: Path) -> None:
    file = load_job(write(tmp_path, VALID))
    assert isinstance(file, JobFile)
    job = file.job
    assert job.job.name == "Gravel"
    assert job.slab.scans == ["a.tif", "b.tif"]
    assert job.slab.masks == ["m.png", ""]
    assert job.slab.target_lab == [62.0, 3.0, -11.0]
    assert (job.slab.dpi, job.slab.trim_mm) == (60.0, 2.5)
    assert job.texture.design == "tile"
    assert job.texture.map_size_mm == [50.0, 50.0]
    assert (job.texture.feature_mm, job.texture.patches, job.texture.active_per_cell, job.texture.seed) == (
        12,
        40,
        9,
        7,
    )
    assert (job.tile.size_mm, job.tile.dpi, job.tile.count) == ([20.0, 24.5], 60.0, 8)
    assert (job.tile.layout, job.tile.columns, job.tile.bleed_mm) == ("continuous", 3, 1.0)
    assert (job.colour.intent, job.colour.ink_limit_percent) == ("relative", 260.0)
    assert job.colour.ink_names == ["C", "M", "Y", "K"]
    assert (job.output.bits, job.output.compression, job.output.proofs) == (16, "lzw", False)
    assert (job.report.pdf, job.report.faces) == (False, 5)
    assert isinstance(job.slab.dpi, float)
    assert isinstance(job.tile.size_mm[0], float)


def test_all_but_the_least_has_a_default(tmp_path: Path) -> None:
    job = load_job(write(tmp_path, LEAST)).job
    assert job.schema_version == 1
    assert (job.texture.method, job.texture.patches, job.texture.active_per_cell, job.texture.seed) == (
        "quilting",
        600,
        40.0,
        0,
    )
    assert (job.texture.design, job.texture.crops, job.texture.ration) == ("crops", 1024, True)
    assert (job.texture.drop, job.texture.keep, job.slab.weights) == ([], [], None)
    assert (job.tile.count, job.tile.layout, job.tile.bleed_mm) == (1, "scatter", 0.0)
    assert (job.colour.intent, job.colour.ink_limit_percent, job.colour.ink_names) == ("perceptual", 300.0, None)
    assert (job.output.format, job.output.bits, job.output.compression, job.output.proofs) == ("tiff", 8, "none", True)
    assert (job.report.pdf, job.slab.square, job.slab.lighting, job.slab.match) == ("report.pdf", True, True, True)


def with_texture(*lines: str) -> str:
    return LEAST + "\n[texture]\n" + "".join(f"{line}\n" for line in lines)


def test_every_setting_of_crops_arrives(tmp_path: Path) -> None:
    text = with_texture("crops = 16", "ration = false", "drop = [7, 3, 7]", "keep = [1, 2, 3]", "feature_mm = 4")
    texture = load_job(write(tmp_path, text.replace("scans = [", 'weights = ["w.png"]\nscans = ['))).job.texture
    assert (texture.crops, texture.ration, texture.drop, texture.keep) == (16, False, [7, 3, 7], [1, 2, 3])


@pytest.mark.parametrize(
    "line",
    [
        "crops = 15",
        "crops = 4097",
        "drop = [1024]",
        "keep = [2, 16]\ncrops = 16",
        "keep = [3, 4]\ndrop = [4, 9, 3]",
        "drop = [-1]",
        "keep = [1.5]",
        'drop = "3"',
        'ration = "no"',
    ],
)
def test_settings_of_crops_have_limits(tmp_path: Path, line: str) -> None:
    problem = only(tmp_path, with_texture(line))
    assert problem.key == f"texture.{line.partition(' ')[0]}"


@pytest.mark.parametrize(
    ("design", "line"),
    [
        ("crops", 'method = "quilting"'),
        ("crops", "map_size_mm = [50, 50]"),
        ("crops", "patches = 600"),
        ("crops", "active_per_cell = 40"),
        ("tile", "crops = 1024"),
        ("tile", "ration = true"),
        ("tile", "drop = []"),
        ("tile", "keep = [1]"),
    ],
)
def test_a_setting_of_the_other_design_is_a_problem(tmp_path: Path, design: str, line: str) -> None:
    text = with_texture(f'design = "{design}"', line)
    problem = only(tmp_path, text)
    key = line.partition(" ")[0]
    assert (problem.key, problem.line) == (f"texture.{key}", line_of(text, key))
    assert f'this job has "{design}"' in problem.message


def test_weights_go_with_scans(tmp_path: Path) -> None:
    problem = only(tmp_path, LEAST.replace("scans = [", 'weights = ["a", "b"]\nscans = ['))
    assert problem.key == "slab.weights"
    assert "give one each" in problem.message


def test_what_was_read_can_t_change(tmp_path: Path) -> None:
    job = load_job(write(tmp_path, LEAST)).job
    with pytest.raises(ValidationError, match="frozen"):
        job.tile.count = 2


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_editors_of_windows_are_welcome(tmp_path: Path, newline: str, mark: str) -> None:
    text = mark + VALID.replace("\n", newline)
    assert load_job(write(tmp_path, text)).job.job.name == "Gravel"
    problem = only(tmp_path, swap(text, "count = 8", "count = 0"))
    assert problem.line == line_of(VALID, "count")


def test_lines_are_counted_as_editors_count_them(tmp_path: Path) -> None:
    # U+2028 and U+0085 end a line for Python's splitlines, but not for an editor.
    text = swap(VALID, "# A comment first", "# A comment\u2028first\u0085of all")
    assert only(tmp_path, swap(text, "count = 8", "count = 0")).line == line_of(VALID, "count")


def test_all_problems_come_at_once_in_order_of_their_lines(tmp_path: Path) -> None:
    text = VALID
    for old, new in (
        ('name = "Gravel"', "name = 7"),
        ("trim_mm = 2.5", "trim_mm = -1"),
        ("patches = 40", "pathces = 40"),
        ("seed = 7", "seed = 7.5"),
        ("size_mm = [20, 24.5]", "size_mm = [20, -24.5, 3]"),
        ("count = 8", "count = 0"),
        ('intent = "relative"', 'intent = "relativ"'),
        ("bits = 16", "bits = 12"),
        ("faces = 5", "faces = true"),
    ):
        text = swap(text, old, new)
    text += "[reprot]\nx = 1\n"
    found = {(problem.key, problem.line) for problem in problems_of(tmp_path, text)}
    assert found == {
        ("job.name", line_of(text, "name")),
        ("slab.trim_mm", line_of(text, "trim_mm")),
        ("texture.pathces", line_of(text, "pathces")),
        ("texture.seed", line_of(text, "seed")),
        ("tile.size_mm", line_of(text, "size_mm")),
        ("tile.count", line_of(text, "count")),
        ("colour.intent", line_of(text, "intent")),
        ("output.bits", line_of(text, "bits")),
        ("report.faces", line_of(text, "faces")),
        ("reprot", line_of(text, "[reprot]")),
    }


@pytest.mark.parametrize(
    ("old", "new", "key", "message"),
    [
        ("patches = 40", "pathces = 40", "texture.pathces", "unknown key; did you mean patches?"),
        ("directory = ", 'folder = "x"\ndirectory = ', "output.folder", "unknown key. Allowed here: directory, format"),
        ("[report]", "[reports]", "reports", "unknown key; did you mean report?"),
        ("schema_version = 1", "schema_versoin = 1", "schema_versoin", "did you mean schema_version?"),
    ],
)
def test_unknown_keys_get_a_suggestion(tmp_path: Path, old: str, new: str, key: str, message: str) -> None:
    text = swap(VALID, old, new)
    problem = only(tmp_path, text)
    assert problem.key == key
    assert message in problem.message
    name = key.rpartition(".")[2]
    assert problem.line == next(
        n for n, line in enumerate(text.split("\n"), start=1) if line.lstrip("[").startswith(name)
    )


WRONG = [
    ("schema_version = 1", "schema_version = 2"),
    ("schema_version = 1", 'schema_version = "1"'),
    ('name = "Gravel"', f'name = "{"x" * 201}"'),
    ("scans = [", "scans = [] # ["),
    ("scans = [", "scans = 7 # ["),
    ("dpi = 60\nmasks", "dpi = 9.9\nmasks"),
    ("dpi = 60\nmasks", "dpi = 20001\nmasks"),
    ("dpi = 60\nmasks", 'dpi = "60"\nmasks'),
    ("dpi = 60\nmasks", "dpi = true\nmasks"),
    ("dpi = 60\nmasks", "dpi = nan\nmasks"),
    ('["m.png", ""]', '["m.png"]'),
    ('["m.png", ""]', '["m.png", "", ""]'),
    ("trim_mm = 2.5", "trim_mm = false"),
    ("trim_mm = 2.5", "trim_mm = inf"),
    ("[62, 3.0, -11]", "[62, 3.0]"),
    ("[62, 3.0, -11]", "[101, 3.0, -11]"),
    ("[62, 3.0, -11]", "[62, 3.0, -128]"),
    ("[62, 3.0, -11]", "[62, 3.0, nan]"),
    ("[62, 3.0, -11]", '[62, 3.0, "-11"]'),
    ("map_size_mm = [50, 50]", "map_size_mm = [50]"),
    ("map_size_mm = [50, 50]", "map_size_mm = [50, 0]"),
    ("map_size_mm = [50, 50]", "map_size_mm = [50, true]"),
    ("feature_mm = 12", "feature_mm = 0"),
    ("patches = 40", "patches = 4001"),
    ("patches = 40", "patches = -1"),
    ("patches = 40", "patches = 40.0"),
    ("active_per_cell = 9", "active_per_cell = -0.5"),
    ("seed = 7", "seed = -1"),
    ("seed = 7", "seed = 9223372036854775808"),
    ("seed = 7", "seed = 2026-11-22"),
    ("[20, 24.5]", "[20, inf]"),
    ("[20, 24.5]", "[20, nan]"),
    ("[20, 24.5]", '["20", 24.5]'),
    ("[20, 24.5]", "[0, 24.5]"),
    ("[20, 24.5]", "{width = 20, height = 24.5}"),
    ("dpi = 60\ncount", "dpi = 2401\ncount"),
    ("count = 8", "count = 0"),
    ("count = 8", 'count = "8"'),
    ("count = 8", "count = 1099511627777"),
    ('layout = "continuous"', 'layout = "Continuous"'),
    ("columns = 3", "columns = 0"),
    ("bleed_mm = 1", "bleed_mm = 101"),
    ("bleed_mm = 1", "bleed_mm = -inf"),
    ('press_profile = "demo_ceramic.icc"', "press_profile = 3"),
    ("ink_limit_percent = 260", "ink_limit_percent = 0"),
    ("ink_limit_percent = 260", "ink_limit_percent = 801"),
    ("ink_limit_percent = 260", "ink_limit_percent = nan"),
    ('"M", ', '"", '),
    ('"M", ', f'"{"M" * 41}", '),
    ('"M", ', '"Grün", '),
    ('"M", ', '"a\\nb", '),
    ('directory = "out"', 'directory = ""'),
    ('directory = "out"', "directory = false"),
    ("bits = 16", "bits = true"),
    ('compression = "lzw"', 'compression = "jpeg"'),
    ("proofs = false", "proofs = 0"),
    ("proofs = false", 'proofs = "false"'),
    ("pdf = false", 'pdf = "manifest.jsonl"'),
    ("pdf = false", 'pdf = ""'),
    ("faces = 5", "faces = 0"),
]


@pytest.mark.parametrize(("old", "new"), WRONG)
def test_a_wrong_value_is_the_only_problem_and_has_its_line(tmp_path: Path, old: str, new: str) -> None:
    text = swap(VALID, old, new)
    before, after = VALID.split("\n"), text.split("\n")
    changed = [n for n, pair in enumerate(zip(before, after, strict=True), start=1) if pair[0] != pair[1]]
    problems = problems_of(tmp_path, text)
    assert [problem.line for problem in problems] == changed
    key = after[changed[0] - 1].partition(" =")[0]
    for problem in problems:
        assert problem.key.rpartition(".")[2] == key
        assert len(problem.message) > 10


def test_a_whole_number_written_as_a_fraction_is_that_number(tmp_path: Path) -> None:
    # Else the same job would have two hashes.
    bits = load_job(write(tmp_path, swap(VALID, "bits = 16", "bits = 16.0"))).job.output.bits
    assert bits == 16
    assert isinstance(bits, int)


def test_a_wrong_item_is_named(tmp_path: Path) -> None:
    assert "(item 3)" in only(tmp_path, swap(VALID, "[62, 3.0, -11]", "[62, 3.0, nan]")).message


def test_a_long_value_is_shown_short(tmp_path: Path) -> None:
    message = only(tmp_path, swap(VALID, "seed = 7", f'seed = "{"s" * 500}"')).message
    assert len(message) < 200


def test_layout_and_columns_go_together(tmp_path: Path) -> None:
    without = only(tmp_path, swap(VALID, "columns = 3\n", ""))
    assert without.key == "tile.columns"
    assert "how many faces a row of the wall has" in without.message
    assert without.line == line_of(VALID, "[tile]")
    scattered = swap(VALID, 'layout = "continuous"', 'layout = "scatter"')
    alone = only(tmp_path, scattered)
    assert alone.key == "tile.columns"
    assert alone.line == line_of(scattered, "columns")
    assert load_job(write(tmp_path, swap(scattered, "columns = 3\n", ""))).job.tile.columns is None


@pytest.mark.parametrize(
    ("size", "bleed"), [("[200000, 200000]", 0), ("[1e300, 1e300]", 0), ("[20, 1e9]", 1), ("[14000, 14000]", 100)]
)
def test_a_tile_beyond_sense_is_refused(tmp_path: Path, size: str, bleed: float) -> None:
    text = swap(swap(VALID, "[20, 24.5]", size), "bleed_mm = 1", f"bleed_mm = {bleed}")
    problem = only(tmp_path, text)
    assert problem.key == "tile.size_mm"
    assert problem.line == line_of(text, "size_mm")
    assert "a face can have 2**30 at most" in problem.message


@pytest.mark.parametrize("bleed", [0, 1, 100])
def test_a_tile_below_a_pixel_is_refused_whatever_its_bleed(tmp_path: Path, bleed: float) -> None:
    text = swap(swap(VALID, "[20, 24.5]", "[20, 0.4]"), "bleed_mm = 1", f"bleed_mm = {bleed}")
    assert "smaller than a pixel" in only(tmp_path, text).message
    assert load_job(write(tmp_path, swap(text, "0.4]", "0.43]"))).job.tile.size_mm == [20.0, 0.43]


def test_sections_that_are_missing_are_named_all(tmp_path: Path) -> None:
    found = {problem.key: problem for problem in problems_of(tmp_path, "")}
    assert set(found) == {"slab", "tile", "colour", "output"}
    assert "the job needs a section [tile]" in found["tile"].message


def test_a_key_that_is_missing_is_put_to_its_section(tmp_path: Path) -> None:
    text = swap(VALID, 'press_profile = "demo_ceramic.icc"\n', "")
    problem = only(tmp_path, text)
    assert (problem.key, problem.line) == ("colour.press_profile", line_of(text, "[colour]"))
    assert "missing: ICC output profile" in problem.message


@pytest.mark.parametrize("text", ["slab = 3", "slab = []", "slab = 'a'", "slab = {}", "[[slab]]", "slab.scans = 3"])
def test_sections_of_another_shape_are_problems(tmp_path: Path, text: str) -> None:
    assert "slab" in {problem.key.partition(".")[0] for problem in problems_of(tmp_path, text)}


@pytest.mark.parametrize(
    ("broken", "line"),
    [
        ("schema_version = 1\n[slab\n", 2),
        ("schema_version = 1\nseed 7\n", 2),
        ("a = 1\na = 2\n", 2),
        ("[job]\n[job]\n", 2),
        ('a = 1\n\nname = "never ends\nb = 1\n', 3),
        ("a = 1\nb = [1, 2\n", 3),
    ],
)
def test_broken_toml_is_shown_at_its_line(tmp_path: Path, broken: str, line: int) -> None:
    problem = only(tmp_path, broken)
    assert problem.message.startswith("not valid TOML: ")
    assert problem.line == line
    assert not re.search(r"at line|end of document", problem.message)


@pytest.mark.parametrize("value", ["1" * 5000, "[" * 30_000, "[" * 3000 + "]" * 3000, "{a=" * 5000])
def test_toml_that_python_won_t_read_is_a_problem(tmp_path: Path, value: str) -> None:
    assert only(tmp_path, swap(VALID, "seed = 7", f"seed = {value}")).message


def test_text_that_is_not_utf_8_is_shown_at_its_line(tmp_path: Path) -> None:
    text = VALID.encode().replace(b"Gravel", "Grün".encode("latin-1"))
    problem = only(tmp_path, text)
    assert problem.line == line_of(VALID, "name")
    assert "save the file as UTF-8" in problem.message
    assert only(tmp_path, VALID.encode("utf-16")).message


def test_a_file_that_can_t_be_read_is_a_problem(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "absent.toml", "there is no such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ConfigError) as caught:
            load_job(path)
        assert caught.value.message == f"{path}: {reason}"


def test_a_picture_in_place_of_a_job_is_a_problem(tmp_path: Path) -> None:
    assert only(tmp_path, bytes(range(256)) * 10).message
    assert "larger than 1 MiB" in only(tmp_path, b"#" * ((1 << 20) + 1)).message


def test_a_problem_found_later_gets_its_line_too(tmp_path: Path) -> None:
    file = load_job(write(tmp_path, VALID))
    assert file.problem("tile", "size_mm", "x").line == line_of(VALID, "size_mm")
    assert file.problem("tile", "absent", "x").line == line_of(VALID, "[tile]")
    assert file.problem("absent", "absent", "x").line is None
    assert str(file.problem("tile", "count", "too few")) == (
        f"{tmp_path / 'job.toml'}:{line_of(VALID, 'count')}: tile.count: too few"
    )


@pytest.mark.parametrize(
    "path", [path for path in sorted(JOBS.glob("*.toml")) if "[slab]" in path.read_text()], ids=lambda path: path.stem
)
def test_shipped_jobs_are_in_order(path: Path) -> None:
    assert isinstance(load_job(path).job, Job)


def outcome(path: Path, data: bytes) -> JobFile | ConfigError:
    path.write_bytes(data)
    try:
        return load_job(path)
    except ConfigError as error:
        refused = error
    assert refused.problems
    assert all(problem.message for problem in refused.problems)
    lines = data.count(b"\n") + 1
    assert all(problem.line is None or 1 <= problem.line <= lines for problem in refused.problems)
    return refused


@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)
def test_any_change_of_bytes_gives_a_job_or_problems(tmp_path: Path, data: st.DataObject) -> None:
    raw = VALID.encode()
    start = data.draw(st.integers(0, len(raw)))
    length = data.draw(st.integers(0, 30))
    outcome(tmp_path / "job.toml", raw[:start] + data.draw(st.binary(max_size=20)) + raw[start + length :])


SCALARS = st.one_of(
    st.booleans().map(lambda value: str(value).lower()),
    st.integers(-(2**70), 2**70).map(str),
    st.floats().map(repr),
    st.text(st.characters(codec="utf-8", exclude_characters="'", exclude_categories=["C"]), max_size=20).map(
        lambda text: f"'{text}'"
    ),
    st.sampled_from(["1e400", "-0.0", "0x7f", "1979-05-27T07:32:00Z", "07:32:00", "''", "'''\n'''", '"\\u0000"']),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4).map(lambda items: f"[{', '.join(items)}]") | inner.map("{{a = {}}}".format)
    ),
    max_leaves=5,
)
SETTINGS = [line.partition(" = ") for line in VALID.split("\n") if " = " in line]


@given(line=st.sampled_from(SETTINGS), value=VALUES)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=500)
def test_any_value_gives_a_job_or_a_problem_with_its_key(
    tmp_path: Path, line: tuple[str, str, str], value: str
) -> None:
    key, _, old = line
    text = VALID.replace(f"{key} = {old}\n", f"{key} = {value}\n", 1)
    result = outcome(tmp_path / "job.toml", text.encode())
    if isinstance(result, ConfigError):
        # Settings of one section can contradict each other: columns is named where the layout was changed.
        near = {key, "columns", "masks", "size_mm", "map_size_mm", ""}
        assert {problem.key.rpartition(".")[2] for problem in result.problems} <= near
    else:
        assert Job.model_validate(result.job.model_dump(exclude_unset=True)) == result.job


@given(drop=st.sets(st.integers(0, VALID.count("\n") - 1), max_size=6), order=st.randoms(use_true_random=False))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
def test_lines_lost_or_shuffled_give_a_job_or_problems(tmp_path: Path, drop: set[int], order: object) -> None:
    lines = [line for number, line in enumerate(VALID.split("\n")) if number not in drop]
    outcome(tmp_path / "job.toml", "\n".join(lines).encode())
    order.shuffle(lines)  # type: ignore[attr-defined]
    outcome(tmp_path / "job.toml", "\n".join(lines).encode())
