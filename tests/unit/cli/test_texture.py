"""``tilefab texture score`` on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from typer.testing import CliRunner

from tilefab.cli.texture import app
from tilefab.errors import ImageError


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("textures")
    random = np.random.default_rng(1)
    exemplar = 120 + 40 * ndimage.gaussian_filter(random.normal(size=(64, 64, 3)), (1.5, 1.5, 0)) * 5
    pixels = np.clip(exemplar, 0, 255).astype(np.uint8)
    Image.fromarray(pixels).save(where / "exemplar.png")
    Image.fromarray(np.tile(pixels, (2, 2, 1))).save(where / "tiled.png")
    return where


def run(folder: Path, *options: str):
    return CliRunner().invoke(app, ["score", *(str(folder / name) for name in ("tiled.png", "exemplar.png")), *options])


def test_a_failing_texture_is_told_and_ends_with_0(folder: Path) -> None:
    result = run(folder)
    assert result.exit_code == 0, result.output
    assert "FAIL" in result.stdout
    assert "gates failed" in result.stdout
    assert "coverage" in result.stdout


def test_strict_ends_with_1(folder: Path) -> None:
    assert run(folder, "--strict").exit_code == 1


def test_json_tells_everything(folder: Path) -> None:
    result = run(folder, "--json")
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    assert facts["passed"] is False
    assert "repetition" in {gate["name"] for gate in facts["gates"] if not gate["passed"]}
    assert facts["coverage"] == 1.0
    assert facts["map_estimated"] is True


def test_a_missing_file_is_an_error(folder: Path) -> None:
    result = CliRunner().invoke(app, ["score", str(folder / "none.png"), str(folder / "exemplar.png")])
    assert isinstance(result.exception, ImageError)
