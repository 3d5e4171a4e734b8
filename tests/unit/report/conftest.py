"""View models to draw: a usual run, the least that can be, and the worst that might come."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from tilefab.report import (
    ChartView,
    ColourView,
    FaceView,
    HistogramView,
    InkView,
    PictureView,
    RunReportView,
    SwatchView,
    TextureMapView,
)

LONG = "Mármore – Größe 60×120 Ž 大理石 رخام " + "Very_long_name-" * 11


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def picture(rows: int, cols: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (rows, cols, 3), dtype=np.uint8)


def chart(title: str, histogram: HistogramView) -> ChartView:
    return ChartView(title, "pixels", "crops", histogram)


@pytest.fixture(scope="session")
def typical() -> RunReportView:
    rng = np.random.default_rng(7)
    turn = np.linspace(0.0, 2 * np.pi, 20, endpoint=False)
    faces = tuple(
        FaceView(
            index=index,
            code=f"tilefab:1:job={digest('job')}:face={index}:map={digest('map')[:40]}",
            thumbnail=picture(30, 15, index),
            file_name=f"verde_{index:05d}.tif",
            origin=f"at x {607 * index} mm",
            sha256=digest(str(index)),
        )
        for index in range(14)
    )
    colour = ColourView(
        press_profile="Press A, six inks",
        intent="relative colorimetric",
        ink_limit_percent=180.0,
        max_total_ink_percent=179.5,
        mean_total_ink_percent=75.3,
        share_limited=0.031,
        inks=(
            InkView("Cyan", 12.4, 66.0, 0.124),
            InkView("Brown", 0.02, 97.5, 0.0002),
            InkView("Beige", 0, 0, 0),
        ),
        swatches=(
            SwatchView((30.0, -9.0, 4.0), (31.0, -7.5, 4.2), 0.87, 0.6, (60, 80, 70), (66, 80, 66)),
            SwatchView((78.0, -5.0, 8.0), (75.0, -3.9, 8.2), 4.41, 0.4, (190, 190, 170), (185, 184, 168)),
        ),
        slab_lab_sample=rng.normal((50.0, -6.0, 5.0), (12.0, 4.0, 4.0), (2000, 3)),
        gamut_ab=np.stack([8 + 34 * np.cos(turn), 12 + 40 * np.sin(turn)], axis=1),
        gamut_lc=np.array([[12.0, 0.0], [40.0, 48.0], [60.0, 52.0], [93.0, 0.0]]),
        delta_e_mean=1.42,
        delta_e_p95=3.9,
        out_of_gamut_share=0.064,
        out_of_gamut_mean=3.1,
        out_of_gamut_p95=6.7,
    )
    texture_map = TextureMapView(
        pictures=(
            PictureView("Exemplar", "the slab as it was prepared", picture(50, 80, 2)),
            PictureView("Crops", "seams between them are white", picture(40, 60)),
            PictureView("Use", "how often each place shows", picture(40, 60, 1)),
        ),
        facts=(("Crops", "812"), ("Seed", "20260115")),
        charts=(
            chart("Cost", HistogramView(np.linspace(0, 0.08, 21), rng.integers(0, 90, 20))),
            chart("Size", HistogramView(np.linspace(0, 60000, 11), rng.integers(0, 90, 10))),
        ),
    )
    return RunReportView(
        title="Verde Alpi 60×120",
        job_file="jobs/verde_alpi.toml",
        job_hash=digest("job"),
        map_hash=digest("map"),
        profile_hash=digest("profile"),
        created="2026-01-15 14:32",
        software_version="0.1.0",
        facts=(("Tile", "600 × 1200 mm"), ("Seed", "20260115")),
        wall_preview=picture(60, 100, 3),
        wall_caption="Twenty faces laid 2 × 10.",
        faces=faces,
        colour=colour,
        texture_map=texture_map,
        preparation=(("Trim", "Cut 14 mm off each side."), ("Mask", "Left out 0.7 % of the slab.")),
        warnings=("3.1 % of pixels were reduced to the ink limit.",),
    )


@pytest.fixture(scope="session")
def minimal(typical: RunReportView) -> RunReportView:
    pixel = np.full((1, 1, 3), 128, np.uint8)
    colour = replace(
        typical.colour,
        ink_limit_percent=None,
        inks=(),
        swatches=(),
        slab_lab_sample=np.zeros((0, 3)),
        gamut_ab=np.zeros((0, 2)),
        gamut_lc=np.zeros((0, 2)),
    )
    texture_map = TextureMapView(
        pictures=(PictureView("", "", pixel),),
        facts=(),
        charts=(
            chart("", HistogramView(np.zeros(0), np.zeros(0))),
            chart("", HistogramView(np.array([1.0, 2.0]), np.array([0]))),
        ),
    )
    return replace(
        typical,
        title="",
        job_file="",
        job_hash="",
        created="",
        software_version="",
        facts=(),
        wall_preview=pixel,
        wall_caption="",
        faces=(FaceView(0, "0", None, "", "", ""),),
        colour=colour,
        texture_map=texture_map,
        preparation=(),
        warnings=(),
    )


@pytest.fixture(scope="session")
def extreme(typical: RunReportView) -> RunReportView:
    faces = tuple(
        FaceView(
            index=10**15 + index,
            code=f"tilefab:{digest(str(index))}:{digest('job')}:{10**15 + index}",
            thumbnail=typical.faces[0].thumbnail,
            file_name="/mnt/out/" + "deep/" * 30 + LONG + f"{index}.tif",
            origin="9" * 200,
            sha256=digest(str(index)),
        )
        for index in range(1000)
    )
    swatch = SwatchView((1e6, -1e6, 1e6), (50.0, -128.0, 127.0), 12345.678, 1.0, (255, 255, 255), (0, 0, 0))
    colour = replace(
        typical.colour,
        press_profile=LONG * 3,
        intent=LONG,
        ink_limit_percent=1e12,
        max_total_ink_percent=1e12,
        mean_total_ink_percent=1e15,
        delta_e_mean=123456.7,
        delta_e_p95=1e8,
        out_of_gamut_share=1.0,
        out_of_gamut_mean=1e5,
        out_of_gamut_p95=2e5,
        share_limited=1e-9,
        inks=tuple(InkView(f"{LONG}{place}", 1e6 * place + 0.5, 1e9, 1e7) for place in range(12)),
        swatches=(swatch,) * 24,
        gamut_ab=np.array([[5.0, 5.0]]),
        slab_lab_sample=np.zeros((100_000, 3), np.float32),
    )
    texture_map = replace(
        typical.texture_map,
        pictures=(
            PictureView(LONG, LONG * 3, np.zeros((4000, 20, 3), np.uint8)),
            PictureView(LONG, LONG * 3, np.zeros((20, 4000, 3), np.uint8)),
            *typical.texture_map.pictures[:2],
        ),
        facts=((LONG, LONG * 4),) * 21,
        charts=(
            ChartView(LONG, LONG, LONG, HistogramView(np.arange(5001.0) * 1e9, np.arange(5000))),
            ChartView(LONG, LONG, LONG, HistogramView(np.array([0.0, 1e-12]), np.array([10**12]))),
        ),
    )
    return replace(
        typical,
        title=LONG * 3,
        job_file="/home/" + LONG * 4,
        job_hash=digest("x") * 2,
        created=LONG,
        software_version=LONG,
        facts=((LONG, LONG * 5),) * 40,
        wall_preview=np.full((3000, 100, 3), 77, np.uint8),
        wall_caption=LONG * 6,
        faces=faces,
        max_contact_faces=20,
        colour=colour,
        texture_map=texture_map,
        preparation=((LONG, LONG * 20),) * 8,
        warnings=(LONG * 9,) * 12,
    )
