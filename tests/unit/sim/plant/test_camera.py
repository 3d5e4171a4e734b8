"""The camera over the kiln's exit: which tiles it sees, what it calls their images, when they arrive."""

from __future__ import annotations

from collections import Counter
from zlib import crc32

import pytest

from sim.plant.physics.camera import FAULTS, Camera, PhotoOrder
from sim.plant.physics.firing import FiringDrift
from sim.plant.physics.tiles import Tile
from sim.plant.physics.timeline import Timeline
from tests.unit.sim.plant.physics_bench import EYE_TO_HEAD, Bench, face

EPOCH_S = 1_795_508_215.25  # 2026-11-24 08:16:55.250 UTC


class Watched:
    """A camera by itself, tiles that go by it, and the images that it orders."""

    def __init__(self, **config):
        bench = Bench(camera={"folder": "x"} | config, printer={"keep_prints": True}, kiln={"press": "ceramic4"})
        self.timeline = Timeline(1.0, 100.0)
        self.camera = Camera(self.timeline, bench.plant.config.camera, EPOCH_S, 0.0)
        self.orders: list[PhotoOrder] = []
        self.camera.on_photo = self.orders.append
        self.drift = FiringDrift(4, 0.0, 1)

    def see(self, count, whole=True):
        """Let tiles come out, one each second."""
        tiles = []
        for _ in range(count):
            t = self.timeline.t
            tile = Tile(self.camera.seen + 1, 0.0, 150.0, fired=self.drift.fired(t, self.drift.laid(t), 0.0, 0.0))
            self.camera.see(tile, whole)
            tiles.append(tile.photo)
            self.timeline.advance(self.timeline.wall + 1.0)
        return tiles


def test_images_are_named_by_the_clock_on_the_wall_and_numbered():
    watched = Watched()
    watched.timeline.set_rate(60.0)
    photos = watched.see(2)
    assert [photo["name"] for photo in photos] == [
        "20261124T081655.250Z_000001.png",
        "20261124T081656.250Z_000002.png",
    ]
    assert [order.name for order in watched.orders] == [photo["name"] for photo in photos]
    assert [photo["at"] for photo in photos] == [0.0, 60.0]
    assert Watched(format="tiff").see(1)[0]["name"].endswith(".tif")


def test_the_camera_s_clock_may_jump_and_be_set_right():
    watched = Watched()
    watched.camera.clock_off_s += 3600.7496
    assert watched.see(1)[0]["name"] == "20261124T091656.000Z_000001.png"
    watched.camera.mend()
    assert watched.see(1)[0]["name"].startswith("20261124T081656.250Z")


def test_only_every_so_manieth_tile_is_looked_at():
    photos = Watched(every=3).see(7)
    assert [bool(photo) for photo in photos] == [False, False, True, False, False, True, False]


def test_images_lie_within_their_limits_and_the_same_seed_gives_the_same():
    limits = {"rotation_deg": 3.0, "shift_mm": 5.0, "scale": 0.02, "perspective": 0.01, "gain": 0.1, "light": 0.2}
    views = [photo["view"] for photo in Watched(**limits).see(300)]
    for name in ("rotation_deg", "shift_mm", "light", "perspective"):
        values = [value for view in views for value in (view[name] if name == "shift_mm" else (view[name],))]
        assert max(values) <= limits[name]
        assert max(values) > 0.9 * limits[name]
    assert all(abs(view["scale"] - 1) <= 0.02 for view in views)
    assert all(abs(gain - 1) <= 0.1 for view in views for gain in view["gain_rgb"])
    assert set(Counter(view["quarter_turns"] for view in views)) == {0, 1, 2, 3}
    assert {view["occluded"] for view in views} == {None}
    assert [photo["view"] for photo in Watched(**limits).see(300)] == views
    assert [photo["view"] for photo in Watched(**limits, seed=2).see(300)] != views
    assert {photo["view"]["quarter_turns"] for photo in Watched(quarter_turns=False).see(20)} == {0}


def test_what_covers_a_tile_lies_on_it_and_hides_at_most_a_third():
    views = [photo["view"] for photo in Watched(occluded_rate=1.0).see(200)]
    for left, top, wide, high in (view["occluded"] for view in views):
        assert left >= 0 <= top
        assert left + wide <= 1 + 1e-9
        assert top + high <= 1 + 1e-9
        assert wide * high <= 0.3 + 1e-9


def test_broken_tiles_are_seen_with_what_is_left_of_them():
    watched = Watched()
    assert all(0.05 <= photo["view"]["broken"] <= 0.4 for photo in watched.see(20, whole=False))
    assert all(photo["view"]["broken"] == 0.0 for photo in watched.see(20))


