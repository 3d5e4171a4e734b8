"""What a simulated plant is like: the tables of `plant.toml`."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

ZONES = 8
"""Zones of a kiln."""

Verify = Literal["crc32", "sha256", "none"]
Format = Literal["png", "tiff"]
_Table = TypeVar("_Table")


@dataclass(frozen=True)
class ClockConfig:
    """How fast the plant's clock runs against the wall's, 1 to 1000."""

    rate: float = 1.0


@dataclass(frozen=True)
class BeltConfig:
    """Lengths along the belt, and how it starts and stops."""

    counts_per_mm: float = 20.0
    most_speed_mm_s: float = 3000.0
    accel_mm_s2: float = 2000.0
    decel_mm_s2: float = 2000.0
    e_stop_decel_mm_s2: float = 6000.0
    load_to_eye_mm: float = 800.0
    eye_to_head_mm: float = 2600.0
    head_to_diverter_mm: float = 2000.0
    diverter_to_kiln_mm: float = 3000.0


@dataclass(frozen=True)
class LoaderConfig:
    """What the loader puts on the belt; zeros mean: endless, of the length that the PLC was told, and square."""

    tiles: int = 0
    tile_length_mm: float = 0.0
    tile_width_mm: float = 0.0
    length_jitter_mm: float = 0.0
    jitter_mm: float = 0.0
    seed: int = 1


@dataclass(frozen=True)
class PrinterConfig:
    """The print head, its memory and its two connections; whether prints are kept for the camera, in so many bytes."""

    inks: int = 4
    bits: int = 8
    buffer_bytes: int = 512 << 20
    queue_len: int = 8
    min_lead_mm: float = 50.0
    ink_faces: int = 0
    verify: Verify = "crc32"
    keep_prints: bool = False
    keep_bytes: int = 1 << 30
    control: str = ""
    baud: int = 921600
    data: str = "127.0.0.1:0"
    boot_seconds: float = 0.3


@dataclass(frozen=True)
class PlcConfig:
    """The conveyor's controller and its connections; an empty one isn't offered."""

    tcp: str = "127.0.0.1:0"
    rtu: str = ""
    baud: int = 19200
    check_words: bool = True
    boot_seconds: float = 0.3


@dataclass(frozen=True)
class KilnConfig:
    """The kiln: how long tiles stay, how many break, how their order suffers, how zones heat.

    Attributes
    ----------
    press
        What is printed and fired, by its name in `sim.spectral_press`; empty if nobody looks at colours.
    zones_degc
        Temperatures at the start; empty for `start_degc` everywhere.
    peak_degc, normal_minutes
        Mean of the firing zones and firing time that are normal to the press; 0 for those of the start.
    walk_delta_e
        How far the colour of tiles walks at random in an hour, about, CIEDE2000.
    """

    tcp: str = "127.0.0.1:0"
    check_words: bool = True
    least_minutes: float = 35.0
    most_minutes: float = 75.0
    cycle_minutes: float = 45.0
    shuffle_minutes: float = 0.0
    break_rate: float = 0.0
    capacity: int = 20000
    start_degc: float = 20.0
    zones_degc: tuple[float, ...] = ()
    time_constant_min: float = 4.0
    press: str = ""
    peak_degc: float = 0.0
    normal_minutes: float = 0.0
    walk_delta_e: float = 0.0
    seed: int = 1
    boot_seconds: float = 0.3


@dataclass(frozen=True)
class GaugeConfig:
    """The instrument at the kiln's exit."""

    pty: str = ""
    baud: int = 9600
    seed: int = 1
    boot_seconds: float = 0.3


