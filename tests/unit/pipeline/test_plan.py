"""Planning: every file found or missed with its line, and a hash that changes with the pixels and nothing else."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile

from tilefab.config import load_job
from tilefab.errors import ConfigError, ImageError, ProfileError
from tilefab.pipeline import Plan, plan_job
from tilefab.pipeline.plan import shipped_profiles
from tilefab.sampling import CropMap
from tilefab.types import SizePx

SHIPPED = shipped_profiles() / "demo_ceramic.icc"

JOB = """\
[job]
name = "Plan"
[slab]
scans = ["slab.tif"]
dpi = 60
[texture]
design = "tile"
patches = 40
active_per_cell = 9
seed = 7
[tile]
size_mm = [20, 24]
dpi = 60
count = 8
bleed_mm = 1
[colour]
press_profile = "demo_ceramic.icc"
intent = "perceptual"
ink_limit_percent = 260
[output]
directory = "out"
bits = 8
compression = "none"
[report]
pdf = "report.pdf"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a job, with a scan beside it; the current folder is another."""
    made = tmp_path / "jobs"
    made.mkdir()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    write_scan(made / "slab.tif")
    (made / "job.toml").write_text(JOB)
    return made


def write_scan(path: Path, seed: int = 1, **options: Any) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    tifffile.imwrite(path, pixels, photometric="rgb", **options)


def edit(folder: Path, *changes: tuple[str, str]) -> str:
    text = JOB
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "job.toml").write_text(text)
    return text


def plan(folder: Path, *changes: tuple[str, str], out: Path | None = None) -> Plan:
    edit(folder, *changes)
    return plan_job(load_job(folder / "job.toml"), out)


def refused(kind: type[ConfigError | ProfileError | ImageError], folder: Path, *changes: tuple[str, str]) -> Any:
    with pytest.raises(kind) as caught:
        plan(folder, *changes)
    assert type(caught.value) is kind
    return caught.value


def line_of(text: str, start: str) -> int:
    return next(n for n, line in enumerate(text.split("\n"), start=1) if line.startswith(start))


def test_a_plan_knows_sizes_and_files(folder: Path) -> None:
    made = plan(folder)
    assert made.scans[0].path == (folder / "slab.tif").resolve()
    assert made.scans[0].facts.size == SizePx(20, 30)
    assert made.scans[0].dpi == 60
    assert made.tile_px == SizePx(57, 47)
    assert made.bleed_px == 2
    assert made.press_profile.path == str(SHIPPED.resolve())
    assert made.ink_names == made.press_profile.ink_names == ("Blue", "Brown", "Yellow", "Black")
    assert made.output == (folder / "out").resolve()
    assert made.name == "Plan"
    assert made.seed == 7
    assert made.input_profile is None


def test_a_job_without_a_name_has_its_file_s(folder: Path) -> None:
    assert plan(folder, ('name = "Plan"\n', "")).name == "job"


def test_files_are_looked_for_beside_the_job_first(folder: Path) -> None:
    write_scan(Path("slab.tif"), seed=2)
    assert plan(folder).scans[0].path == (folder / "slab.tif").resolve()
    (folder / "slab.tif").unlink()
    assert plan(folder).scans[0].path == Path("slab.tif").resolve()


def test_a_profile_beside_the_job_goes_before_a_shipped_one(folder: Path) -> None:
    shutil.copy(SHIPPED, folder / "demo_ceramic.icc")
    assert plan(folder).press_profile.path == str((folder / "demo_ceramic.icc").resolve())


def test_paths_may_be_absolute_or_start_at_home(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(folder))
    assert plan(folder, ('"slab.tif"', f'"{folder / "slab.tif"}"')).scans[0].path.name == "slab.tif"
    made = plan(folder, ('"slab.tif"', '"~/slab.tif"'), ('"out"', '"~/x"'))
    assert made.scans[0].path == (folder / "slab.tif").resolve()
    assert made.output == (folder / "x").resolve()


def test_the_output_folder_can_be_replaced(folder: Path, tmp_path: Path) -> None:
    assert plan(folder, out=tmp_path / "there").output == (tmp_path / "there").resolve()
    assert plan(folder, ('"out"', '"../made/here"')).output == (tmp_path / "made" / "here").resolve()


def test_a_scan_may_come_from_a_package(folder: Path) -> None:
    made = plan(folder, ('"slab.tif"', '"package:skimage/data/gravel.png"'))
    assert made.scans[0].path.name == "gravel.png"
    assert made.scans[0].facts.size == SizePx(512, 512)


@pytest.mark.parametrize(
    "name",
    [
        "package:skimage/data/absent.png",
        "package:no_such_package/a.png",
        "package:",
        "package:skimage",
        "package:skimage/data",
        "package:/a.png",
        "package:..",
        "package:../a.png",
    ],
)
def test_what_no_package_holds_is_a_problem(folder: Path, name: str) -> None:
    error = refused(ConfigError, folder, ('"slab.tif"', f'"{name}"'))
    assert "no installed package holds this file" in error.message


@pytest.mark.parametrize(
    "name", ["absent.tif", ".", "~nobody-here/a.tif", "x" * 5000, "slab.tif/a", "a\\u0000b", "a\\nb"]
)
@pytest.mark.parametrize("key", ["scans", "press_profile", "input_profile", "masks"])
def test_a_missing_file_is_a_problem_at_its_line(folder: Path, name: str, key: str) -> None:
    changes = {
        "scans": ('"slab.tif"', f'"{name}"'),
        "press_profile": ('"demo_ceramic.icc"', f'"{name}"'),
        "input_profile": ("dpi = 60\n[texture]", f'input_profile = "{name}"\ndpi = 60\n[texture]'),
        "masks": ("dpi = 60\n[texture]", f'masks = ["{name}"]\ndpi = 60\n[texture]'),
    }
    error = refused(ConfigError, folder, changes[key])
    (problem,) = error.problems
    assert problem.key.endswith(f".{key}")
    assert problem.line == line_of((folder / "job.toml").read_text(), key)
    assert "there is no file" in problem.message


@pytest.mark.parametrize("change", [('"slab.tif"', '""'), ('"demo_ceramic.icc"', '""')])
def test_an_empty_name_is_no_file(folder: Path, change: tuple[str, str]) -> None:
    assert "there is no file" in refused(ConfigError, folder, change).message


def test_a_profile_of_the_wrong_class_is_a_profile_error(folder: Path) -> None:
    (folder / "srgb.icc").write_bytes(imagecodecs.cms_profile("srgb"))
    error = refused(ProfileError, folder, ('"demo_ceramic.icc"', '"srgb.icc"'))
    assert error.exit_code == 5
    assert error.path == str((folder / "srgb.icc").resolve())
    assert "is a display profile, but a press needs an output profile" in error.message
    assert f"job.toml:{line_of(JOB, 'press_profile')}: colour.press_profile" in error.message


@pytest.mark.parametrize("size", [0, 100, 131, 132, 400, 40_000, 858_411])
def test_a_profile_cut_short_is_a_profile_error(folder: Path, size: int) -> None:
    (folder / "cut.icc").write_bytes(SHIPPED.read_bytes()[:size])
    error = refused(ProfileError, folder, ('"demo_ceramic.icc"', '"cut.icc"'))
    assert "cut.icc" in error.message
    assert "\n" not in error.message


def test_text_in_place_of_a_profile_is_a_profile_error(folder: Path) -> None:
    error = refused(ProfileError, folder, ('"demo_ceramic.icc"', '"job.toml"'))
    assert "no ICC profile" in error.message


def with_input(name: str) -> tuple[str, str]:
    return "dpi = 60\n[texture]", f'input_profile = "{name}"\ndpi = 60\n[texture]'


def test_an_input_profile_is_checked(folder: Path) -> None:
    (folder / "srgb.icc").write_bytes(imagecodecs.cms_profile("srgb"))
    made = plan(folder, with_input("srgb.icc"))
    assert made.input_profile is not None
    assert made.input_profile.device_class == "mntr"
    link = bytearray(imagecodecs.cms_profile("srgb"))
    link[12:16] = b"link"
    (folder / "link.icc").write_bytes(link)
    assert "doesn't describe a scanner" in refused(ProfileError, folder, with_input("link.icc")).message
    (folder / "cut.icc").write_bytes(link[:200])
    assert refused(ProfileError, folder, with_input("cut.icc")).exit_code == 5


def test_a_damaged_scan_is_an_image_error(folder: Path) -> None:
    (folder / "slab.tif").write_bytes(b"II*\0")
    error = refused(ImageError, folder)
    assert error.exit_code == 4
    assert f"job.toml:{line_of(JOB, 'scans')}: slab.scans" in error.message
    assert error.path == str((folder / "slab.tif").resolve())


def test_several_problems_come_together(folder: Path) -> None:
    (folder / "slab.tif").write_bytes(b"II*\0")
    (folder / "srgb.icc").write_bytes(imagecodecs.cms_profile("srgb"))
    error = refused(
        ConfigError,
        folder,
        ('"slab.tif"', '"slab.tif", "absent.tif", "a.tif"'),
        ('"demo_ceramic.icc"', '"srgb.icc"'),
    )
    assert [problem.key for problem in error.problems] == ["slab.scans"] * 3 + ["colour.press_profile"]


def test_a_scan_without_resolution_needs_one_from_the_job(folder: Path) -> None:
    error = refused(ConfigError, folder, ("dpi = 60\n[texture]", "[texture]"))
    assert "doesn't state its resolution; say it with dpi = ... in [slab]" in error.message
    assert error.problems[0].line == line_of(JOB, "scans")
    write_scan(folder / "slab.tif", resolution=(100, 100), resolutionunit="CENTIMETER")
    assert plan(folder, ("dpi = 60\n[texture]", "[texture]")).scans[0].dpi == pytest.approx(254)
    assert plan(folder).scans[0].dpi == 60


def test_ink_names_must_fit_the_profile(folder: Path) -> None:
    error = refused(ConfigError, folder, ("[output]", 'ink_names = ["A", "B", "C"]\n[output]'))
    assert "3 names for the 4 inks" in error.message
    assert plan(folder, ("[output]", 'ink_names = ["A", "B", "C", "D"]\n[output]')).ink_names == ("A", "B", "C", "D")


def hashes(made: Plan) -> tuple[str, str, str]:
    return made.map_key, made.press_key, made.job_hash


OF_MAP = [
    ("dpi = 60\n[texture]", "dpi = 61\n[texture]"),
    ("dpi = 60\n[texture]", "dpi = 60\nsquare = false\n[texture]"),
    ("dpi = 60\n[texture]", "dpi = 60\nlighting = false\n[texture]"),
    ("dpi = 60\n[texture]", "dpi = 60\nmatch = false\n[texture]"),
    ("dpi = 60\n[texture]", "dpi = 60\ntrim_mm = 1\n[texture]"),
    ("dpi = 60\n[texture]", "dpi = 60\ntarget_lab = [50, 0, 0]\n[texture]"),
    ("dpi = 60\n[texture]", 'dpi = 60\nmasks = ["mask.tif"]\n[texture]'),
    with_input("srgb.icc"),
    ('"slab.tif"', '"slab.tif", "slab.tif"'),
    ('"slab.tif"', '"other.tif"'),
    ("patches = 40", "patches = 41"),
    ("active_per_cell = 9", "active_per_cell = 9.5"),
    ("seed = 7", "seed = 8"),
    ("[tile]", "map_size_mm = [50, 50]\n[tile]"),
    ("[tile]", "feature_mm = 5\n[tile]"),
    ("dpi = 60\ncount", "dpi = 61\ncount"),
]
OF_PRESS = [
    ('"perceptual"', '"relative"'),
    ('"perceptual"', '"absolute"'),
    ('"perceptual"', '"saturation"'),
    ("ink_limit_percent = 260", "ink_limit_percent = 260.1"),
    ("bits = 8", "bits = 16"),
    ('"demo_ceramic.icc"', '"other.icc"'),
]
OF_FACES = [
    ("[20, 24]", "[20, 24.1]"),
    ("bleed_mm = 1", "bleed_mm = 1.1"),
    ("bleed_mm = 1", 'bleed_mm = 1\nlayout = "continuous"\ncolumns = 2'),
    ("bleed_mm = 1", 'bleed_mm = 1\nlayout = "continuous"\ncolumns = 3'),
]
OF_NOTHING = [
    ('name = "Plan"', 'name = "Another"'),
    ("count = 8", "count = 1000"),
    ('compression = "none"', 'compression = "lzw"'),
    ('pdf = "report.pdf"', "pdf = false"),
    ("[report]", "[report]\nfaces = 3"),
    ("[report]", '[line]\nrecipe = "600 x 600"\n[report]'),
    ('directory = "out"', 'directory = "elsewhere"'),
    ("bits = 8", "bits = 8\nproofs = false"),
    ("[job]", "schema_version = 1\n# a comment\n[job]"),
    ("[20, 24]", "[20.0, 24.0]"),
    ("ink_limit_percent = 260", "ink_limit_percent = 260.0"),
    ("dpi = 60\ncount", "dpi = 6e1\ncount"),
    ('"slab.tif"', '"copy.tif"'),
]


@pytest.fixture
def crop_map() -> CropMap:
    """A map of four crops of a blank slab."""
    place = np.array([0, 3, 6, 9], dtype=np.int32)
    return CropMap(
        base=np.zeros((40, 40, 3), np.uint16),
        space="lab16",
        channels=("L*", "a*", "b*"),
        dpi=60.0,
        guide=np.zeros((40, 40, 3), np.uint8),
        guide_shift=0,
        crop_row=place,
        crop_col=place,
        pitch_px=16,
        overlap_px=8,
        seam_levels=0,
        side_cost=np.zeros((4, 4), np.uint16),
        below_cost=np.zeros((4, 4), np.uint16),
        price=np.zeros(4, np.int32),
        ration=np.full(4, -1, np.int8),
        candidates=4,
        sweeps=1,
    )


@pytest.fixture
def stocked(folder: Path) -> Path:
    """The same folder with all files that the changes above name."""
    write_scan(folder / "other.tif", seed=2)
    shutil.copy(folder / "slab.tif", folder / "copy.tif")
    (folder / "srgb.icc").write_bytes(imagecodecs.cms_profile("srgb"))
    tifffile.imwrite(folder / "mask.tif", np.zeros((20, 30), np.uint8))
    profile = bytearray(SHIPPED.read_bytes())
    struct.pack_into(">I", profile, 64, 1)  # another rendering intent in the header: another profile
    (folder / "other.icc").write_bytes(profile)
    return folder


@pytest.mark.parametrize("change", OF_MAP)
def test_what_the_map_depends_on_changes_map_and_job(stocked: Path, change: tuple[str, str]) -> None:
    before, after = hashes(plan(stocked)), hashes(plan(stocked, change))
    assert [a == b for a, b in zip(before, after, strict=True)] == [False, True, False]


@pytest.mark.parametrize("change", OF_PRESS)
def test_what_the_inks_depend_on_changes_press_and_job(stocked: Path, change: tuple[str, str]) -> None:
    before, after = hashes(plan(stocked)), hashes(plan(stocked, change))
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, False]


@pytest.mark.parametrize("change", OF_FACES)
def test_what_a_face_depends_on_changes_the_job(stocked: Path, change: tuple[str, str]) -> None:
    before, after = hashes(plan(stocked)), hashes(plan(stocked, change))
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, True, False]


@pytest.mark.parametrize("change", OF_NOTHING)
def test_what_decides_no_pixel_changes_no_hash(stocked: Path, change: tuple[str, str]) -> None:
    assert hashes(plan(stocked)) == hashes(plan(stocked, change))


CROPS = ('design = "tile"\npatches = 40\nactive_per_cell = 9', "crops = 64")


def crops_plan(folder: Path, lines: str = "crops = 64", *changes: tuple[str, str]) -> Plan:
    return plan(folder, (CROPS[0], lines), *changes)


@pytest.mark.parametrize("lines", ["crops = 65", "crops = 64\nration = false", "crops = 64\nfeature_mm = 5"])
def test_what_crops_depend_on_changes_map_and_build(stocked: Path, lines: str) -> None:
    before, after = crops_plan(stocked), crops_plan(stocked, lines)
    assert before.slab_key == after.slab_key
    assert before.build_key != after.build_key
    assert before.map_key != after.map_key
    assert before.job_hash != after.job_hash


@pytest.mark.parametrize("lines", ["drop = [3]", "keep = [3]", "drop = [3]\nkeep = [3, 4]"])
def test_another_choice_of_crops_is_another_map_of_the_same_build(stocked: Path, lines: str) -> None:
    before, after = crops_plan(stocked), crops_plan(stocked, f"crops = 64\n{lines}")
    assert before.build_key == after.build_key
    assert before.map_key != after.map_key
    assert before.job_hash != after.job_hash


def test_the_order_of_a_choice_does_not_matter(stocked: Path) -> None:
    assert crops_plan(stocked, "drop = [9, 3, 3]").map_key == crops_plan(stocked, "drop = [3, 9]").map_key


def test_another_seed_needs_no_other_slab(stocked: Path) -> None:
    before, after = crops_plan(stocked), crops_plan(stocked, "crops = 64", ("seed = 7", "seed = 8"))
    assert before.slab_key == after.slab_key
    assert before.build_key != after.build_key


def test_weights_are_found_and_count(stocked: Path) -> None:
    tifffile.imwrite(stocked / "weights.tif", np.full((20, 30), 9, np.uint8))
    line = ("dpi = 60\n[texture]", 'dpi = 60\nweights = ["weights.tif"]\n[texture]')
    made = crops_plan(stocked, "crops = 64", line)
    assert made.scans[0].weights == (stocked / "weights.tif").resolve()
    assert made.slab_key != crops_plan(stocked).slab_key
    tifffile.imwrite(stocked / "weights.tif", np.full((20, 30), 10, np.uint8))
    assert crops_plan(stocked, "crops = 64", line).slab_key != made.slab_key
    tifffile.imwrite(stocked / "weights.tif", np.zeros((20, 29), np.uint8))
    with pytest.raises(ImageError, match="the image of weights has 29 x 20 pixels but its scan"):
        crops_plan(stocked, "crops = 64", line)
    with pytest.raises(ConfigError, match="there is no file"):
        crops_plan(stocked, "crops = 64", (line[0], line[1].replace("weights.tif", "absent.tif")))


def test_faces_of_crops_keep_as_far_apart_as_a_crop_reaches(stocked: Path, crop_map: CropMap) -> None:
    layout = crops_plan(stocked).layout(crop_map)
    assert (layout.cell_rows, layout.cell_cols) == (16, 16)
    assert layout.reach_px == crop_map.overlap_px // 2 == 4


def test_all_these_jobs_are_different(stocked: Path) -> None:
    seen = {plan(stocked, change).job_hash for change in [*OF_MAP, *OF_PRESS, *OF_FACES]}
    assert len(seen) == len(OF_MAP) + len(OF_PRESS) + len(OF_FACES)


def test_a_pixel_of_the_scan_changes_the_job(folder: Path) -> None:
    before = hashes(plan(folder))
    pixels = tifffile.imread(folder / "slab.tif").copy()
    pixels[3, 4, 1] ^= 1
    tifffile.imwrite(folder / "slab.tif", pixels, photometric="rgb")
    after = hashes(plan(folder))
    assert before[0] != after[0]
    assert before[2] != after[2]


@pytest.fixture
def seen_calls(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    calls: list[Path] = []
    real: Callable[..., None] = Path.mkdir
    monkeypatch.setattr(Path, "mkdir", lambda self, *a, **k: (calls.append(self), real(self, *a, **k))[1])
    return calls


def test_planning_writes_nothing(folder: Path, seen_calls: list[Path]) -> None:
    before = sorted(folder.rglob("*"))
    plan(folder)
    assert sorted(folder.rglob("*")) == before
    assert seen_calls == []
