"""Faces are recognised however the tile lies and whatever befell it, and tiles that aren't ours are not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim.tile_photo import PhotoConditions, photo_conditions
from tests.imagined_stone import PX_PER_MM, ImaginedStone, to_xyz, true_corners
from tilefab.inspection.finding import find_tile
from tilefab.inspection.fingerprint import FingerprintIndex, fingerprints
from tilefab.inspection.recognition import PROBLEM_WORDS, RecognitionSettings, recognise
from tilefab.inspection.records import ImageProblem, Recognition
from tilefab.types import SizeMm

SIZE = SizeMm(150.0, 150.0)
STONE = ImaginedStone(SIZE)
FACES = range(100, 160)


@pytest.fixture(scope="module")
def index() -> FingerprintIndex:
    return fingerprints(STONE, FACES, SIZE)


def _recognised(index: FingerprintIndex, image: np.ndarray, stone: ImaginedStone = STONE) -> Recognition:
    return recognise(to_xyz(image), index, stone, stone.size_mm, px_per_mm=PX_PER_MM)


@pytest.mark.parametrize("seed", range(8))
def test_recognised_however_it_lies(index: FingerprintIndex, seed: int) -> None:
    conditions = photo_conditions(np.random.default_rng(seed), shift=0.04)
    photo = STONE.photo(FACES[seed], conditions, seed)
    said = _recognised(index, photo.image)
    assert (said.face, said.quarter_turns, said.problem) == (FACES[seed], conditions.quarter_turns, None)
    assert said.likeness > 0.9 > 0.6 > said.runner_up
    assert said.confidence > 0.8
    assert said.visible > 0.98
    assert said.reason == ""
    np.testing.assert_allclose(said.corners_px, true_corners(photo, SIZE), atol=0.7)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("limits", [{"broken": 0.4}, {"occluded": 0.3}])
def test_recognised_in_part(index: FingerprintIndex, seed: int, limits: dict[str, Any]) -> None:
    conditions = photo_conditions(np.random.default_rng(seed), shift=0.04, **limits)
    said = _recognised(index, STONE.photo(FACES[-seed], conditions, seed).image)
    assert (said.face, said.quarter_turns) == (FACES[-seed], conditions.quarter_turns), said


@pytest.mark.parametrize("seed", range(6))
def test_tiles_of_others_are_none_of_ours(index: FingerprintIndex, seed: int) -> None:
    for stone, face in ((STONE, 5), (ImaginedStone(SIZE, seed=1), FACES[3]), (ImaginedStone(SIZE, grain_mm=8.0), 1)):
        said = _recognised(index, stone.photo(face, photo_conditions(np.random.default_rng(seed)), seed).image)
        assert said.face is None
        assert said.problem is None
        assert said.confidence > 0.8
        assert "none of these faces" in said.reason
        assert len(said.corners_px) == 4


def test_plain_tile_is_not_guessed(index: FingerprintIndex) -> None:
    plain = ImaginedStone(SIZE, contrast_l=0.0001)
    said = _recognised(index, plain.photo(1, PhotoConditions()).image)
    assert said.face is None
    blank = fingerprints(plain, FACES, SIZE)
    said = _recognised(blank, plain.photo(FACES[1], PhotoConditions()).image, plain)
    assert said.face is None


def test_hardly_any_contrast_is_enough() -> None:
    faint = ImaginedStone(SIZE, contrast_l=0.7)
    index = fingerprints(faint, FACES, SIZE)
    for seed in range(4):
        conditions = photo_conditions(np.random.default_rng(seed), shift=0.04)
        said = _recognised(index, faint.photo(FACES[seed], conditions, seed).image, faint)
        assert said.face == FACES[seed], said


def test_oblong_tiles() -> None:
    stone = ImaginedStone(SizeMm(200.0, 100.0))
    index = fingerprints(stone, range(20), stone.size_mm)
    for turns in range(4):
        photo = stone.photo(7, PhotoConditions(turns, -2.0))
        said = _recognised(index, photo.image, stone)
        assert (said.face, said.quarter_turns) == (7, turns)
        np.testing.assert_allclose(said.corners_px, true_corners(photo, stone.size_mm), atol=0.7)


def test_twins_are_not_told_apart_by_chance(index: FingerprintIndex) -> None:
    class Twins:
        def __call__(self, face: int, long_px: int) -> np.ndarray:
            return STONE(FACES[0] if face == 7 else face, long_px)

    twice = fingerprints(Twins(), [7, *FACES], SIZE)
    xyz = to_xyz(STONE.photo(FACES[0], PhotoConditions()).image)
    said = recognise(xyz, twice, Twins(), SIZE, px_per_mm=PX_PER_MM)
    assert said.face is None
    assert "two faces" in said.reason
    assert recognise(xyz, index, STONE, SIZE, px_per_mm=PX_PER_MM).face == FACES[0]


def test_face_outside_the_window(index: FingerprintIndex) -> None:
    xyz = to_xyz(STONE.photo(FACES[10], PhotoConditions()).image)
    assert recognise(xyz, index.narrowed(FACES[:10]), STONE, SIZE).face is None
    assert recognise(xyz, index.narrowed(FACES[10:11]), STONE, SIZE).face == FACES[10]
    nobody = recognise(xyz, index.narrowed([]), STONE, SIZE)
    assert nobody.face is None
    assert "no faces" in nobody.reason


def test_images_of_no_use(index: FingerprintIndex) -> None:
    black = np.zeros((300, 300, 3), dtype=np.uint8)
    said = _recognised(index, black)
    assert (said.face, said.problem, said.corners_px) == (None, ImageProblem.BLACK, ())
    assert said.reason == PROBLEM_WORDS[ImageProblem.BLACK]
    assert set(PROBLEM_WORDS) == set(ImageProblem)


def test_what_was_found_before_is_taken(index: FingerprintIndex) -> None:
    xyz = to_xyz(STONE.photo(FACES[4], PhotoConditions(rotation_deg=2.0)).image)
    tile = find_tile(xyz, SIZE, px_per_mm=PX_PER_MM)
    plainly = recognise(xyz, index, STONE, SIZE, px_per_mm=PX_PER_MM)
    assert recognise(xyz, index, STONE, SIZE, found=tile) == plainly
    assert recognise(xyz, index, STONE, SIZE, found=ImageProblem.TORN).problem is ImageProblem.TORN


def test_settings_decide(index: FingerprintIndex) -> None:
    photo = STONE.photo(FACES[2], PhotoConditions(broken=0.3))
    strict = RecognitionSettings(least_seen=0.95)
    said = recognise(to_xyz(photo.image), index, STONE, SIZE, px_per_mm=PX_PER_MM, settings=strict)
    assert said.face is None
    assert "can be compared" in said.reason


def test_print_off_the_middle_of_the_tile() -> None:
    fine = ImaginedStone(SIZE, grain_mm=2.0)
    index = fingerprints(fine, FACES, SIZE)

    class Shifted(ImaginedStone):
        def lightness(self, face: int) -> np.ndarray:
            return np.roll(super().lightness(face), (4, -4), axis=(0, 1))  # 2 mm

    for seed in range(3):
        photo = Shifted(SIZE, grain_mm=2.0).photo(FACES[seed], PhotoConditions(seed, 1.0), seed)
        said = _recognised(index, photo.image, fine)
        assert said.face == FACES[seed], said
        truth = true_corners(photo, SIZE)
        across, down = (truth[1] - truth[0]) / SIZE.width, (truth[3] - truth[0]) / SIZE.height
        np.testing.assert_allclose(said.corners_px, truth - 2.0 * across + 2.0 * down, atol=0.7)


def test_label_on_a_faint_tile() -> None:
    faint = ImaginedStone(SIZE, contrast_l=0.7)
    index = fingerprints(faint, FACES, SIZE)
    conditions = PhotoConditions(2, 1.0, occluded=(0.1, 0.3, 0.6, 0.4), light=0.1)
    said = _recognised(index, faint.photo(FACES[1], conditions).image, faint)
    assert (said.face, said.quarter_turns) == (FACES[1], 2)
