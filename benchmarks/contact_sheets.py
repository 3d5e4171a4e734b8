"""Contact sheets of grown textures, to look at: the exemplar, and what each method grows from it, at full size.

By default of stones that may be shown (scikit-image's photographs, CC0, and drawn ones), into docs/images/synthesis.
With --study, of the textures of the study with people as well, beside the published images of self-tuning texture
optimisation and LazyFluids; they belong to others, so those sheets go where --study-out says.

Usage: python benchmarks/contact_sheets.py [--methods NAME ...] [--seed N] [--fast] [--out FOLDER] [--stones NAME ...]
                                           [--study FOLDER --study-out FOLDER [--only TEXTURE ...] [--grown FOLDER]]

--grown takes the study's images from what `synthesis_panel.py --save` kept, instead of growing them again.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from stones import DRAWN, PHOTOGRAPHS, stone, study_exemplar

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.synthesis.protocol import render
from tilefab.types import SizePx

Rgb = NDArray[np.uint8]

ROOT = Path(__file__).resolve().parents[1]
DEFAULT_OUT = ROOT / "docs" / "images" / "synthesis"
PUBLISHED = {"self-tuning, published": "method_self_tuning.png", "LazyFluids, published": "method_Sykora.png"}
GROWN_PX = SizePx(384, 640)
LARGEST_BYTES = 600_000
QUALITIES = range(90, 30, -5)
COLUMNS = 2
GAP_PX, LABEL_PX = 8, 22


def main() -> None:
    """Draw, and print what was written."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=sorted(METHODS), default=sorted(METHODS), metavar="NAME")
    parser.add_argument("--seed", default=1, type=int)
    parser.add_argument("--fast", action="store_true", help="the methods' faster ways")
    parser.add_argument("--out", default=DEFAULT_OUT, type=Path)
    parser.add_argument("--stones", nargs="*", choices=[*PHOTOGRAPHS, *DRAWN], default=[*PHOTOGRAPHS, *DRAWN])
    parser.add_argument("--study", type=Path, metavar="FOLDER", help="folder of the study's textures")
    parser.add_argument("--study-out", type=Path, metavar="FOLDER", help="where their sheets go")
    parser.add_argument("--only", nargs="+", metavar="TEXTURE", help="only these of the study")
    parser.add_argument("--grown", type=Path, metavar="FOLDER", help="METHOD/TEXTURE_SEED.png are there already")
    arguments = parser.parse_args()
    if (arguments.study is None) != (arguments.study_out is None):
        parser.error("--study and --study-out belong together")
    for name in arguments.stones:
        exemplar = stone(name)
        grown = {method: grow(exemplar, GROWN_PX, method, arguments) for method in arguments.methods}
        write(arguments.out / f"{name}.jpg", exemplar, grown)
    if arguments.study is None:
        return
    for folder in sorted(path.parent for path in arguments.study.glob("*/exemplar.png")):
        if arguments.only and folder.name not in arguments.only:
            continue
        exemplar = study_exemplar(folder)
        images = {label: opened(folder / file) for label, file in PUBLISHED.items()}
        rows, cols = next(iter(images.values())).shape[:2]
        for method in arguments.methods:
            kept = arguments.grown and arguments.grown / method / f"{folder.name}_{arguments.seed}.png"
            images[method] = (
                opened(kept) if kept and kept.is_file() else grow(exemplar, SizePx(rows, cols), method, arguments)
            )
        write(arguments.study_out / f"{folder.name}.jpg", exemplar, images)


def opened(path: Path) -> Rgb:
    """An image file as sRGB, whatever its mode."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def grow(exemplar: Rgb, size: SizePx, method: str, arguments: argparse.Namespace) -> Rgb:
    """A texture that needn't repeat."""
    lab = np.asarray(lab_from_xyz(scan_to_xyz(exemplar, None)), dtype=np.float32)
    valid = np.ones(lab.shape[:2], dtype=bool)
    begin = time.perf_counter()
    request = SynthesisRequest(lab, valid, size, arguments.seed, toroidal=False, fast=arguments.fast)
    source = METHODS[method](request).source
    print(f"  {method}: {time.perf_counter() - begin:.1f} s", flush=True)
    return render(exemplar, source)


def write(path: Path, exemplar: Rgb, images: dict[str, Rgb]) -> None:
    """One sheet as JPEG, of quality 90 if it is then small enough to keep."""
    data = jpeg(sheet([("exemplar", exemplar), *images.items()], COLUMNS))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    print(f"{path}: {len(data) / 1e3:.0f} kB", flush=True)


def sheet(cells: Sequence[tuple[str, Rgb]], columns: int) -> Image.Image:
    """Labelled images side by side, so many in a row, none scaled."""
    lines = [cells[k : k + columns] for k in range(0, len(cells), columns)]
    widths = [max(line[k][1].shape[1] for line in lines if k < len(line)) for k in range(min(columns, len(cells)))]
    heights = [max(image.shape[0] for _, image in line) + LABEL_PX for line in lines]
    whole = Image.new(
        "RGB", (sum(widths) + GAP_PX * (len(widths) + 1), sum(heights) + GAP_PX * (len(heights) + 1)), "white"
    )
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(size=15)
    top = GAP_PX
    for line, height in zip(lines, heights, strict=True):
        left = GAP_PX
        for (label, image), width in zip(line, widths, strict=False):
            draw.text((left, top), label, fill="black", font=font)
            whole.paste(Image.fromarray(image), (left, top + LABEL_PX))
            left += width + GAP_PX
        top += height + GAP_PX
    return whole


def jpeg(picture: Image.Image) -> bytes:
    """The picture, of the highest quality that keeps it small enough."""
    for quality in QUALITIES:
        file = io.BytesIO()
        picture.save(file, "JPEG", quality=quality, optimize=True)
        if file.tell() <= LARGEST_BYTES:
            break
    return file.getvalue()


if __name__ == "__main__":
    main()
