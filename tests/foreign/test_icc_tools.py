"""Profiles and links of tilefab's making through programs that nobody here wrote: transicc, icclu, colprof.

A test is skipped where its program isn't installed.
"""

import shutil
import subprocess
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.icc_samples import multilinear, small_link, small_profile
from tilefab.io.icc import IccProfile, measurement_text, parse_icc_profile, read_icc_profile
from tilefab.io.icc_tables import device_to_pcs, link_table, pcs_to_device, read_table

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "profiles" / "demo_ceramic.icc"
SHIPPED_DATA = ROOT / "profiles" / "demo_ceramic.ti3"
SOME_LAB = np.random.default_rng(3).uniform([5, -50, -50], [95, 50, 50], (25, 3)).round(4)
INTENTS: tuple[Literal["perceptual", "relative", "saturation"], ...] = ("perceptual", "relative", "saturation")
_CMS_INK = 100.0
_CMS_BYTE = 255.0


def run(command: list[str], lines: str = "", *, folder: Path | None = None) -> str:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    done = subprocess.run(
        command, input=lines, capture_output=True, text=True, timeout=120, check=False, cwd=folder, encoding="latin-1"
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def numbers(out: str, channels: int) -> NDArray[np.float64]:
    rows = [[float(word) for word in line.split()] for line in out.splitlines() if line.strip()]
    assert all(len(row) == channels for row in rows)
    return np.array(rows)


def transicc(arguments: list[str], values: NDArray[np.float64], channels: int) -> NDArray[np.float64]:
    lines = "".join(f"{value:.6f}\n" for value in values.ravel()) + "q\n"
    return numbers(run(["transicc", "-n", "-c0", *arguments], lines), channels)


def icclu(arguments: list[str], values: NDArray[np.float64], channels: int) -> NDArray[np.float64]:
    lines = "".join(" ".join(f"{number:.6f}" for number in value) + "\n" for value in values)
    return numbers(run(["icclu", "-v0", *arguments], lines), channels)


def cms_scale(inks: int) -> float:
    """transicc speaks of CMYK and 5 inks upwards in percent, of fewer in bytes."""
    return _CMS_INK if inks >= 4 else _CMS_BYTE


def written(folder: Path, data: bytes) -> tuple[str, IccProfile]:
    path = folder / "made.icc"
    path.write_bytes(data)
    return str(path), parse_icc_profile(data, "made.icc")


def near_nodes(profile: IccProfile) -> NDArray[np.float64]:
    """Recipes of no and full inks: there all ways of interpolating agree."""
    return np.random.default_rng(4).integers(0, 2, (25, profile.channels)).astype(np.float64)


@pytest.mark.parametrize("inks", range(1, 9))
@pytest.mark.parametrize("version", [2, 4])
def test_transicc_computes_the_same(inks: int, version: Literal[2, 4], tmp_path: Path) -> None:
    """Version 4 only in the relative intent: in the others Little CMS adapts its blacks unasked."""
    path, profile = written(tmp_path, small_profile(inks, version))
    scale = cms_scale(inks)
    for intent in INTENTS if version == 2 else ("relative",):
        number = f"-t{INTENTS.index(intent)}"
        lab = f"*Lab{version}"
        theirs = transicc([f"-i{lab}", f"-o{path}", number], SOME_LAB, inks) / scale
        np.testing.assert_allclose(multilinear(pcs_to_device(profile, intent), SOME_LAB), theirs, atol=5e-4)
        recipes = near_nodes(profile)
        theirs = transicc([f"-i{path}", f"-o{lab}", number], recipes * scale, 3)
        np.testing.assert_allclose(device_to_pcs(profile, intent)(recipes), theirs, atol=0.02)


@pytest.mark.parametrize("inks", range(1, 9))
def test_icclu_computes_the_same(inks: int, tmp_path: Path) -> None:
    path, profile = written(tmp_path, small_profile(inks, 2))
    recipes = np.random.default_rng(inks).random((25, inks))
    for letter, intent in zip("prs", INTENTS, strict=True):
        theirs = icclu(["-fb", f"-i{letter}", path], SOME_LAB, inks)
        np.testing.assert_allclose(multilinear(pcs_to_device(profile, intent), SOME_LAB), theirs, atol=5e-4)
        theirs = icclu(["-ff", f"-i{letter}", path], near_nodes(profile), 3)
        np.testing.assert_allclose(device_to_pcs(profile, intent)(near_nodes(profile)), theirs, atol=0.02)
    theirs = icclu(["-ff", "-ir", path], recipes, 3)
    ours = device_to_pcs(profile, "relative")
    assert min(np.abs(ours(recipes) - theirs).max(), np.abs(multilinear(ours, recipes) - theirs).max()) < 0.02
    theirs = icclu(["-fg", path], SOME_LAB, 1)
    np.testing.assert_allclose(multilinear(read_table(profile, "gamt"), SOME_LAB), theirs, atol=5e-4)


@pytest.mark.parametrize(("inputs", "outputs", "source"), [(3, 4, "rgb"), (1, 6, "ink"), (4, 4, "ink"), (8, 8, "ink")])
@pytest.mark.parametrize("version", [2, 4])
def test_links_compute_the_same(
    inputs: int, outputs: int, source: Literal["ink", "rgb"], version: Literal[2, 4], tmp_path: Path
) -> None:
    path, profile = written(tmp_path, small_link(inputs, outputs, version, source))
    values = np.random.default_rng(inputs).random((25, inputs)) if inputs == 3 else near_nodes(profile)
    theirs = transicc([f"-l{path}", "-t0"], values * cms_scale(inputs), outputs) / cms_scale(outputs)
    np.testing.assert_allclose(link_table(profile)(values), theirs, atol=5e-4)
    if version == 2:
        theirs = icclu(["-ff", path], values, outputs)  # over simplices from RGB, along the axes from Lab
        np.testing.assert_allclose(link_table(profile)(values), theirs, atol=5e-4)


def test_the_shipped_press_in_both() -> None:
    profile = read_icc_profile(SHIPPED)
    ours = multilinear(pcs_to_device(profile, "relative"), SOME_LAB)
    np.testing.assert_allclose(ours, icclu(["-fb", "-ir", str(SHIPPED)], SOME_LAB, 4), atol=5e-4)
    theirs = transicc(["-i*Lab2", f"-o{SHIPPED}", "-t1"], SOME_LAB, 4) / _CMS_INK
    np.testing.assert_allclose(ours, theirs, atol=5e-4)


def test_a_profile_of_argyll_is_read(tmp_path: Path) -> None:
    """colprof stores its measurements where tilefab looks for them."""
    shutil.copy(SHIPPED_DATA, tmp_path / "press.ti3")
    run(["colprof", "-v", "-ql", "-bl", "-D", "Argyll's", "press"], folder=tmp_path)
    path = next(file for file in tmp_path.iterdir() if file.suffix in (".icc", ".icm"))
    profile = read_icc_profile(path)
    assert profile.description == "Argyll's"
    text = measurement_text(profile)
    assert text is not None
    assert "BEGIN_DATA" in text
    assert text.split("BEGIN_DATA\n")[1].split() == SHIPPED_DATA.read_text().split("BEGIN_DATA\n")[1].split()
    for letter, intent in zip("prs", INTENTS, strict=True):
        theirs = icclu(["-fb", f"-i{letter}", "-pl", str(path)], SOME_LAB, 4)
        np.testing.assert_allclose(multilinear(pcs_to_device(profile, intent), SOME_LAB), theirs, atol=5e-4)
    recipes = np.random.default_rng(1).random((25, 4))
    theirs = icclu(["-ff", "-ir", "-pl", str(path)], recipes, 3)
    forward = device_to_pcs(profile, "relative")
    assert min(np.abs(forward(recipes) - theirs).max(), np.abs(multilinear(forward, recipes) - theirs).max()) < 0.02
