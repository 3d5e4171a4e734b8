"""What may stand in a line's file: its devices, its recipes, and where its daemon is talked to."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import Field, model_validator

from tilefab.config.loader import TomlFile, read_model
from tilefab.config.models import Section
from tilefab.control.ramp import RampLimits, set_point_problem
from tilefab.errors import ConfigError

ZONES = 8
"""Zones of a kiln."""

_MOST_SOCKET_BYTES = 107
"""Linux has no longer names for sockets."""

_MODBUS = r"^modbus-(tcp|rtu)://\S+$"
_SERIAL = r"^serial:///\S+$"
_TCP = r"^tcp://\S+$"
_NAME = r"^[A-Za-z0-9][A-Za-z0-9 _-]*$"

Degc = Annotated[float, Field(ge=20, le=1250)]


class LineFacts(Section):
    """[line]: its name and where it keeps things."""

    name: str = Field(min_length=1, max_length=60, pattern=_NAME, description="Name of the line, as in its journal.")
    state_directory: str = Field(
        "line_state",
        min_length=1,
        description="Folder of journal, token, socket and log; relative to this file. Of this line alone.",
    )
    run_out_mm: float = Field(
        4000.0,
        ge=0,
        le=100_000,
        description="How far the belt runs on once the last tile has passed the diverter, before it stops or a job is "
        "changed: a little more than the way from diverter to kiln.",
    )
    stream_strip_rows: int = Field(
        64, ge=1, le=4096, description="Rows of a face that are rendered and sent to the printer at a time."
    )


class Plc(Section):
    """[plc]: the conveyor's controller."""

    endpoint: str = Field(
        pattern=_MODBUS, description="`modbus-tcp://HOST:PORT?unit=N` or `modbus-rtu:///PATH?baud=N&unit=N`."
    )


class Kiln(Section):
    """[kiln]: the kiln's controller; without this section the line leaves the kiln alone."""

    endpoint: str = Field(pattern=_MODBUS, description="As for [plc].")
    lowest_degc: Degc = Field(20.0, description="Lowest set-point that a recipe may ask for, °C.")
    highest_degc: Degc = Field(1250.0, description="Highest set-point that a recipe may ask for, °C.")
    ramp_degc_min: float = Field(
        5.0, ge=0.1, le=15, description="How fast set-points may move, up or down, °C a minute."
    )
    tolerance_degc: float = Field(
        5.0, gt=0, le=100, description="How near to its set-point each zone must be for tiles to be sent in, °C."
    )

    @property
    def limits(self) -> RampLimits:
        """Bounds of set-points and of their moving."""
        return RampLimits(self.lowest_degc, self.highest_degc, self.ramp_degc_min)

    @model_validator(mode="after")
    def _check(self) -> Kiln:
        if self.lowest_degc >= self.highest_degc:
            raise ValueError(f"lowest_degc: {self.lowest_degc:g} must be below highest_degc, {self.highest_degc:g}")
        return self


class Gauge(Section):
    """[gauge]: the instrument behind the kiln, if there is one."""

    endpoint: str = Field(pattern=_SERIAL, description="`serial:///PATH?baud=N`.")


class Printer(Section):
    """[printer]: the printer."""

    control: str = Field(pattern=_SERIAL, description="Where it takes commands: `serial:///PATH?baud=N`.")
    data: str = Field(pattern=_TCP, description="Where it takes faces: `tcp://HOST:PORT`.")


class Camera(Section):
    """[camera]: where images of fired tiles arrive, from a camera or scanner behind the kiln."""

    folder: str = Field(
        min_length=1,
        description="Folder that images appear in, under a finished name: TIFF, PNG or JPEG; relative to this file. "
        "Names that begin with a time as 20261124T083015.250Z tell when the tile was seen; of others the file's time "
        "does.",
    )
    px_per_mm: float | None = Field(
        None,
        gt=0.1,
        le=100,
        description="Pixels of the image to a millimetre of tile, as calibrated. Without it sizes of tiles can't be "
        "judged, only their shapes.",
    )
    profile: str | None = Field(
        None,
        min_length=1,
        description="ICC profile of the camera, if images don't carry one. Default: sRGB.",
    )
    silent_min: float = Field(
        10.0,
        gt=0,
        le=1440,
        description="Minutes without an image, while tiles should leave the kiln, after which an alarm is raised.",
    )


Positive = Annotated[float, Field(gt=0)]


