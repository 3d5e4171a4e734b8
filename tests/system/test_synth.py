"""``tilefab synth`` and a job with a grown slab, from end to end as an operator runs them."""

from __future__ import annotations

import json
import signal
from typing import Any

import numpy as np
import tifffile
from numpy.testing import assert_array_equal

from tilefab.io.source_map_file import load_source_map

SIZE = ("--rows", 60, "--cols", 70)
GROWN = ("crops = 64", 'crops = 64\ngrow = "quilting"\ngrown_size_mm = [70, 60]')


def test_bad_input_ends_with_its_code_and_a_line(workshop: Any) -> None:
    folder = workshop.folder
    slab, out = folder / "slab.tif", folder / "new.tif"
    tifffile.imwrite(folder / "tiny.tif", np.zeros((12, 40, 3), dtype=np.uint8), photometric="rgb")
    tifffile.imwrite(folder / "other.tif", np.zeros((99, 110), dtype=np.float32))
    holes = np.zeros((100, 110, 4), dtype=np.uint8)
    tifffile.imwrite(folder / "holes.tif", holes, photometric="rgb", extrasamples=(2,))
    (folder / "map.npz").write_bytes(b"PK")
    for arguments, code, words in (
        (("none.tif", "-o", out), 4, "there is no such file"),
        ((folder / "tiny.tif", "-o", out), 4, "has 40 x 12 pixels, but an exemplar needs 16 a side"),
        ((folder / "holes.tif", "-o", out), 4, "the whole image is transparent"),
        ((slab, "-o", out, "--mask", folder / "other.tif"), 4, "both must be of one size"),
        ((slab, "-o", out, "--layer", f"{folder / 'other.tif'}={folder / 'x.tif'}"), 4, "both must be of one size"),
        ((slab, "-o", slab), 8, "is one of the files to read"),
        ((slab, "-o", folder / "new.exr"), 8, "EXR holds half or single floats"),
        ((slab, "-o", out, "--map", folder / "map.txt"), 8, "end its name in .npz"),
        ((slab, "-o", out, "--method", "magic"), 2, "there is no method 'magic'"),
        ((slab, "-o", out, "--seed", 2**63), 2, "--seed"),
    ):
        done = workshop.cli("synth", *arguments, *SIZE)
        assert done.code == code, (arguments, done.err)
        assert words in (" ".join(done.errors) or " ".join(done.err.replace("│", " ").split()))
        assert len(done.errors) == (code != 2)
        assert not out.exists()
    done = workshop.cli("texture", "apply", folder / "map.npz", slab, "-o", out)
    assert (done.code, len(done.errors)) == (7, 1)


def test_an_interrupt_leaves_what_there_is(workshop: Any) -> None:
    slab, out, kept = (workshop.folder / name for name in ("slab.tif", "new.tif", "new.npz"))
    # Far more than can be done before the signal comes.
    options = ("--rows", 3000, "--cols", 3000, "--map", kept, "--json")
    with workshop.start("synth", slab, "-o", out, *options) as process:
        try:
            for line in process.stderr:
                if line.startswith("Growing the texture"):
                    break
            process.send_signal(signal.SIGINT)
            printed, err = process.communicate(timeout=300)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "note: stopping after this step" in err
    assert "run the same command again" not in err
    report = json.loads(printed)
    assert not report["complete"]
    assert report["notes"]
    assert_array_equal(tifffile.imread(out), tifffile.imread(slab).reshape(-1, 3)[load_source_map(kept).source])
    assert [path.name for path in workshop.folder.glob(".tilefab-*")] == []


def test_a_job_prints_from_a_grown_slab(workshop: Any) -> None:
    job = workshop.job(GROWN)
    checked = workshop.cli("job", "check", job, "--json")
    assert (checked.code, checked.json["texture"]["grow"]) == (0, "quilting")
    done = workshop.cli("run", job, "--faces", "0:2", "--json")
    assert done.code == 0, done.err
    assert "Growing the slab: done" in done.err
    preparation = " ".join(str(entry) for entry in done.json["preparation"])
    assert "from 110 x 100 to 165 x 142 pixels by quilting" in preparation
    assert sorted(workshop.hashes()) == [0, 1]
    # Verified against the map that is there, and traced through the grown slab to the scan.
    again = workshop.cli("run", job, "--faces", "0:2", "--verify", "--json")
    assert (again.code, again.json["kept"]) == (0, 2)
    traced = workshop.cli("map", "trace", job, "--face", 1, "--at", "3,4", "--json")
    assert traced.code == 0
    assert traced.json["slab"]["name"] == "slab.tif"
    (kept,) = (workshop.out / "maps").glob("*.grown.npz")
    x, y = traced.json["base_px"]
    assert divmod(int(load_source_map(kept).source[y, x]), 110) == tuple(reversed(traced.json["slab_px"]))
    kept.unlink()
    traced = workshop.cli("map", "trace", job, "--face", 1, "--at", "3,4", "--json")
    assert (traced.json["slab"]["name"], traced.json["slab_px"]) == ("slab.tif, grown", [x, y])
