"""A fast line at its own pace: 200 tiles a minute, faces of 600 x 600 mm at 360 dpi streamed to the simulated printer.

Usage: python benchmarks/line_throughput.py [--faces N] [--tiles-a-minute N]

Runs the real daemon against the real simulator, each a process of its own, at rate 1, and reports underruns, the least
time that a strip was early, and how long the daemon took to arm the printer after it could have heard of a tile.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from figures import Figures
from machine import machine_name
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.line_workshop import Workplace, judge, plant_process, write_job, write_line
from tilefab.control import line_machine as machine
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.daemon import LineDaemon

SIDE_MM, DPI, GAP_MM = 600, 360, 60
SLAB_PX = 1500

PLANT = """\
keep_tiles = 50000
[clock]
rate = {rate}
[belt]
eye_to_head_mm = 2600
head_to_diverter_mm = 2000
[printer]
control = "pty:printer"
verify = "crc32"
buffer_bytes = {buffer}
[plc]
rtu = "pty:plc"
[gauge]
pty = "pty:gauge"
"""


def write_stone(folder: Path) -> None:
    """A made-up stone, large enough for faces of this size."""
    import tifffile

    random = np.random.default_rng(0)
    figure = ndimage.gaussian_filter(random.normal(0, 1, (SLAB_PX, SLAB_PX)), 15)
    grain = ndimage.gaussian_filter(random.normal(0, 8, (SLAB_PX, SLAB_PX)), 1)
    light = np.clip(150 + 30 * figure / figure.std() + grain, 0, 255)
    pixels = np.stack([light, light * 0.96, light * 0.9], axis=2).astype(np.uint8)
    tifffile.imwrite(folder / "slab.tif", pixels, photometric="rgb", resolution=(DPI, DPI), resolutionunit="INCH")


def main() -> None:
    """Run the line and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faces", type=int, default=400, help="faces to print")
    parser.add_argument("--tiles-a-minute", type=float, default=200.0, help="pace of the line")
    parser.add_argument("--buffer-mib", type=int, default=512, help="buffer of the printer")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="tilefab-pace-") as name:
        measure(Path(name), arguments)


def measure(folder: Path, arguments: argparse.Namespace) -> None:
    """Print one table."""
    import asyncio

    write_stone(folder)
    plant_text = PLANT.replace("{buffer}", str(arguments.buffer_mib << 20))
    speed = (SIDE_MM + GAP_MM) * arguments.tiles_a_minute / 60
    with plant_process(folder, rate=1, plant=plant_text) as plant:
        job = write_job(folder, width=SIDE_MM, length=SIDE_MM, dpi=DPI, count=arguments.faces)
        line = write_line(folder, plant.endpoints, speed=speed)
        text = (
            line.read_text()
            .replace("tile_gap_mm = 40.0", f"tile_gap_mm = {GAP_MM}.0")
            .replace("stream_strip_rows = 16", "stream_strip_rows = 64")
        )
        line.write_text(text)
        place = Workplace.open(job, line)
        began = time.perf_counter()
        daemon, seconds, tiles_a_minute = asyncio.run(run(place))
        spent = resource.getrusage(resource.RUSAGE_SELF)
        summary = plant.do("truth", summary=True)["summary"]
        made = [print_ for tile in plant.do("truth")["tiles"] for print_ in tile["prints"]]
        figures = Figures()
        figures.title(f"A line at {arguments.tiles_a_minute:g} tiles a minute, rate 1\n{machine_name()}")
        face = place.source
        figures.note(
            "face", f"{face.size.rows} x {face.size.cols} px, {face.channels} inks: {face.face_bytes / 1e6:.0f} MB"
        )
        figures.note("belt", f"{speed:.0f} mm/s")
        whole = summary["prints_complete"]
        figures.check("faces printed whole", f"{whole} of {arguments.faces}", whole == arguments.faces, "all")
        figures.note("tiles with a face a minute, while running", f"{tiles_a_minute:.1f}")
        figures.check("underruns", str(summary["underruns"]), not summary["underruns"], "0")
        figures.note("tiles without a face while running", str(daemon.printer.blank_tiles))
        if made:
            margin = min(print_["margin_mm"] for print_ in made) / speed
            figures.note("least time that a strip was early", f"{margin * 1000:.0f} ms")
            ahead = min(print_["armed_ahead_mm"] for print_ in made)
            figures.note("least way armed ahead", f"{ahead:.0f} mm, {ahead / (SIDE_MM + GAP_MM):.1f} tiles")
        times = daemon.printer.arming_s
        figures.note(
            "arming, after hearing of a tile: p50 / p99 / p99.9 / most",
            " / ".join(f"{value * 1000:.1f}" for value in (*map(times.quantile_s, (0.5, 0.99, 0.999)), times.largest_s))
            + " ms",
        )
        figures.note(
            "processor time of the daemon a face", f"{(spent.ru_utime + spent.ru_stime) / arguments.faces:.2f} s"
        )
        figures.note("largest resident memory of the daemon", f"{spent.ru_maxrss / 1024:.0f} MB")
        figures.note("wall time", f"{time.perf_counter() - began:.0f} s for {seconds:.0f} s of running")
        found = judge(plant, place)
        told = str(len(found.wrong)) + "".join(f"; {what}" for what in found.wrong[:3])
        figures.check("journal against the plant's truth: wrong", told, not found.wrong, "0")


async def run(place: Workplace) -> tuple[LineDaemon, float, float]:
    """Run the line until its job is done or it holds; the daemon, the seconds it ran and its pace."""
    import asyncio

    daemon = LineDaemon(place.line, [place.job], open_source=lambda _job, _rows: place.source)
    running = asyncio.create_task(daemon.run())
    while daemon.line.missing and not running.done():
        await asyncio.sleep(0.01)
    daemon.post(machine.OperatorStart())
    began = 0.0
    passed_before = 0
    while not running.done():
        await asyncio.sleep(0.05)
        state = daemon.line.state
        if state is LineState.RUNNING and not began and daemon.tiles_passed:
            began, passed_before = time.perf_counter(), daemon.tiles_passed
        if state in (LineState.HOLDING, LineState.STOPPED, LineState.FAULTED, LineState.E_STOPPED):
            break
    seconds = time.perf_counter() - began if began else 0.0
    pace = (daemon.tiles_passed - passed_before) / seconds * 60 if seconds else 0.0
    if daemon.line.alarms:
        sys.stderr.write(f"{daemon.line.alarms}\n")
    daemon.stopping.set()
    await running
    return daemon, seconds, pace


if __name__ == "__main__":
    main()
