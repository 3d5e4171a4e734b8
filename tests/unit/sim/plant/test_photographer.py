"""Images as files: what they show of a tile, what faults make of them, and what is lost."""

from __future__ import annotations

import dataclasses
import threading
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile

from sim.fired_tile import LaidPrint, fired_tile
from sim.kiln import Firing
from sim.plant.config import CameraConfig
from sim.plant.photographer import Photographer
from sim.plant.physics.camera import Layer, PhotoOrder, Subject, View
from sim.plant.physics.firing import Fired
from sim.plant.physics.flaws import Flaw, KeptPrint
from sim.scanner import srgb_bytes
from sim.spectral_press import SpectralPress

STILL = View(0, 0.0, (0.0, 0.0), 1.0, 0.0, (1.0, 1.0, 1.0), 0.0, 0.0, 0.0, None, 0.0)
NORMAL = Fired(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0,) * 4)
PIXELS = np.kron(np.random.default_rng(1).integers(0, 150, (8, 10, 4)), np.ones((5, 5, 1))).astype(np.uint8)
MARGIN = 32


def subject(pixels=PIXELS, *flaws, fired=NORMAL):
    bits = 8 * pixels.itemsize
    kept = KeptPrint(pixels.astype(pixels.dtype.newbyteorder("<")).tobytes(), pixels.shape[1], 4, bits, 0.5)
    return Subject(25.0, 20.0, (Layer(kept, 0.0, flaws),), fired)


def order(subject_=None, number=1, view=STILL, faults=(), other=None, name="image.png"):
    return PhotoOrder(name, number, subject_ or subject(), view, faults, other)


@pytest.fixture
def studio(tmp_path):
    made = []

    def open_studio(**config):
        made.append(Photographer(CameraConfig(folder=str(tmp_path / "seen"), **config), "ceramic4"))
        return made[-1]

    yield open_studio
    for photographer in made:
        photographer.close()


def inner(image):
    """The tile, without the belt around it and its soft edges."""
    return image[MARGIN + 1 : -MARGIN - 1, MARGIN + 1 : -MARGIN - 1].astype(int)


def expected(pixels, firing=None):
    return srgb_bytes(
        fired_tile([LaidPrint(pixels, 0.5, 0.0)], (25.0, 20.0), SpectralPress("ceramic4"), firing, px_per_mm=4.0)
    )[1:-1, 1:-1]


def test_an_image_shows_what_was_printed_and_how_it_was_fired(studio):
    photographer = studio()
    image = photographer.image(order())
    assert (image.shape, image.dtype) == ((80 + 2 * MARGIN, 100 + 2 * MARGIN, 3), np.uint8)
    assert np.abs(inner(image) - expected(PIXELS)).max() <= 1
    assert image[:MARGIN].max() < 60
    hot = dataclasses.replace(NORMAL, peak_offset_degc=30.0, ink_offset_frac=(0.0, 0.0, 0.0, -0.3))
    seen = inner(photographer.image(order(subject(fired=hot))))
    assert np.abs(seen - expected(PIXELS, Firing(30.0, ink_offset_frac=(0.0, 0.0, 0.0, -0.3)))).max() <= 1
    assert np.abs(seen - inner(image)).mean() > 2


def test_sixteen_bits_and_bare_tiles(studio):
    photographer = studio()
    deep = photographer.image(order(subject(PIXELS.astype(np.uint16) * 257)))
    assert np.abs(inner(deep) - expected(PIXELS)).max() <= 1
    bare = photographer.image(order(Subject(25.0, 20.0, (), NORMAL)))
    assert np.abs(inner(bare) - expected(np.zeros_like(PIXELS))).max() <= 1


def test_a_nozzle_that_is_out_is_a_pale_column(studio):
    photographer = studio()
    solid = np.full((40, 50, 4), 100, np.uint8)
    whole = inner(photographer.image(order(subject(solid))))
    lined = inner(photographer.image(order(subject(solid, Flaw("nozzle", ink=3, at_mm=5.0, width_mm=0.5)))))
    # The line is two pixels wide, its edges soft; its middle is 12.5 + 5 mm from the left.
    lighter = (lined - whole).min(axis=(0, 2))
    assert lighter.argmax() == pytest.approx(17.5 * 4 - 1, abs=1.5)
    assert lighter.max() > 10
    assert np.flatnonzero(lighter > 5).size <= 4


