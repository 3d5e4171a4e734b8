"""Tests of laying an image over a face."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from tilefab.chart.finding import project
from tilefab.inspection.registration import register, start_matrix, warp_mask_to_face, warp_to_face
from tilefab.inspection.registration_kernels import resample, resample_plain, step_sums, step_sums_plain

GRID = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), axis=-1).reshape(-1, 2)


def stone(shape, seed, contrast=6.0):
    """L* of a made-up stone: grains of several sizes."""
    random = np.random.default_rng(seed)
    grains = [ndimage.gaussian_filter(random.standard_normal(shape), size) for size in (1.5, 5, 25)]
    values = sum(weight * grain / grain.std() for weight, grain in zip((1, 1, 2), grains, strict=True))
    return (60 + contrast * values / values.std()).astype(np.float32)


def corners_of(shape):
    rows, cols = shape
    return np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=float)


def lying(shape, side, *, turn_deg, scale, shift=(0.0, 0.0), perspective=(0.0, 0.0)):
    """Homography of a face turned about the middle of a square image."""
    angle = np.radians(turn_deg)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.eye(3)
    matrix[:2, :2] = turn
    matrix[:2, 2] = side / 2 + np.array(shift) - turn @ np.array([shape[1], shape[0]]) / 2
    matrix[2, :2] = np.array(perspective) / max(shape)
    return matrix / matrix[2, 2]


def photo(face_l, matrix, side, seed, *, noise=0.6, blur=0.6, light=0.08):
    """L* of an image: blurred, unevenly lit, drifted, noisy; 15 around the tile. And the mask of the tile."""
    random = np.random.default_rng(seed + 1000)
    back = np.linalg.inv(matrix)
    out, fine = np.zeros((side, side)), 3
    for i in range(fine):
        for j in range(fine):
            y, x = np.meshgrid(np.arange(side) + (i + 0.5) / fine, np.arange(side) + (j + 0.5) / fine, indexing="ij")
            place = project(back, np.stack([x, y], axis=-1))
            out += ndimage.map_coordinates(face_l, [place[..., 1] - 0.5, place[..., 0] - 0.5], order=1, cval=15.0)
    out = ndimage.gaussian_filter(out / fine**2, blur)
    y, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    place = project(back, np.stack([x, y], axis=-1) * side / 2 + side / 2)
    inside = (place > 0).all(axis=-1) & (place[..., 0] < face_l.shape[1]) & (place[..., 1] < face_l.shape[0])
    out = (1.04 * out - 2.0) * (1 + light * (0.6 * x - 0.5 * y - 0.3 * x * y) / 2)
    return (out + noise * random.standard_normal(out.shape)).astype(np.float32), inside


def rms_px(found, true, shape):
    places = GRID * [shape[1], shape[0]]
    return float(np.sqrt(((project(found, places) - project(true, places)) ** 2).sum(axis=1).mean()))


def off(corners, side, seed, share=0.02):
    random = np.random.default_rng(seed + 2000)
    return corners + side * (share * random.uniform(-1, 1, 2) + 0.2 * share * random.uniform(-1, 1, (4, 2)))


@pytest.mark.parametrize(
    ("shape", "scale", "turn_deg"),
    [((320, 320), 0.9, 2.0), ((300, 420), 0.8, 93.0), ((200, 200), 2.2, -178.0), ((640, 320), 0.3, -3.0)],
    ids=["as coarse", "turned", "finer image", "coarser image"],
)
def test_a_turned_shifted_scaled_and_drifted_tile_is_found_to_a_tenth_of_a_pixel(shape, scale, turn_deg) -> None:
    face, side = stone(shape, 1), round(1.2 * scale * max(shape))
    true = lying(shape, side, turn_deg=turn_deg, scale=scale, shift=(1.7, -2.2))
    fired, valid = photo(face, true, side, 1)
    start = start_matrix(off(project(true, corners_of(shape)), side, 1), shape)
    found = register(face, fired, start, valid=valid)
    assert rms_px(start, true, shape) > 1.0
    assert rms_px(found.matrix, true, shape) < 0.1
    assert found.converged
    assert found.likeness > 0.9
    assert found.rms_step_px < 0.05


def test_perspective_is_found() -> None:
    shape, side = (400, 400), 420
    true = lying(shape, side, turn_deg=1.0, scale=0.85, perspective=(0.03, -0.02))
    face = stone(shape, 2)
    fired, valid = photo(face, true, side, 2)
    flat = lying(shape, side, turn_deg=1.0, scale=0.85)
    found = register(face, fired, flat, valid=valid)
    assert rms_px(flat, true, shape) > 1.5
    assert rms_px(found.matrix, true, shape) < 0.05


def test_without_a_mask_the_belt_does_not_pull() -> None:
    shape, side = (320, 320), 340
    true = lying(shape, side, turn_deg=-2.0, scale=0.9)
    face = stone(shape, 3)
    fired, _ = photo(face, true, side, 3)
    found = register(face, fired, start_matrix(off(project(true, corners_of(shape)), side, 3), shape))
    assert rms_px(found.matrix, true, shape) < 0.1


@pytest.mark.parametrize("known", [True, False], ids=["masked", "unnoticed"])
def test_a_third_covered_or_broken_off_does_not_pull(known: bool) -> None:
    shape, side = (400, 400), 440
    true = lying(shape, side, turn_deg=3.0, scale=0.9)
    face = stone(shape, 4)
    fired, valid = photo(face, true, side, 4)
    fired[:190, 150:] = 40.0 + np.random.default_rng(1).standard_normal(fired[:190, 150:].shape)
    if known:
        valid[:190, 150:] = False
    start = start_matrix(off(project(true, corners_of(shape)), side, 5), shape)
    found = register(face, fired, start, valid=valid)
    seen = project(true, GRID * 400)
    seen = GRID[~((seen[:, 1] < 190) & (seen[:, 0] > 150))] * 400
    error = np.sqrt(((project(found.matrix, seen) - project(true, seen)) ** 2).sum(axis=1).mean())
    assert error < 0.1
    assert found.converged


def test_edges_that_the_camera_blurs_are_no_outliers() -> None:
    # A wall of even bricks: nearly all that can be held on to are the joints.
    shape, side = (400, 400), 420
    face = np.full(shape, 40.0, dtype=np.float32)
    face[::40] = face[1::40] = face[2::40] = 70.0
    random = np.random.default_rng(6)
    for row in range(0, 400, 40):
        for col in np.cumsum(random.integers(30, 90, 12)):
            face[row : row + 40, col : col + 3] = 70.0
    true = lying(shape, side, turn_deg=2.0, scale=0.85)
    fired, valid = photo(face, true, side, 6, blur=1.1, noise=0.3)
    found = register(
        face, fired, start_matrix(off(project(true, corners_of(shape)), side, 6, 0.01), shape), valid=valid
    )
    assert rms_px(found.matrix, true, shape) < 0.05


def test_what_fits_well_stays() -> None:
    shape, side = (300, 300), 300
    true = lying(shape, side, turn_deg=0.0, scale=0.9)
    face = stone(shape, 7)
    fired, valid = photo(face, true, side, 7)
    once = register(face, fired, true, valid=valid)
    again = register(face, fired, once.matrix, valid=valid)
    assert rms_px(again.matrix, once.matrix, shape) < 0.01


def test_another_face_is_not_laid_over() -> None:
    shape, side = (300, 300), 310
    true = lying(shape, side, turn_deg=2.0, scale=0.9)
    fired, valid = photo(stone(shape, 8), true, side, 8)
    found = register(stone(shape, 9), fired, true, valid=valid)
    assert not found.converged
    assert found.likeness < 0.2


def test_a_plain_face_stays_where_it_was() -> None:
    shape, side = (200, 200), 220
    start = lying(shape, side, turn_deg=1.0, scale=0.9)
    fired, valid = photo(np.full(shape, 80.0, dtype=np.float32), start, side, 10)
    found = register(np.full(shape, 80.0, dtype=np.float32), fired, start, valid=valid)
    assert not found.converged
    np.testing.assert_array_equal(found.matrix, start / start[2, 2])


def test_nothing_seen_leaves_the_start() -> None:
    start = lying((100, 100), 120, turn_deg=1.0, scale=0.9)
    fired = np.full((120, 120), 50.0, dtype=np.float32)
    found = register(stone((100, 100), 1), fired, start, valid=np.zeros((120, 120), dtype=bool))
    assert not found.converged
    assert found.likeness == 0.0


def test_misuse_is_refused() -> None:
    face, start = stone((64, 64), 1), np.eye(3)
    with pytest.raises(ValueError, match="predicted_l must be float32"):
        register(face.astype(np.float64), face, start)
    with pytest.raises(ValueError, match="16 or more"):
        register(face, face[:10], start)
    with pytest.raises(ValueError, match="no numbers"):
        register(face, np.full_like(face, np.nan), start)
    with pytest.raises(ValueError, match="no homography"):
        register(face, face, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="mask's shape"):
        register(face, face, start, valid=np.ones((3, 3), dtype=bool))
    with pytest.raises(ValueError, match="three on a line"):
        start_matrix(np.array([[0, 0], [1, 0], [2, 0], [0, 1]]), (10, 10))
    with pytest.raises(ValueError, match="4 finite places"):
        start_matrix(np.zeros((3, 2)), (10, 10))
    with pytest.raises(ValueError, match="float32"):
        warp_to_face(face, start, (10, 10))


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-20, 20) for _ in range(8)]), st.integers(20, 400), st.integers(20, 400))
def test_start_matrix_takes_corners_to_corners(moves, rows, cols) -> None:
    corners = np.array([[0, 0], [300, 0], [300, 200], [0, 200]]) + np.array(moves).reshape(4, 2)
    matrix = start_matrix(corners, (rows, cols))
    np.testing.assert_allclose(project(matrix, corners_of((rows, cols))), corners, atol=1e-6)


@pytest.mark.parametrize("taps", [1, 2, 3])
def test_resample_is_its_plain_twin(taps: int) -> None:
    random = np.random.default_rng(taps)
    image = random.random((40, 50, 3), dtype=np.float32)
    matrix = np.array([[1.1, 0.1, -6.0], [-0.05, 0.9, 3.0], [1e-3, -5e-4, 1.0]])
    out, inside = np.empty((45, 60, 3), dtype=np.float32), np.empty((45, 60), dtype=bool)
    resample(image, matrix, taps, out, inside)
    plain, plain_inside = resample_plain(image, matrix, taps, (45, 60))
    np.testing.assert_array_equal(inside, plain_inside)
    assert 0.2 < inside.mean() < 0.95
    np.testing.assert_allclose(out, plain, atol=1e-5)


def test_resample_leaves_out_what_is_behind_the_camera() -> None:
    out, inside = np.empty((20, 20, 1), dtype=np.float32), np.empty((20, 20), dtype=bool)
    matrix = np.array([[1.0, 0, 0], [0, 1.0, 0], [-0.1, 0, 1.0]])
    resample(np.ones((20, 20, 1), dtype=np.float32), matrix, 1, out, inside)
    assert not inside[:, 10:].any()
    np.testing.assert_array_equal(
        inside, resample_plain(np.ones((20, 20, 1), dtype=np.float32), matrix, 1, (20, 20))[1]
    )


def test_step_sums_are_their_plain_twin() -> None:
    random = np.random.default_rng(4)
    template, moved = (stone((40, 50), seed) - np.float32(60) for seed in (1, 2))
    slope_y, slope_x = (np.asarray(slope, dtype=np.float32) for slope in np.gradient(template))
    seen = random.random((40, 50)) > 0.1
    matrix = np.array([[1.01, 0.02, -0.6], [-0.01, 0.99, 0.4], [1e-5, -2e-5, 1.0]])
    photometric = np.array([0.8, 0.3])
    normal, gradient = np.empty((10, 10)), np.empty(10)
    weights, squares = step_sums(
        template, slope_x, slope_y, moved, seen, matrix, photometric, 6.0, 1.5, normal, gradient
    )
    plain = step_sums_plain(template, slope_x, slope_y, moved, seen, matrix, photometric, 6.0, 1.5)
    np.testing.assert_allclose(np.triu(normal), np.triu(plain[0]), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(gradient, plain[1], rtol=1e-5, atol=1e-4)
    assert (weights, squares) == pytest.approx(plain[2:], rel=1e-6)


def test_warp_keeps_means_of_a_finer_image() -> None:
    random = np.random.default_rng(5)
    image = random.random((300, 300, 3), dtype=np.float32)
    warped, inside = warp_to_face(image, np.diag([3.0, 3.0, 1.0]), (100, 100))
    assert inside.all()
    blocks = image.reshape(100, 3, 100, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(warped, blocks, atol=1e-6)


def test_warp_of_a_smooth_image_is_exact_between_pixels() -> None:
    y, x = np.meshgrid(np.arange(60) + 0.5, np.arange(80) + 0.5, indexing="ij")
    image = (0.01 * x + 0.02 * y + 1e-4 * x * y).astype(np.float32)[:, :, np.newaxis]
    matrix = np.array([[0.5, 0.0, 20.3], [0.0, 0.5, 15.2], [0.0, 0.0, 1.0]])
    warped, _ = warp_to_face(image, matrix, (40, 40))
    down, across = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5, indexing="ij")
    u, v = 0.5 * across + 20.3, 0.5 * down + 15.2
    np.testing.assert_allclose(warped[:, :, 0], 0.01 * u + 0.02 * v + 1e-4 * u * v, atol=1e-5)


def test_a_warped_mask_counts_only_what_is_good_throughout() -> None:
    mask = np.ones((50, 50), dtype=bool)
    mask[20, 30] = False
    warped = warp_mask_to_face(mask, np.array([[1.0, 0, 0.3], [0, 1.0, 0.3], [0, 0, 1.0]]), (50, 50))
    assert not warped[19:22, 29:32].any()
    assert warped[:17].all()
    assert warped.sum() > 50 * 50 - 30
