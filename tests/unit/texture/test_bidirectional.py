"""Bidirectional patch similarity."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.distance import cdist

from tilefab.texture.bidirectional import PATCH_PX, SHRINK, bidirectional_similarity, nearest_squares


def lab_noise(rows, cols, seed, sigma_px=4.0):
    values = np.random.default_rng(seed).normal(size=(rows, cols, 3))
    smooth = ndimage.gaussian_filter(values, (sigma_px, sigma_px, 0))
    return smooth / smooth.std() * np.array([20.0, 5.0, 5.0]) + np.array([50.0, 0.0, 10.0])


def by_hand(queries_lab, among_lab):
    """Mean over patches of the root mean square difference to the nearest, by brute force."""

    def patches(lab):
        rows, cols = lab.shape[0] // SHRINK, lab.shape[1] // SHRINK
        small = np.array(
            [
                [
                    lab[r * SHRINK : (r + 1) * SHRINK, c * SHRINK : (c + 1) * SHRINK].mean(axis=(0, 1))
                    for c in range(cols)
                ]
                for r in range(rows)
            ]
        )
        n = PATCH_PX
        return np.array([small[r : r + n, c : c + n].ravel() for r in range(rows - n + 1) for c in range(cols - n + 1)])

    among = np.concatenate([patches(among_lab[r:, c:]) for r in range(SHRINK) for c in range(SHRINK)])
    return (cdist(patches(queries_lab), among).min(axis=1) / PATCH_PX).mean()


def test_nearest_equals_brute_force_across_blocks():
    random = np.random.default_rng(1)
    # More columns than a block holds rows' worth, so that several blocks are joined.
    first, second = random.normal(50, 20, (700, 12)), random.normal(50, 20, (1500, 12))
    of_first, of_second = nearest_squares(first, second)
    squares = cdist(first, second, "sqeuclidean")
    np.testing.assert_allclose(of_first, squares.min(axis=1), rtol=1e-9)
    np.testing.assert_allclose(of_second, squares.min(axis=0), rtol=1e-9)


def test_equals_brute_force():
    exemplar, image = lab_noise(61, 50, 2), lab_noise(80, 97, 3)
    found = bidirectional_similarity(exemplar, image)
    assert found.completeness_de76 == pytest.approx(by_hand(exemplar, image))
    assert found.coherence_de76 == pytest.approx(by_hand(image, exemplar))
    assert found.distance_de76 == pytest.approx((found.completeness_de76 + found.coherence_de76) / 2)


def test_where_an_image_begins_makes_no_difference():
    whole = lab_noise(131, 131, 9)
    for row, col in ((0, 0), (1, 2), (3, 3)):
        part = whole[row : row + 120, col : col + 120]
        assert bidirectional_similarity(whole, part).coherence_de76 < 1e-5


def test_same_image_has_no_distance():
    exemplar = lab_noise(80, 80, 4)
    assert bidirectional_similarity(exemplar, exemplar.copy()).distance_de76 < 1e-5


def test_a_shift_of_all_colours_counts_by_its_size():
    exemplar = lab_noise(60, 60, 5, 20)
    assert bidirectional_similarity(exemplar, exemplar + np.array([0, 3.0, 4.0])).distance_de76 <= 5
    flat = np.full((60, 60, 3), 50.0)
    assert bidirectional_similarity(flat, flat + np.array([0, 3.0, 4.0])).distance_de76 == pytest.approx(5)


def test_leaving_out_hurts_completeness_and_making_up_hurts_coherence():
    whole = lab_noise(128, 128, 6)
    part = whole[:64, :64]
    left_out = bidirectional_similarity(whole, part)
    assert left_out.coherence_de76 < 1e-5
    assert left_out.completeness_de76 > 1
    made_up = bidirectional_similarity(part, whole)
    assert made_up.completeness_de76 < 1e-5
    assert made_up.coherence_de76 > 1


def test_unlike_textures_are_far():
    exemplar = lab_noise(128, 128, 7)
    tiled = np.tile(exemplar, (2, 2, 1))
    near = bidirectional_similarity(exemplar, tiled).distance_de76
    assert near < 0.5 * bidirectional_similarity(exemplar, lab_noise(256, 256, 8)).distance_de76


def test_thinning_changes_little():
    exemplar, image = lab_noise(128, 128, 9), lab_noise(160, 200, 10)
    whole = bidirectional_similarity(exemplar, image)
    thinned = bidirectional_similarity(exemplar, image, max_patches=200)
    assert thinned.distance_de76 != whole.distance_de76
    assert thinned.distance_de76 == pytest.approx(whole.distance_de76, rel=0.1)
    assert bidirectional_similarity(exemplar, image, max_patches=1).distance_de76 > 0


def test_misuse_is_refused():
    good = lab_noise(40, 40, 1)
    with pytest.raises(ValueError, match="needs 32 x 32 pixels; image is 40 x 31"):
        bidirectional_similarity(good, good[:, :31])
    with pytest.raises(ValueError, match=r"exemplar must be \(rows, cols, 3\) CIELAB"):
        bidirectional_similarity(good[:, :, 0], good)
    with pytest.raises(ValueError, match="aren't finite"):
        bidirectional_similarity(good, np.full((40, 40, 3), np.nan))
    with pytest.raises(ValueError, match="max_patches must be 1"):
        bidirectional_similarity(good, good, max_patches=0)
