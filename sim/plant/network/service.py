"""The plant behind its wires: one lock, one clock, the devices' power, and every command of the control port."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from sim.plant.config import PlantConfig
from sim.plant.network.faults import MESSAGE_KINDS, Fault, FaultBook, Plan
from sim.plant.physics.camera import FAULTS as CAMERA_FAULTS
from sim.plant.physics.camera import Camera
from sim.plant.physics.conveyor import Trouble
from sim.plant.physics.firing import QUANTITIES
from sim.plant.physics.flaws import Flaw
from sim.plant.physics.plant import Plant
from sim.plant.wire.tfp import Controller
from sim.plant.wire.window import KilnWindow, PlcWindow, Window

if TYPE_CHECKING:
    from sim.plant.photographer import Photographer

DEVICES = ("plc", "kiln", "printer", "gauge")
_DOWN_S = 1.0


class CommandError(Exception):
    """A command of the control port that can't be carried out."""


class Service:
    """The plant, safe to use from several threads; every use brings it up to now first.

    Parameters
    ----------
    config
        What the plant is like.
    wall
        The wall's clock, s.

    Raises
    ------
    OSError
        If the camera's folder can't be made.
    """

    def __init__(self, config: PlantConfig, wall: Callable[[], float] = time.monotonic) -> None:
        self.config = config
        self._wall = wall
        self._lock = threading.RLock()
        self.plant = Plant(config, wall(), time.time())
        self.photographer = self._photographer(self.plant.camera)
        self.faults = FaultBook()
        self.plc = PlcWindow(self.plant.conveyor, check_words=config.plc.check_words)
        self.kiln = KilnWindow(self.plant.kiln, check_words=config.kiln.check_words)
        belt = config.belt
        self.printer = Controller(
            self.plant.head, config.printer, round(belt.eye_to_head_mm * belt.counts_per_mm), belt.counts_per_mm
        )
        self._droppers: dict[str, list[Callable[[], None]]] = {name: [] for name in DEVICES}
        self._boots: dict[str, int] = dict.fromkeys(DEVICES, 0)
        self._seeds = random.Random(config.loader.seed)
        self.on_stop: Callable[[], None] = lambda: None

    def _photographer(self, camera: Camera | None) -> Photographer | None:
        if camera is None:
            return None
        # Making images takes libraries that a plant without a camera does without.
        from sim.plant.photographer import Photographer

        photographer = Photographer(self.config.camera, self.config.kiln.press)
        camera.on_photo = photographer.submit
        return photographer

    @contextmanager
    def now(self) -> Iterator[Plant]:
        """The plant, brought up to now, with everybody else kept out."""
        with self._lock:
            self.plant.advance(self._wall())
            yield self.plant

    def strike(self, names: tuple[str, ...], label: int) -> Plan:
        """Faults that strike a message; see `FaultBook.strike`."""
        with self._lock:
            return self.faults.strike(names, label, self._wall())

    def up(self, device: str) -> bool:
        """Whether a device has power and has booted."""
        plant = self.plant
        return {
            "plc": plant.conveyor.up,
            "kiln": plant.kiln.up,
            "printer": plant.head.up,
            "gauge": plant.gauge.up,
        }[device]

    def on_drop(self, device: str, call: Callable[[], None]) -> None:
        """Let something be called, from any thread, whenever a device loses its connections."""
        self._droppers[device].append(call)

    def drop(self, device: str) -> None:
        """End all connections of a device."""
        for drop in self._droppers[device]:
            drop()

    def close(self) -> None:
        """Close the truth file, and end the making of images.

        Raises
        ------
        RuntimeError
            If an image could not be made.
        """
        with self._lock:
            self.plant.close()
        if self.photographer is not None:
            self.photographer.close()

    # Commands

    def do(self, command: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out a command of the control port.

        Raises
        ------
        CommandError
            If there is no such command, or something is missing or wrong in it.
        """
        name = str(command.get("do"))
        call = getattr(self, f"_do_{name}", None)
        if call is None:
            raise CommandError(f"no command {name!r:.40}")
        try:
            with self.now():
                return {"ok": True} | (call(dict(command)) or {})
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise CommandError(f"{name}: {type(error).__name__}: {error}") from error

    def _do_rate(self, command: dict[str, Any]) -> None:
        rate = float(command["rate"])
        if not 1 <= rate <= 1000:
            raise CommandError(f"rate {rate} is not 1 to 1000")
        self.plant.timeline.set_rate(rate)

    def _do_state(self, _: dict[str, Any]) -> dict[str, Any]:
        plant = self.plant
        conveyor, head, kiln = plant.conveyor.view(), plant.head, plant.kiln.view()
        return {
            "time": plant.timeline.t,
            "rate": plant.timeline.rate,
            "travel_mm": plant.timeline.x,
            "speed_mm_s": plant.timeline.speed,
            "up": {device: self.up(device) for device in DEVICES},
            "plc": {
                "boot_id": conveyor.boot_id,
                "trouble": [trouble.name for trouble in conveyor.trouble],
                "causes": [cause.name for cause in plant.conveyor.causes],
                "fault_counter": conveyor.fault_counter,
                "belt_running": conveyor.belt_running,
                "feed_enabled": conveyor.feed_enabled,
                "tile_seq": conveyor.tile_seq,
                "decided_seq": conveyor.decided_seq,
                "cmd_ack": conveyor.cmd_ack,
            },
            "printer": {
                "boot_id": head.boot_id,
                "held": head.held,
                "e_stop": head.e_stop,
                "ink_out": head.ink_out,
                "nozzle_out": head.nozzle_out,
                "deadman": head.deadman,
                "underrun": head.underrun,
                "printing": head.printing,
                "queued": head.queued,
                "credit": head.credit,
                "detect_seq": head.detect_seq,
                "encoder": head.encoder,
                "session": head.session,
                "last_accepted_arm": head.memory.last_accepted,
                "fault_counter": head.fault_counter,
            },
            "kiln": {"tiles_inside": kiln.tiles_inside, "temperatures_degc": list(kiln.temperatures_degc)},
            "gauge": {"tiles": plant.gauge.tiles, "readings": plant.gauge.readings},
            "faults_active": self.faults.active,
            "faults_struck": dict(self.faults.struck),
        } | self._camera_state()

    def _camera_state(self) -> dict[str, Any]:
        camera, photographer = self.plant.camera, self.photographer
        if camera is None or photographer is None:
            return {}
        return {"camera": {**camera.state(), **photographer.state(), "kept_bytes": self.plant.head.shelf.used}}

    def _do_truth(self, command: dict[str, Any]) -> dict[str, Any]:
        self.plant.truth.flush()
        if command.get("summary"):
            return {"summary": self.plant.truth.summary()}
        return self.plant.truth.view(int(command.get("since", 0)), command.get("limit"))

    def _do_forget_faces(self, _: dict[str, Any]) -> None:
        self.plant.truth.forget_faces()

    def _do_clear(self, _: dict[str, Any]) -> None:
        """Take faults of messages away, and let devices show the truth again; the plant's own faults stay."""
        self.faults.clear()
        for window in (self.plc, self.kiln):
            self._hang(window, False)
            window.word_order_wrong = False

    def _do_power_cut(self, command: dict[str, Any]) -> None:
        seconds = float(command.get("seconds", _DOWN_S))
        for device in DEVICES:
            self._reboot(device, seconds, forget=False)

    def _do_stop(self, _: dict[str, Any]) -> None:
        self.on_stop()

    def _do_fault(self, command: dict[str, Any]) -> dict[str, Any] | None:
        kind = str(command["kind"])
        device = str(command.get("device", "plc"))
        if kind in MESSAGE_KINDS:
            self.faults.add(self._fault(device, kind, command))
        elif kind in ("reboot", "reboot_lost"):
            self._known(device)
            seconds = command.get("seconds")
            if seconds is None:
                seconds = getattr(self.config, device).boot_seconds
            self._reboot(device, float(seconds), forget=kind == "reboot_lost")
        elif kind in ("stale", "word_order"):
            self._view_fault(device, kind, command.get("seconds"))
        else:
            self._plant_fault(kind, command)
        return None

    def _known(self, device: str) -> None:
        if device not in DEVICES:
            raise CommandError(f"no device {device!r:.40}: there are {', '.join(DEVICES)}")

    def _fault(self, device: str, kind: str, command: dict[str, Any]) -> Fault:
        names = (*DEVICES, "plc_tcp", "plc_rtu", "kiln_tcp", "printer_control", "printer_data")
        if device not in names:
            raise CommandError(f"no device {device!r:.40}: there are {', '.join(names)}")
        acts = command.get("acts", "now")
        if acts not in ("now", "late", "never"):
            raise CommandError("acts is now, late or never")
        seconds = command.get("seconds")
        lasts = command.get("for_seconds", None if kind in ("late", "reorder", "half_open") else seconds)
        probability = float(command.get("probability", 1.0))
        checked = {"plc": self.config.plc.check_words, "kiln": self.config.kiln.check_words}
        if kind == "late" and acts == "never":
            raise CommandError("what is never done isn't answered late: that is mute")
        endless = lasts is not None or "probability" in command
        count = command.get("count", None if endless else 1)
        return Fault(
            device=device,
            kind=kind,
            chance=random.Random(command.get("seed", self._seeds.randrange(1 << 32))),
            count=None if count is None else int(count),
            probability=probability,
            until=None if lasts is None else self.plant.timeline.wall + float(lasts),
            delay_s=0.3 if seconds is None else float(seconds),
            acts=acts,
            match=command.get("match"),
            skip=int(command.get("skip", 0)),
            anywhere=bool(command.get("anywhere", checked.get(device.partition("_")[0], False))),
        )

    def _window(self, device: str) -> Window:
        if device not in ("plc", "kiln"):
            raise CommandError(f"{device!r:.40} has no registers: plc and kiln have")
        return self.plc if device == "plc" else self.kiln

    def _view_fault(self, device: str, kind: str, seconds: float | None) -> None:
        window = self._window(device)
        if kind == "word_order":
            window.word_order_wrong = True
        else:
            self._hang(window, True)

        def over() -> None:
            if kind == "word_order":
                window.word_order_wrong = False
            else:
                self._hang(window, False)

        if seconds is not None:
            self.plant.timeline.at_wall(self.plant.timeline.wall + float(seconds), over)

    def _hang(self, window: Window, hung: bool) -> None:
        window.freeze(hung)
        (self.plant.conveyor if window is self.plc else self.plant.kiln).hang(hung)

    def _reboot(self, device: str, seconds: float, *, forget: bool) -> None:
        plant = self.plant
        if device == "plc":
            plant.conveyor.power_down()
        elif device == "kiln":
            plant.kiln.power_down(forget=forget)
        elif device == "printer":
            plant.head.power_down(forget=forget)
        else:
            plant.gauge.up = False
        self.drop(device)
        self._boots[device] += 1
        boot = self._boots[device]

        def up() -> None:
            if boot == self._boots[device]:
                self._power_up(device)

        plant.timeline.at_wall(plant.timeline.wall + seconds, up)

    def _power_up(self, device: str) -> None:
        plant = self.plant
        if device == "plc":
            plant.conveyor.power_up()
            self.plc.reset()
        elif device == "kiln":
            plant.kiln.power_up()
            self.kiln.reset()
        elif device == "printer":
            plant.head.power_up()
            self.printer.reset()
        else:
            plant.gauge.power_up()

    def _plant_fault(self, kind: str, command: dict[str, Any]) -> None:
        plant = self.plant
        head, conveyor = plant.head, plant.conveyor
        match kind:
            case "e_stop" | "e_stop_release":
                plant.e_stop(kind == "e_stop")
            case "jam":
                plant.jam(float(command.get("slip_mm", 0)))
            case "jam_clear":
                plant.jam_clear(remove=bool(command.get("remove", False)))
            case "double_feed":
                plant.double_feed(int(command.get("count", 1)))
            case "missing_tile":
                plant.missing_tile(str(command.get("where", "loader")), int(command.get("count", 1)))
            case "ink_out":
                head.set_ink(int(command.get("ink", 0)), 0.0)
            case "ink_refill":
                for ink in range(len(head.ink)):
                    head.set_ink(ink, 1000.0)
            case "nozzle_out":
                ink, noticed = int(command.get("ink", 0)), bool(command.get("noticed", True))
                at, wide = float(command.get("at_mm", 20.0)), float(command.get("width_mm", 0.2))
                head.set_nozzles(True, Flaw("nozzle", ink, at_mm=at, width_mm=wide), noticed=noticed)
            case "nozzle_ok":
                head.set_nozzles(False)
            case "banding":
                strength, period = float(command.get("strength", 0.1)), float(command.get("period_mm", 20.0))
                head.set_banding(Flaw("banding", strength=strength, period_mm=period))
            case "banding_ok":
                head.set_banding(None)
            case "double_print":
                strength, shift = float(command.get("strength", 0.5)), float(command.get("shift_mm", 2.0))
                head.print_twice(Flaw("double_print", strength=strength, shift_mm=shift), int(command.get("count", 1)))
            case "firing_drift":
                self._firing_drift(command)
            case "camera_ok":
                self._camera().mend()
            case "camera_clock":
                self._camera().clock_off_s += float(command["seconds"])
            case kind if kind in CAMERA_FAULTS:
                count = command.get("count")
                self._camera().strike(kind, None if count is None else int(count))
            case "diverter_fault" | "diverter_ok":
                conveyor.set_cause(Trouble.DIVERTER, kind == "diverter_fault")
            case "zone_drift":
                plant.kiln.drift(
                    int(command.get("zone", 0)), float(command.get("degc", 20)), float(command.get("minutes", 10))
                )
            case "burner_fault" | "burner_ok":
                plant.kiln.fail_burner(kind == "burner_fault")
            case "kiln_block" | "kiln_unblock":
                plant.kiln.blocked = kind == "kiln_block"
            case _:
                raise CommandError(f"no fault {kind!r:.40}")

    def _firing_drift(self, command: dict[str, Any]) -> None:
        drift = self.plant.drift
        if drift is None:
            raise CommandError("no colours are fired here: the plant file has no kiln.press")
        values = {full: float(command[short]) for short, full in QUANTITIES.items() if short in command}
        if "ink" in command:
            values[drift.ink_name(int(command["ink"]))] = float(command.get("strength", 0.05))
        if not values:
            raise CommandError(f"nothing drifts: name {', '.join(QUANTITIES)} or ink and strength")
        drift.aim(self.plant.timeline.t, values, float(command.get("minutes", 10)) * 60)

    def _camera(self) -> Camera:
        if self.plant.camera is None:
            raise CommandError("there is no camera: the plant file has no camera.folder")
        return self.plant.camera