@dataclass(frozen=True)
class CameraConfig:
    """The camera over the kiln's exit; without a folder there is none.

    Attributes
    ----------
    every
        It looks at every so manieth tile.
    quarter_turns
        Whether tiles come turned by any multiple of 90 degrees.
    rotation_deg, shift_mm, scale, perspective, gain
        The most that a tile is turned further, lies off the middle each way, looks larger or smaller (share), looks
        larger nearby (share), and that each of the camera's channels is brighter or darker (share).
    light
        The most that light is uneven, share.
    miss_rate, occluded_rate
        Share of tiles that it misses, and of those of which something covers up to 30 %.
    late_s
        Plant seconds from the tile to its image.
    late_rate, late_most_s
        Share of images that are later still, by up to so many plant seconds, so that others overtake them.
    queue_len
        Images that may wait to be made; further ones are lost.
    """

    folder: str = ""
    every: int = 1
    px_per_mm: float = 4.0
    margin_mm: float = 8.0
    quarter_turns: bool = True
    rotation_deg: float = 2.0
    shift_mm: float = 3.0
    scale: float = 0.0
    perspective: float = 0.0
    gain: float = 0.0
    light: float = 0.05
    blur_px: float = 0.5
    noise: float = 0.004
    miss_rate: float = 0.0
    occluded_rate: float = 0.0
    late_s: float = 0.0
    late_rate: float = 0.0
    late_most_s: float = 0.0
    format: Format = "png"
    queue_len: int = 64
    seed: int = 1


@dataclass(frozen=True)
class ControlConfig:
    """Where faults are set and truth is asked for."""

    tcp: str = "127.0.0.1:0"


