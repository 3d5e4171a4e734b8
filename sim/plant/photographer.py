"""Makes the camera's images in a thread of its own: fires what was printed, photographs it, puts the file there."""

from __future__ import annotations

import queue
import threading
from dataclasses import asdict
from pathlib import Path

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy import ndimage

from sim.fired_tile import LaidPrint, fired_tile
from sim.kiln import Firing
from sim.plant.config import CameraConfig
from sim.plant.physics.camera import Layer, PhotoOrder, Subject
from sim.spectral_press import SpectralPress
from sim.tile_photo import PhotoConditions, photo_of
from tilefab.rng import generator

Image = NDArray[np.uint8]

_BLACK, _BLOWN, _GREY = 3, 252, 128
_SPOTS = 12


class Photographer:
    """Makes images one after another as they are ordered.

    Parameters
    ----------
    config
        The camera.
    press
        Name of the press, as in `sim.spectral_press`.

    Raises
    ------
    OSError
        If the folder can't be made.
    """

    def __init__(self, config: CameraConfig, press: str) -> None:
        self._config = config
        self._press = SpectralPress(press)
        self._folder = Path(config.folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._orders: queue.Queue[PhotoOrder | None] = queue.Queue()
        self._ending = False
        self._first_error: Exception | None = None
        self.pending = self.written = self.lost = 0
        self._counting = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="sim-camera", daemon=True)
        self._thread.start()

    def submit(self, order: PhotoOrder) -> None:
        """Let an image be made; lost if too many wait already. Returns at once."""
        with self._counting:
            if self.pending >= self._config.queue_len:
                self.lost += 1
                return
            self.pending += 1
        self._orders.put(order)

    def state(self) -> dict[str, int]:
        """How many images wait to be made, how many were written, and how many lost."""
        with self._counting:
            return {"pending": self.pending, "written": self.written, "lost": self.lost}

    def close(self) -> None:
        """Finish the image in hand; those that wait are never made.

        Raises
        ------
        RuntimeError
            If an image could not be made.
        """
        self._ending = True
        self._orders.put(None)
        self._thread.join()
        if self._first_error is not None:
            raise RuntimeError(f"an image could not be made: {self._first_error!r}") from self._first_error

    def _work(self) -> None:
        while (order := self._orders.get()) is not None and not self._ending:
            made = False
            try:
                self._write(order.name, self.image(order))
                made = True
            except Exception as error:
                # It is told when the plant ends: until then its wires work on.
                self._first_error = self._first_error or error
            with self._counting:
                self.pending -= 1
                self.written += made
                self.lost += not made

    def image(self, order: PhotoOrder) -> Image:
        """The image of an order, (rows, cols, 3) sRGB."""
        random = generator(self._config.seed, f"photo {order.number}")
        conditions = PhotoConditions(**asdict(order.view))
        image = self._photo(order.subject, conditions, random)
        if order.other is not None:
            image = _side_by_side(image, self._photo(order.other, conditions, random))
        if "camera_dirty" in order.faults:
            image = _through_dirt(image, self._config.seed)
        if "camera_black" in order.faults:
            image = random.integers(0, _BLACK + 1, image.shape, dtype=np.uint8)
        if "camera_blown" in order.faults:
            image = random.integers(_BLOWN, 256, image.shape, dtype=np.uint8)
        if "camera_torn" in order.faults:
            image[int(len(image) * random.uniform(0.3, 0.7)) :] = _GREY
        return image

    def _photo(self, subject: Subject, conditions: PhotoConditions, random: np.random.Generator) -> Image:
        config, fired = self._config, asdict(subject.fired)
        del fired["at"]
        prints = [_print(layer) for layer in subject.layers]
        # Finer than the camera, and a whole number of pixels for each of the print's.
        fine = config.px_per_mm
        if prints:
            fine = np.ceil(config.px_per_mm * prints[0].pitch_mm) / prints[0].pitch_mm
        size = (subject.width_mm, subject.length_mm)
        tile = fired_tile(prints, size, self._press, Firing(**fired), px_per_mm=fine)
        photo = photo_of(tile, fine, conditions, random, px_per_mm=config.px_per_mm, margin_mm=config.margin_mm)
        return photo.image

    def _write(self, name: str, image: Image) -> None:
        part = self._folder / f".{name}.part"
        if self._config.format == "tiff":
            tifffile.imwrite(part, image, photometric="rgb", compression="zlib", predictor=True)
        else:
            part.write_bytes(imagecodecs.png_encode(image, level=1))
        part.replace(self._folder / name)


def _print(layer: Layer) -> LaidPrint:
    kept = layer.kept
    pixels = np.frombuffer(kept.data, dtype="<u2" if kept.bits == 16 else np.uint8)
    return LaidPrint(pixels.reshape(-1, kept.cols, kept.channels), kept.pitch_mm, layer.offset_mm, layer.flaws)


def _side_by_side(one: Image, other: Image) -> Image:
    rows = max(len(one), len(other))
    both = [np.pad(image, ((0, rows - len(image)), (0, 0), (0, 0)), mode="edge") for image in (one, other)]
    return np.concatenate(both, axis=1)


def _through_dirt(image: Image, seed: int) -> Image:
    """An image through glass with soft dark spots on it, always the same ones in the same places."""
    random = generator(seed, "dirt on the glass")
    rows, cols = image.shape[:2]
    spots = np.zeros((rows, cols), dtype=np.float32)
    for row, col, dark in random.uniform(0.0, 1.0, (_SPOTS, 3)):
        spots[int(row * rows), int(col * cols)] += 0.3 + dark
    spread = 0.02 * min(rows, cols)
    spots = ndimage.gaussian_filter(spots, spread) * np.float32(2.0 * np.pi * spread**2)
    return np.asarray(image * np.clip(1.0 - 0.6 * spots, 0.05, 1.0)[:, :, np.newaxis], dtype=np.uint8)
