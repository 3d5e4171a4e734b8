"""What the press makes of the stone: measured on points spread over the faces of a run."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import ConvexHull, QhullError

from tilefab import rng
from tilefab.colour import delta_e_2000, limit_total_ink, srgb_from_xyz, xyz_from_lab
from tilefab.colour.encoding import decode_lab16
from tilefab.colour.stages import grid_points
from tilefab.colour.transform import Colorimetric
from tilefab.pipeline.faces import face_region
from tilefab.pipeline.maps import JobMaps, press_black
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.press_tables import job_press
from tilefab.report import ColourView, InkView, SwatchView
from tilefab.sampling import render_points

_POINTS = 40_000
_POINTS_PER_FACE_AT_LEAST = 200
_PLOTTED = 1200
_SWATCHES = 6
_MOST_RECIPES = 70_000
_MOST_LEVELS = 7
_OUT_OF_GAMUT_DELTA_E = 2.0


def colour_facts(plan: Plan, maps: JobMaps, faces: list[int]) -> ColourView:
    """Compare stone and print at points spread evenly at random over the faces of a run.

    Parameters
    ----------
    plan, maps
        The job.
    faces
        Indices of its finished faces, at least one.
    """
    colour = plan.job.colour
    rows, cols = _points(plan, maps, faces)
    stone = decode_lab16(render_points(maps.texture, rows, cols, seed=plan.seed))
    counts = render_points(maps.press, rows, cols, seed=plan.seed)
    inks = counts.astype(np.float32) / np.float32(np.iinfo(counts.dtype).max)
    # Stone and print are compared as the intent means them: against the glaze's white, or absolutely.
    compared: Colorimetric = "absolute" if colour.intent == "absolute" else "relative"
    transform = job_press(plan, colour.intent, maps.texture)
    printed = transform.lab_from_inks(inks[None], intent=compared)[0]
    wanted = transform.inks_from_lab(stone[None])[0]
    colorimetric = job_press(plan, compared)
    nearest = colorimetric.lab_from_inks(colorimetric.inks_from_lab(stone[None]), intent=compared)[0]
    difference = np.asarray(delta_e_2000(stone, printed))
    missed = np.asarray(delta_e_2000(stone, nearest))
    beyond = missed[missed > _OUT_OF_GAMUT_DELTA_E]
    total = 100.0 * inks.sum(axis=1)
    recipes = limit_total_ink(_recipes(transform.inks), colour.ink_limit_percent, press_black(plan, transform))
    gamut = transform.lab_from_inks(recipes[np.newaxis], intent=compared)[0].astype(np.float64)
    random = rng.generator(plan.seed, "plotted colours")
    plotted = stone[random.choice(len(stone), min(_PLOTTED, len(stone)), replace=False)]
    return ColourView(
        press_profile=plan.press_profile.description,
        intent=colour.intent,
        ink_limit_percent=colour.ink_limit_percent,
        max_total_ink_percent=float(100.0 * _largest_total(maps)),
        mean_total_ink_percent=float(total.mean()),
        share_limited=float((wanted.sum(axis=1) > colour.ink_limit_percent / 100 + 1e-4).mean()),
        inks=tuple(
            InkView(
                name,
                float(100 * inks[:, k].mean()),
                float(100 * inks[:, k].max()),
                float(inks[:, k].mean()),
            )
            for k, name in enumerate(maps.press.channels)
        ),
        swatches=_swatches(stone, printed, random),
        slab_lab_sample=plotted.astype(np.float64),
        gamut_ab=_hull(gamut[:, 1:]),
        gamut_lc=_hull(np.stack([gamut[:, 0], np.hypot(gamut[:, 1], gamut[:, 2])], axis=1)),
        delta_e_mean=float(difference.mean()),
        delta_e_p95=float(np.percentile(difference, 95)),
        out_of_gamut_share=len(beyond) / len(missed),
        out_of_gamut_mean=float(beyond.mean()) if len(beyond) else 0.0,
        out_of_gamut_p95=float(np.percentile(beyond, 95)) if len(beyond) else 0.0,
    )


def _points(plan: Plan, maps: JobMaps, faces: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    random = rng.generator(plan.seed, "colour facts")
    per_face = max(_POINTS_PER_FACE_AT_LEAST, _POINTS // len(faces))
    chosen = faces if len(faces) * per_face <= 2 * _POINTS else faces[:: -(-len(faces) * per_face // (2 * _POINTS))]
    rows, cols = [], []
    for face in chosen:
        region = face_region(plan, maps.press, face)
        rows.append(region.row + random.integers(region.rows, size=per_face))
        cols.append(region.col + random.integers(region.cols, size=per_face))
    return np.concatenate(rows), np.concatenate(cols)


def _largest_total(maps: JobMaps) -> float:
    """Largest total ink anywhere in the map, hence in any face: 1 = one ink in full."""
    base = maps.press.base
    full = float(np.iinfo(base.dtype).max)
    return max(float(base[k : k + 256].sum(axis=2, dtype=np.int64).max()) / full for k in range(0, len(base), 256))


def _swatches(
    stone: NDArray[np.float32],
    printed: NDArray[np.float32],
    random: np.random.Generator,
) -> tuple[SwatchView, ...]:
    data = stone.astype(np.float64)
    starts = data[random.choice(len(data), min(_SWATCHES, len(data)), replace=False)]
    label = np.zeros(len(data), dtype=np.int64)
    if np.ptp(data, axis=0).any():
        with warnings.catch_warnings():
            # A stone of few colours leaves clusters without a member: they are left out.
            warnings.filterwarnings("ignore", message="One of the clusters is empty")
            _, label = kmeans2(data, starts, minit="matrix", iter=20, missing="warn")
    swatches = []
    for k in np.unique(label):
        members = label == k
        lab_stone, lab_printed = data[members].mean(axis=0), printed[members].mean(axis=0, dtype=np.float64)
        swatches.append(
            SwatchView(
                lab_slab=_triple(lab_stone),
                lab_printed=_triple(lab_printed),
                delta_e_2000=float(delta_e_2000(lab_stone, lab_printed)),
                share=float(members.mean()),
                rgb_slab=_rgb(lab_stone),
                rgb_printed=_rgb(lab_printed),
            )
        )
    return tuple(sorted(swatches, key=lambda s: -s.share))


def _recipes(inks: int) -> NDArray[np.float64]:
    """All mixtures of some levels of each ink: as many levels as there is time for."""
    levels = next(count for count in range(_MOST_LEVELS, 1, -1) if count**inks <= _MOST_RECIPES)
    return grid_points((np.linspace(0.0, 1.0, levels),) * inks)


def _hull(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convex outline, in order; all points where they span no area."""
    try:
        outline: NDArray[np.float64] = points[ConvexHull(points).vertices]
    except QhullError:
        return points
    return outline


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _rgb(lab: NDArray[np.float64]) -> tuple[int, int, int]:
    red, green, blue = np.rint(np.clip(srgb_from_xyz(xyz_from_lab(lab)), 0, 1) * 255).astype(int)
    return int(red), int(green), int(blue)