@dataclass(frozen=True)
class PlantConfig:
    """A whole plant.

    Attributes
    ----------
    truth_file
        Where finished tiles are written, one JSON object a line; empty for nowhere.
    keep_tiles
        How many finished tiles stay in memory.
    endpoints_file
        Where the addresses are written once all is up; empty for nowhere.
    """

    clock: ClockConfig = field(default_factory=ClockConfig)
    belt: BeltConfig = field(default_factory=BeltConfig)
    loader: LoaderConfig = field(default_factory=LoaderConfig)
    printer: PrinterConfig = field(default_factory=PrinterConfig)
    plc: PlcConfig = field(default_factory=PlcConfig)
    kiln: KilnConfig = field(default_factory=KilnConfig)
    gauge: GaugeConfig = field(default_factory=GaugeConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    truth_file: str = ""
    keep_tiles: int = 5000
    endpoints_file: str = ""


_TABLES: dict[str, type] = {
    "clock": ClockConfig,
    "belt": BeltConfig,
    "loader": LoaderConfig,
    "printer": PrinterConfig,
    "plc": PlcConfig,
    "kiln": KilnConfig,
    "gauge": GaugeConfig,
    "camera": CameraConfig,
    "control": ControlConfig,
}
_NEVER_ZERO = {
    *("rate", "counts_per_mm", "most_speed_mm_s", "accel_mm_s2", "decel_mm_s2", "e_stop_decel_mm_s2"),
    *("baud", "buffer_bytes", "queue_len", "capacity", "time_constant_min", "keep_tiles", "every", "px_per_mm"),
}


def parse_plant(content: Mapping[str, Any]) -> PlantConfig:
    """Check the tables of a plant file.

    Raises
    ------
    ValueError
        If a name is unknown or a value is of the wrong type or out of its range.
    """
    plain = {name: value for name, value in content.items() if name not in _TABLES}
    tables: dict[str, Any] = {name: _table(kind, content.get(name, {}), name) for name, kind in _TABLES.items()}
    plant = _table(PlantConfig, plain, "the file", **tables)
    if not 1 <= plant.clock.rate <= 1000:
        raise ValueError(f"clock.rate {plant.clock.rate} is not 1 to 1000")
    if not (1 <= plant.printer.inks <= 8 and plant.printer.bits in (8, 16) and plant.printer.queue_len <= 32):
        raise ValueError("the printer has 1 to 8 inks of 8 or 16 bits and queues at most 32 faces")
    if plant.printer.buffer_bytes >= 1 << 32:
        raise ValueError("printer.buffer_bytes must be below 4 GiB")
    if plant.printer.verify not in ("crc32", "sha256", "none"):
        raise ValueError(f"printer.verify {plant.printer.verify!r} is not crc32, sha256 or none")
    if not plant.kiln.least_minutes <= plant.kiln.cycle_minutes <= plant.kiln.most_minutes:
        raise ValueError("kiln.cycle_minutes lies outside least_minutes to most_minutes")
    if len(plant.kiln.zones_degc) not in (0, ZONES):
        raise ValueError(f"kiln.zones_degc has {len(plant.kiln.zones_degc)} temperatures for {ZONES} zones")
    _check_colours(plant)
    return plant


def _check_colours(plant: PlantConfig) -> None:
    camera, kiln, printer = plant.camera, plant.kiln, plant.printer
    if kiln.press:
        # Only a plant whose colours are looked at needs what makes them.
        from sim.ink_sets import press_inks

        inks = len(press_inks(kiln.press).names)
        if inks != printer.inks:
            raise ValueError(f"kiln.press {kiln.press!r} has {inks} inks, printer.inks says {printer.inks}")
    if not camera.folder:
        return
    if not (kiln.press and printer.keep_prints):
        raise ValueError("the camera sees fired prints: it needs kiln.press, and printer.keep_prints = true")
    if camera.format not in ("png", "tiff"):
        raise ValueError(f"camera.format {camera.format!r} is not png or tiff")
    if not all(rate <= 1 for rate in (camera.miss_rate, camera.occluded_rate, camera.late_rate)):
        raise ValueError("camera.miss_rate, occluded_rate and late_rate are shares, 0 to 1")
    if not max(camera.scale, camera.perspective, camera.gain, camera.light) < 0.5:
        raise ValueError("camera.scale, perspective, gain and light are shares below 0.5")


def read_plant(path: Path) -> PlantConfig:
    """Read a plant file; relative paths in it start at its folder.

    Raises
    ------
    ValueError
        If it is no TOML or says something wrong.
    OSError
        If it can't be read.
    """
    plant = parse_plant(tomllib.loads(path.read_text(encoding="utf-8")))

    def beside(text: str) -> str:
        if text.startswith("pty:"):
            return f"pty:{path.parent / text.removeprefix('pty:')}"
        return str(path.parent / text) if text else ""

    return dataclasses.replace(
        plant,
        printer=dataclasses.replace(plant.printer, control=beside(plant.printer.control)),
        plc=dataclasses.replace(plant.plc, rtu=beside(plant.plc.rtu)),
        gauge=dataclasses.replace(plant.gauge, pty=beside(plant.gauge.pty)),
        camera=dataclasses.replace(plant.camera, folder=beside(plant.camera.folder)),
        truth_file=beside(plant.truth_file),
        endpoints_file=beside(plant.endpoints_file),
    )


def _table(kind: type[_Table], content: Any, name: str, **ready: Any) -> _Table:
    if not isinstance(content, Mapping):
        raise ValueError(f"{name} is no table")  # noqa: TRY004 - what is wrong is the file's value
    values: dict[str, Any] = dict(ready)
    known = {entry.name: entry for entry in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key, value in content.items():
        if key not in known or key in ready:
            raise ValueError(f"{name} has no {key!r}: it has {', '.join(sorted(set(known) - set(ready)))}")
        values[key] = _value(f"{name}.{key}", known[key].default, value)
        if key in _NEVER_ZERO and not values[key] > 0:
            raise ValueError(f"{name}.{key} must be above 0")
    return kind(**values)


def _value(name: str, default: Any, value: Any) -> Any:
    wanted = type(default)
    if wanted is tuple and isinstance(value, list):
        return tuple(_value(f"{name}[{at}]", 0.0, entry) for at, entry in enumerate(value))
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not wanted:
        raise ValueError(f"{name} must be of type {wanted.__name__}, not {type(value).__name__}")
    if wanted in (int, float) and not 0 <= value < float("inf"):
        raise ValueError(f"{name} must not be below 0")
    return value