class Tolerances(Section):
    """[tolerances]: what a tile of first choice may show."""

    delta_e_mean: Positive = Field(3.0, description="Mean CIEDE2000 of a tile from its own face.")
    delta_e_p95: Positive = Field(6.0, description="The same, exceeded by 5 % of its regions.")
    size_percent: Positive = Field(
        0.6,
        description="Mean side from the work size, % (as ISO 13006 for group BIa; its limits in mm, narrower for large "
        "tiles, aren't applied: lower it for these).",
    )
    straightness_percent: Positive = Field(0.5, description="Straightness of sides, %.")
    rectangularity_percent: Positive = Field(0.5, description="Rectangularity, %.")
    shift_mm: Positive = Field(2.0, description="Print off the middle of the tile.")


class Inspection(Section):
    """[inspection]: fired tiles are recognised, measured, and the colour of those to come corrected."""

    window_min: float = Field(
        180.0,
        ge=1,
        le=10_080,
        description="Tiles seen are looked for among faces printed within so many minutes; then in their whole runs.",
    )
    correct: bool = Field(True, description="Whether the colour of tiles to come is corrected; else it is only told.")
    correction_interval_min: float = Field(
        5.0, ge=0, le=1440, description="Fewest minutes between two corrections, by the line's clock."
    )
    drift_per_hour: float = Field(
        0.25,
        gt=0,
        le=5,
        description="How far the mean colour of tiles usually drifts in an hour, CIEDE2000; learnt from then on.",
    )
    region_mm: float = Field(4.0, ge=0.5, le=100, description="Side of the regions that colours are compared in.")
    clock_rate: float = Field(
        1.0,
        ge=1,
        le=1000,
        description="Of a simulated plant: how much faster than the clock on the wall it goes; all minutes here and in "
        "[camera] are its own. Images are named by the clock on the wall.",
    )


class JournalPlace(Section):
    """[journal]: where it is written down what was printed."""

    url: str | None = Field(
        None,
        pattern=r"^(sqlite|postgresql(\+psycopg)?):",
        description="`postgresql://...` for a plant of many lines. Default: `journal.db` in the state directory. A "
        "password belongs into `~/.pgpass`, not here.",
    )

    @model_validator(mode="after")
    def _check(self) -> JournalPlace:
        if self.url is not None and urlsplit(self.url).password is not None:
            raise ValueError("url: take the password out of this file, it may be read by many: put it into ~/.pgpass")
        return self


class Api(Section):
    """[api]: where the daemon is talked to."""

    socket: str | None = Field(
        None,
        min_length=1,
        description="Unix socket, for its owner and group. Default: `line.sock` in the state directory.",
    )
    http: str | None = Field(
        None, description='Also here, as "127.0.0.1:8765". Who only reads needs no token. Default: nowhere.'
    )
    allow_remote: bool = Field(
        False,
        description="Let `http` be reached from other machines. Nothing is encrypted: put a proxy with TLS before it.",
    )
    token_file: str | None = Field(
        None,
        min_length=1,
        description="File of the token that orders need; made if it isn't there. Default: `token` in the state "
        "directory. Only its owner may read it.",
    )

    @property
    def http_address(self) -> tuple[str, int] | None:
        """Host and port, if there is one."""
        if self.http is None:
            return None
        host, _, port = self.http.rpartition(":")
        return host.strip("[]"), int(port)

    @model_validator(mode="after")
    def _check(self) -> Api:
        if self.http is None:
            return self
        host, _, port = self.http.rpartition(":")
        if not (host and port.isascii() and port.isdigit() and len(port) <= 5 and 1 <= int(port) <= 65535):
            raise ValueError(f"http: {self.http!r} is no address: write it as 127.0.0.1:8765")
        try:
            address = ipaddress.ip_address(host.strip("[]"))
        except ValueError:
            raise ValueError(f"http: {host!r} is no number of a host: write 127.0.0.1, or another number") from None
        if not address.is_loopback and not self.allow_remote:
            raise ValueError(
                f"http: {host} can be reached from other machines; use 127.0.0.1, or say allow_remote = true"
            )
        return self


class Recipe(Section):
    """[recipes.NAME]: how a kind of tile is run; a job names its recipe, or takes `default`."""

    belt_speed_mm_s: float = Field(gt=0, le=3000, description="Speed of the belt, mm/s.")
    tile_gap_mm: float = Field(ge=10, le=1000, description="From the end of a tile to the beginning of the next, mm.")
    kiln_set_points_degc: list[Degc] | None = Field(
        None,
        min_length=ZONES,
        max_length=ZONES,
        description="Of each zone, from the entry on, °C. Default: the kiln stays as it is.",
    )
    cycle_min: float | None = Field(
        None, ge=35, le=75, description="Minutes from entry to exit of the kiln. Default: it stays as it is."
    )


