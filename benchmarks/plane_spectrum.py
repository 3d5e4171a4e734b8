"""Picture of the power spectrum of a 50 x 50 cell preview of a made-up stone: a period would be a bright dot.

Usage: python benchmarks/plane_spectrum.py [--out FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from tilefab.sampling import CropOptions, build_crop_map, render

SIDE = 300
CELLS = 50
CELL_PX = 8


def main() -> None:
    """Render, transform, save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images/walls/spectrum.png"))
    out = parser.parse_args().out
    random = np.random.default_rng(3)
    lightness = ndimage.gaussian_filter(random.normal(0, 1, (SIDE, SIDE)), 5)
    lightness = (55 + 12 * lightness / lightness.std()).astype(np.float32)
    lab = np.stack([lightness, 0 * lightness, 0.1 * lightness], axis=2)
    valid = np.ones((SIDE, SIDE), dtype=bool)
    texture_map = build_crop_map(lab, valid, CropOptions(), stored=lab, space="lab", channels=("L", "a", "b"), dpi=100)
    pitch = texture_map.pitch_px
    plane = render(texture_map, 0, 0, CELLS * pitch, CELLS * pitch, seed=1)[..., 0]
    zoom = CELL_PX / pitch
    preview = ndimage.zoom(ndimage.uniform_filter(plane, 1 / zoom), zoom, order=1)
    window = np.hanning(preview.shape[0])[:, None] * np.hanning(preview.shape[1])
    power = np.fft.fftshift(np.abs(np.fft.fft2((preview - preview.mean()) * window)) ** 2)
    level = np.log(power + power.max() * 1e-8)
    grey = (255 * (level - level.min()) / np.ptp(level)).astype(np.uint8)
    low, high = preview.min(), preview.max()
    picture = (255 * (preview - low) / (high - low)).astype(np.uint8)
    gap = np.full((picture.shape[0], 12), 255, dtype=np.uint8)
    out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.hstack([picture, gap, grey[: picture.shape[0]]])).save(out)
    print(f"{out}: preview of {CELLS} x {CELLS} cells and its power spectrum")


if __name__ == "__main__":
    main()