def test_some_tiles_are_missed():
    watched = Watched(miss_rate=0.2)
    photos = watched.see(500)
    missed = [photo for photo in photos if photo["name"] is None]
    assert 70 < len(missed) < 130
    assert all(photo["faults"] == ["missed"] for photo in missed)
    assert watched.camera.state() == {"seen": 500, "taken": 500 - len(missed), "missed": len(missed), "faults": {}}
    assert len(watched.orders) == 500 - len(missed)


def test_late_images_arrive_when_they_say_and_others_overtake_them():
    watched = Watched(late_s=5.0, late_rate=0.3, late_most_s=30.0)
    arrived: dict[str, float] = {}
    watched.camera.on_photo = lambda order: arrived.update({order.name: watched.timeline.t})
    photos = watched.see(100)
    watched.timeline.advance(watched.timeline.wall + 40)
    assert {photo["name"]: photo["arrives_at"] for photo in photos} == pytest.approx(arrived)
    assert all(5.0 <= photo["arrives_at"] - photo["at"] <= 35.0 for photo in photos)
    assert list(arrived) != sorted(arrived)


@pytest.mark.parametrize("kind", FAULTS[2:])
def test_faults_of_single_images_strike_as_many_as_told(kind):
    watched = Watched()
    watched.camera.strike(kind, None)
    assert [photo["faults"] for photo in watched.see(2)] == [[kind], []]
    watched.camera.strike(kind, 2)
    assert watched.camera.state()["faults"] == {kind: 2}
    assert [photo["faults"] for photo in watched.see(3)] == [[kind], [kind], []]
    assert watched.orders[0].faults == (kind,)


def test_a_dead_or_dirty_camera_stays_so_until_it_is_mended():
    watched = Watched()
    watched.camera.strike("camera_dirty", None)
    assert [photo["faults"] for photo in watched.see(3)] == [["camera_dirty"]] * 3
    watched.camera.strike("camera_dead", None)
    photos = watched.see(3)
    assert [(photo["name"], photo["faults"]) for photo in photos] == [(None, ["camera_dead"])] * 3
    watched.camera.mend()
    assert watched.see(1)[0]["faults"] == []
    watched.camera.strike("camera_dead", 1)
    assert [bool(photo["name"]) for photo in watched.see(2)] == [False, True]


def test_two_tiles_are_this_one_and_the_one_before():
    watched = Watched()
    watched.camera.strike("camera_two_tiles", 2)
    watched.see(3)
    first, second, third = watched.orders
    assert first.other is first.subject
    assert second.other is first.subject
    assert third.other is None


def strips(bench, arm):
    data = bytearray(face(arm)[: 600 * 40])
    bench.head.take(arm, 0, 600, len(data), crc32(data), None, data)


def test_what_was_printed_comes_before_the_camera_and_is_forgotten_then():
    bench = Bench(
        loader={"tiles": 3, "tile_width_mm": 300.0},
        printer={"keep_prints": True, "keep_bytes": 24000},
        kiln={"press": "ceramic4", "cycle_minutes": 40.0, "break_rate": 1.0},
        camera={"folder": "x"},
    )
    camera = bench.plant.camera
    assert camera is not None
    orders: list[PhotoOrder] = []
    camera.on_photo = orders.append
    bench.start(release_base=1, release_bits=0xFFFFFFFF)
    for seq in (1, 3):
        bench.wait_for_tile(seq)
        start = bench.order(seq, seq).start_encoder - 40
        bench.arm(seq, seq, start_encoder=start)
        strips(bench, seq)
    bench.until_travel(800 + EYE_TO_HEAD + 5000 + 1400 + 1)
    bench.after(40 * 60 + 1)
    one, bare, unkept = (tile["photo"] for tile in bench.truth().values())
    assert one["name"] == orders[0].name
    assert one["width_mm"] == 300.0
    assert (unkept["name"], unkept["faults"]) == (None, ["not_kept"])
    assert bare["name"] == orders[1].name
    assert (orders[0].subject.width_mm, orders[0].subject.length_mm) == (300.0, 600.0)
    (layer,) = orders[0].subject.layers
    assert layer.offset_mm == pytest.approx(-2.0)
    assert layer.kept.data == face(1)[:24000]
    assert orders[1].subject.layers == ()
    assert bench.head.shelf.used == 0
    assert {tile["fate"] for tile in bench.truth().values()} == {"broken"}
