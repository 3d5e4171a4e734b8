"""How good walls are, against published results, plain quilting and the slab itself. Wants the texture data.

Usage: python benchmarks/walls.py [--textures FOLDER] [--seeds N] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from baseline_quilting import quilt
from machine import machine_name
from numpy.typing import NDArray
from PIL import Image

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.sampling import CropMap, CropOptions, build_crop_map, render
from tilefab.texture.panel import Panel, measure_panel
from tilefab.texture.repetition import gather_cells, lattice_ghost, static_share, usage, verbatim
from tilefab.texture.seam_cost import seam_cost
from tilefab.texture.veins import vein_continuity

TEXTURES = ("blades", "greenmarble", "grid", "noise", "pebbles", "rough")
PUBLISHED = "method_self_tuning.png"
WALL_EXEMPLARS = 10
VEIN_EXEMPLARS = 6
CELLS = 1000
QUILT_EXEMPLARS = 5


def read_lab(path: Path) -> NDArray[np.float32]:
    """Image as CIELAB (D50)."""
    pixels = np.asarray(Image.open(path).convert("RGB"))
    return lab_from_xyz(np.maximum(scan_to_xyz(pixels, None), 0)).astype(np.float32)


def source_map(texture_map: CropMap, row: int, col: int, rows: int, cols: int, seed: int) -> NDArray[np.int32]:
    """Where on the exemplar each pixel of a region comes from, as flat index."""
    shape = texture_map.base.shape[:2]
    places = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(*shape, 1)
    return np.asarray(render(texture_map.with_base(places, "places", ("i",)), row, col, rows, cols, seed=seed)[..., 0])


def ratios(ours: Panel, published: Panel) -> NDArray[np.float64]:
    """Portilla-Simoncelli, radial PSD and bidirectional, ours divided by theirs."""
    return np.array(
        [
            ours.portilla_simoncelli / published.portilla_simoncelli,
            ours.radial_psd / published.radial_psd,
            ours.bidirectional_de76 / published.bidirectional_de76,
        ]
    )


def measure(name: str, folder: Path, seeds: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Print the figures of one texture; returns its panel ratios and its seam ratios."""
    lab = read_lab(folder / name / "exemplar.png")
    shape = (lab.shape[0], lab.shape[1])
    begin = time.perf_counter()
    texture_map = build_crop_map(
        lab, np.ones(shape, dtype=bool), CropOptions(), stored=lab, space="lab", channels=("L", "a", "b"), dpi=100
    )
    built = time.perf_counter() - begin
    published = measure_panel(lab, read_lab(folder / name / PUBLISHED))
    panels, gates = [], set[str]()
    for seed in range(seeds):
        # Nowhere in particular: a wall must not be measured on the same grid as it is laid.
        origin = 1000 + 37 * seed, 5003 + 26 * seed
        panel = measure_panel(lab, render(texture_map, *origin, 3 * shape[0], 2 * shape[1], seed=seed))
        panels.append(np.log(ratios(panel, published)))
        gates |= set(panel.failed_gates)
    panel_ratio = np.exp(np.mean(panels, axis=0))
    side = WALL_EXEMPLARS
    wall = source_map(texture_map, 0, 0, side * shape[0], side * shape[1], seed=1)
    seams, used, whole = seam_cost(wall, lab), usage(wall, shape), verbatim(wall, shape)
    block = texture_map.crop_px
    quilted = quilt(
        lab, QUILT_EXEMPLARS * shape[0], QUILT_EXEMPLARS * shape[1], block, texture_map.overlap_px, 0, exact=False
    )
    base, base_used = seam_cost(quilted, lab), usage(quilted, shape)
    seam_ratio = np.array([seams.mean_delta_e / base.mean_delta_e, seams.p95_delta_e / base.p95_delta_e])
    cells_a_side = int(np.ceil(CELLS**0.5))
    pitch = texture_map.pitch_px
    cells = gather_cells(source_map(texture_map, 0, 0, cells_a_side * pitch, cells_a_side * pitch, seed=2), pitch)
    cells = cells[:CELLS]
    veins = vein_continuity(
        lab, render(texture_map, 0, 0, VEIN_EXEMPLARS * shape[0], VEIN_EXEMPLARS * shape[1], seed=3)
    )
    print(
        f"{name}: cells of {pitch} px, overlap {texture_map.overlap_px} px, built in {built:.1f} s\n"
        f"  panel / published self-tuning: PS {panel_ratio[0]:.2f}, PSD {panel_ratio[1]:.2f}, bidirectional "
        f"{panel_ratio[2]:.2f}; gates failed: {', '.join(sorted(gates)) or 'none'}\n"
        f"  seams: mean {seams.mean_delta_e:.2f}, 95 % {seams.p95_delta_e:.1f} CIE76; / quilting {seam_ratio[0]:.2f}, "
        f"{seam_ratio[1]:.2f} (quilting covers {base_used.coverage:.3f}, uses a place up to "
        f"{base_used.most_over_mean:.1f} x)\n"
        f"  coverage {used.coverage:.3f}, most-used / mean {used.most_over_mean:.2f}; verbatim mean {whole.mean:.4f}, "
        f"max {whole.most:.3f}\n"
        f"  static share {static_share(cells):.3f}, lattice ghost {lattice_ghost(lab.reshape(-1, 3)[cells], lab):.2f} "
        f"({len(cells)} cells)\n"
        f"  veins / exemplar: median {veins.median_ratio:.2f}, 90 % {veins.p90_ratio:.2f}",
        flush=True,
    )
    return panel_ratio, seam_ratio


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--textures", type=Path, default=Path("../shared/textures"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=TEXTURES)
    arguments = parser.parse_args()
    if not arguments.textures.is_dir():
        print(f"skipped: no textures at {arguments.textures}")
        return
    print(f"on {machine_name()}; {arguments.seeds} seeds")
    results = [measure(name, arguments.textures, arguments.seeds) for name in arguments.only]
    panel = np.exp(np.log([panel for panel, _ in results]).mean(axis=0))
    seams = np.exp(np.log([seams for _, seams in results]).mean(axis=0))
    print(
        f"geometric means: PS {panel[0]:.2f}, PSD {panel[1]:.2f}, bidirectional {panel[2]:.2f}; seams / quilting: mean "
        f"{seams[0]:.2f}, 95 % {seams[1]:.2f}"
    )


if __name__ == "__main__":
    main()
