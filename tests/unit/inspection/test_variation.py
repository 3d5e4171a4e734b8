"""The variation index: nothing for plain tile, more for more, and the standard's measure only for plain tile."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.colour import delta_e_2000
from tilefab.inspection.variation import coarse_blocks, is_plain, plain_cmc, variation


def plain(count: int, spread: float, seed: int = 0) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [
        np.broadcast_to(np.array([60.0, 2.0, 8.0]) + generator.normal(0, spread, 3), (40, 80, 3)) for _ in range(count)
    ]


def cloudy(count: int, strength: float, seed: int = 0) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    faces = []
    for _ in range(count):
        coarse = generator.normal(0.0, strength, (4, 8, 1))
        faces.append(np.kron(coarse - coarse.mean(), np.ones((10, 10, 1))) * [1.0, 0.0, 0.0] + [60.0, 2.0, 8.0])
    return faces


def test_equal_faces_do_not_vary() -> None:
    found = variation([plain(1, 0.0)[0]] * 3)
    assert (found.look, found.index, found.between_delta_e, found.pattern_delta_e, found.faces) == (
        "V0",
        0.0,
        0.0,
        0.0,
        3,
    )
    pattern = cloudy(1, 5.0)[0]
    repeated = variation([pattern, pattern, pattern])
    assert repeated.look == "V0"
    assert repeated.within_delta_e > 2.0


@pytest.mark.parametrize(("spread", "look"), [(0.05, "V0"), (0.4, "V1"), (1.0, "V2"), (2.8, "V3"), (9.0, "V4")])
def test_looks_of_plain_tiles_of_different_colour(spread: float, look: str) -> None:
    found = variation(plain(30, spread))
    assert found.look == look
    assert found.pattern_delta_e == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize(("strength", "look"), [(0.1, "V0"), (0.9, "V1"), (2.5, "V2"), (9.0, "V3")])
def test_looks_of_tiles_of_different_pattern(strength: float, look: str) -> None:
    found = variation(cloudy(20, strength))
    assert found.look == look
    assert found.between_delta_e < 0.1


def test_index_is_the_looks_number_and_goes_on_beyond_it() -> None:
    indices = [variation(plain(20, spread)).index for spread in (0.1, 0.5, 1.0, 3.0, 8.0, 16.0)]
    assert indices == sorted(indices)
    assert indices[-1] > 5.0
    assert variation(plain(20, 16.0)).look == "V4"


@settings(max_examples=20)
@given(st.permutations(range(6)))
def test_order_of_faces_does_not_matter(order: list[int]) -> None:
    faces = [face + shift for face, shift in zip(cloudy(6, 3.0), np.arange(6.0), strict=True)]
    assert variation([faces[place] for place in order]).index == pytest.approx(variation(faces).index, abs=1e-9)


def test_resolution_hardly_matters() -> None:
    faces = cloudy(6, 3.0)
    finer = [np.repeat(np.repeat(face, 3, axis=0), 3, axis=1).astype(np.float32) for face in faces]
    assert variation(finer).index == pytest.approx(variation(faces).index, abs=1e-4)


def test_many_faces_are_compared_by_an_even_choice_of_pairs() -> None:
    few, many = variation(plain(60, 1.0, 3)), variation(plain(400, 1.0, 4))
    assert many.faces == 400
    assert many.between_delta_e == pytest.approx(few.between_delta_e, rel=0.15)


def test_blocks_are_means() -> None:
    face = np.random.default_rng(5).normal(50.0, 5.0, (33, 77, 3))
    blocks = coarse_blocks(face)
    assert blocks.shape == (3, 8, 3)
    np.testing.assert_allclose(blocks[0, 0], face[:11, :9].mean(axis=(0, 1)))
    assert coarse_blocks(face, 1).reshape(3) == pytest.approx(face.mean(axis=(0, 1)))


def test_refuses_what_cannot_be_compared() -> None:
    faces = plain(2, 1.0)
    with pytest.raises(ValueError, match="at least 2"):
        variation(faces[:1])
    with pytest.raises(ValueError, match="differ in shape"):
        variation([faces[0], faces[1][:, :40]])
    with pytest.raises(ValueError, match="CIELAB"):
        coarse_blocks(np.zeros((8, 8)))
    with pytest.raises(ValueError, match="too small"):
        coarse_blocks(np.zeros((2, 2, 3)))


def test_plain_is_what_the_eye_takes_for_plain() -> None:
    grain = np.random.default_rng(6).normal(0.0, 1.0, (300, 300, 3))
    assert is_plain(np.full((300, 300, 3), 50.0) + grain)
    assert is_plain(np.full((1, 1, 3), 50.0))
    slope = np.full((100, 100, 3), 50.0)
    slope[..., 0] += np.linspace(-3.0, 3.0, 100)
    assert not is_plain(slope)
    assert not is_plain(cloudy(1, 3.0)[0])


def test_cmc_of_plain_tiles() -> None:
    # At L* 50 in neutral grey, S_L is 1.0887 (Clarke, McDonald and Rigg 1984): CMC(2:1) of ΔL* 1 is 1 / (2 S_L).
    standard = [[50.0, 0.0, 0.0], [50.0, 0.0, 0.0]]
    weight = 0.040975 * 50.0 / (1.0 + 0.01765 * 50.0)
    found = plain_cmc(standard, [[51.0, 0.0, 0.0], [48.0, 0.0, 0.0]])
    assert found == pytest.approx(1.5 / (2.0 * weight))
    assert plain_cmc(standard, [[51.0, 0.0, 0.0], [48.0, 0.0, 0.0]], lightness=1.0) == pytest.approx(2.0 * found)
    with pytest.raises(ValueError, match="no tile"):
        plain_cmc(np.zeros((0, 3)), np.zeros((0, 3)))


def test_between_is_the_mean_of_pairs() -> None:
    faces = plain(3, 1.0, 9)
    means = [face[0, 0] for face in faces]
    pairs = [float(delta_e_2000(means[one], means[other])) for one, other in ((0, 1), (0, 2), (1, 2))]
    assert variation(faces).between_delta_e == pytest.approx(np.mean(pairs))