def test_the_same_order_makes_the_same_image_and_another_one_other_noise(studio):
    photographer = studio()
    noisy = dataclasses.replace(STILL, noise=0.01, light=0.1)
    first = photographer.image(order(view=noisy))
    assert (photographer.image(order(view=noisy)) == first).all()
    assert (photographer.image(order(view=noisy, number=2)) != first).any()


def test_faults_of_the_camera(studio):
    photographer = studio()
    plain = photographer.image(order())
    assert photographer.image(order(faults=("camera_black",))).max() <= 3
    assert photographer.image(order(faults=("camera_blown",))).min() >= 252
    torn = photographer.image(order(faults=("camera_torn",)))
    grey = (torn == 128).all(axis=(1, 2))
    first = int(grey.argmax())
    assert grey[first:].all()
    assert 0.25 < first / len(torn) < 0.75
    assert (torn[:first] == plain[:first]).all()
    dirty = photographer.image(order(faults=("camera_dirty",)))
    assert (dirty <= plain).all()
    assert (photographer.image(order(number=9, faults=("camera_dirty",))) == dirty).all()
    assert 0.01 < (dirty < 0.9 * plain).mean() < 0.5
    two = photographer.image(order(faults=("camera_two_tiles",), other=Subject(10.0, 40.0, (), NORMAL)))
    assert two.shape == (160 + 2 * MARGIN, 100 + 40 + 4 * MARGIN, 3)
    assert np.abs(two[: len(plain), : plain.shape[1]].astype(int) - plain).max() <= 1


def finish(photographer, count):
    """Wait until so many images were written or lost."""
    done = threading.Event()

    def look():
        state = photographer.state()
        return state["written"] + state["lost"] >= count

    for _ in range(2000):
        if look():
            return
        done.wait(0.01)
    raise AssertionError(photographer.state())


@pytest.mark.parametrize("format_", ["png", "tiff"])
def test_files_appear_whole_and_under_their_names_only(studio, tmp_path, format_):
    photographer = studio(format=format_)
    for number in (1, 2, 3):
        photographer.submit(order(number=number, name=f"{number}.img"))
    finish(photographer, 3)
    assert sorted(path.name for path in (tmp_path / "seen").iterdir()) == ["1.img", "2.img", "3.img"]
    path = tmp_path / "seen" / "2.img"
    image = tifffile.imread(path) if format_ == "tiff" else imagecodecs.png_decode(path.read_bytes())
    assert (image == photographer.image(order(number=2))).all()
    assert photographer.state() == {"pending": 0, "written": 3, "lost": 0}


def test_images_beyond_the_queue_are_lost_and_nobody_waits(studio):
    photographer = studio(queue_len=2)
    going = threading.Event()
    made = photographer.image
    photographer.image = lambda order_: going.wait(20) and made(order_)
    for number in range(5):
        photographer.submit(order(number=number, name=f"{number}.png"))
    assert photographer.state() == {"pending": 2, "written": 0, "lost": 3}
    going.set()
    finish(photographer, 5)
    assert photographer.state() == {"pending": 0, "written": 2, "lost": 3}


def test_an_image_that_can_not_be_made_is_told_at_the_end_and_the_next_is_made(tmp_path):
    photographer = Photographer(CameraConfig(folder=str(tmp_path / "seen")), "ceramic4")
    photographer.submit(order(name="no/such/folder.png"))
    photographer.submit(order(name="good.png"))
    finish(photographer, 2)
    assert (tmp_path / "seen" / "good.png").exists()
    with pytest.raises(RuntimeError, match="could not be made"):
        photographer.close()


def test_a_folder_that_can_not_be_made_is_told_at_the_start(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        Photographer(CameraConfig(folder=str(Path(tmp_path / "file" / "seen"))), "ceramic4")