class Line(Section):
    """A whole line file."""

    schema_version: Literal[1] = Field(1, description="Version of the line file's format.")
    line: LineFacts
    plc: Plc
    printer: Printer
    kiln: Kiln | None = None
    gauge: Gauge | None = None
    camera: Camera | None = None
    inspection: Inspection = Field(default_factory=lambda: Inspection.model_validate({}))
    tolerances: Tolerances = Field(default_factory=lambda: Tolerances.model_validate({}))
    journal: JournalPlace = Field(default_factory=lambda: JournalPlace.model_validate({}))
    api: Api = Field(default_factory=lambda: Api.model_validate({}))
    recipes: dict[Annotated[str, Field(min_length=1, max_length=60, pattern=_NAME)], Recipe] = Field(
        min_length=1, max_length=1000, description="At least one: [recipes.default]."
    )

    @model_validator(mode="after")
    def _check(self) -> Line:
        for name, recipe in self.recipes.items():
            key = f"recipes.{name}.kiln_set_points_degc"
            if self.kiln is None:
                if recipe.kiln_set_points_degc is not None:
                    raise ValueError(f"{key}: the line has no [kiln] to bring there")
                if recipe.cycle_min is not None:
                    raise ValueError(f"recipes.{name}.cycle_min: the line has no [kiln] to bring there")
            elif recipe.kiln_set_points_degc is not None:
                problem = set_point_problem(recipe.kiln_set_points_degc, self.kiln.limits)
                if problem:
                    raise ValueError(f"{key}: {problem}, the limits in [kiln]")
        return self


@dataclass(frozen=True)
class LineFile(TomlFile):
    """A line as read from its file.

    Attributes
    ----------
    line
        What it says, checked.
    """

    line: Line

    @property
    def name(self) -> str:
        """Name of the line."""
        return self.line.line.name

    @property
    def state_directory(self) -> Path:
        """Folder of all that the line keeps, whole."""
        return self._whole(self.line.line.state_directory, self.path.absolute().parent)

    @property
    def journal_url(self) -> str:
        """Where the journal is, for SQLAlchemy."""
        if self.line.journal.url is not None:
            return self.line.journal.url
        from sqlalchemy import URL  # only who opens a journal needs it

        return URL.create("sqlite", database=str(self.state_directory / "journal.db")).render_as_string()

    @property
    def socket_path(self) -> Path:
        """The daemon's socket, whole."""
        return self._whole(self.line.api.socket or "line.sock", self._beside(self.line.api.socket))

    @property
    def token_path(self) -> Path:
        """File of the token, whole."""
        return self._whole(self.line.api.token_file or "token", self._beside(self.line.api.token_file))

    @property
    def camera_folder(self) -> Path | None:
        """Where images of fired tiles arrive, whole; ``None`` without a camera."""
        camera = self.line.camera
        return None if camera is None else self._whole(camera.folder, self.path.absolute().parent)

    @property
    def camera_profile(self) -> Path | None:
        """The camera's profile, whole; ``None`` if none is named."""
        camera = self.line.camera
        if camera is None or camera.profile is None:
            return None
        return self._whole(camera.profile, self.path.absolute().parent)

    @property
    def log_path(self) -> Path:
        """File of the daemon's log, whole."""
        return self.state_directory / "line.log"

    def _beside(self, named: str | None) -> Path:
        """Paths that the file names start at the file, others lie in the state directory."""
        return self.state_directory if named is None else self.path.absolute().parent

    @staticmethod
    def _whole(name: str, folder: Path) -> Path:
        try:
            return folder / Path(name).expanduser()
        except RuntimeError:  # ~ of an unknown user
            return folder / name


def load_line(path: Path) -> LineFile:
    """Read and check a line's file; the devices that it names are not looked for.

    Parameters
    ----------
    path
        A TOML file.

    Raises
    ------
    ConfigError
        If it can't be read or anything in it is wrong; carries all problems, in the order of their lines.
    """
    line, lines = read_model(path, Line, "line")
    file = LineFile(path, lines, line)
    length = len(str(file.socket_path).encode())
    if length > _MOST_SOCKET_BYTES:
        message = (
            f"{file.socket_path} has {length} bytes, a socket's name may have {_MOST_SOCKET_BYTES}: name a shorter one"
        )
        raise ConfigError([file.problem("api", "socket", message)])
    return file
