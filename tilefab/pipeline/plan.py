"""Planning a job: everything its file names is found and checked before any work is done."""

from __future__ import annotations

import hashlib
import importlib.resources
import importlib.util
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tilefab.config import Job, JobFile
from tilefab.config.models import OF_DESIGN
from tilefab.errors import ConfigError, ImageError, Problem, ProfileError
from tilefab.io.drift_file import DriftFile, read_drift_file
from tilefab.io.icc import IccProfile, parse_icc_profile, read_icc_profile, require_press_profile
from tilefab.io.press_profile import require_inks
from tilefab.io.scans import ScanFacts, scan_facts
from tilefab.pipeline.carried import carried_measurements, same_inks
from tilefab.sampling import FORMAT_VERSION, CropMap, PlaneLayout, TextureMap
from tilefab.types import SizeMm, SizePx
from tilefab.units import px_from_mm, size_px_from_mm

PREPARATION_VERSION = 3
"""Raised whenever the same scans and settings would be prepared into another map."""

CONVERSION_VERSION = 2
"""Raised whenever the same map and profile would be converted into other inks."""

PACKAGE_SCHEME = "package:"
MAPS_FOLDER = "maps"
"""Folder of a run's maps, inside its own."""


@dataclass(frozen=True)
class SlabScan:
    """A scan and what goes with it: a mask of what not to use, weights of what not to cut."""

    path: Path
    mask: Path | None
    facts: ScanFacts
    dpi: float
    weights: Path | None = None


@dataclass(frozen=True)
class Plan:
    """A job whose every file was found and checked.

    Attributes
    ----------
    job_file
        The job file as read.
    scans
        Its scans.
    input_profile
        The scanner's profile named by the job.
    press_profile
        The press's.
    output
        The run's folder.
    slab_key
        Hash of all that the prepared slab depends on.
    build_key
        Hash of all that the texture map depends on, but for the lists of crops to drop and to keep.
    map_key
        Hash of all that the texture map depends on.
    press_key
        Hash of all that the map in inks depends on, but for the map.
    job_hash
        Hash of all that decides the pixels of a face of given index.
    drift
        How the press has drifted since it was profiled, if the job tells.
    drift_sha256
        Hash of the file that tells it; empty where there is none.
    """

    job_file: JobFile
    scans: tuple[SlabScan, ...]
    input_profile: IccProfile | None
    press_profile: IccProfile
    output: Path
    slab_key: str
    build_key: str
    map_key: str
    press_key: str
    job_hash: str
    drift: DriftFile | None = None
    drift_sha256: str = ""

    @property
    def job(self) -> Job:
        """What the job file says."""
        return self.job_file.job

    @property
    def rebuilds_tables(self) -> bool:
        """Whether the press's tables are made for this plan, instead of taken from the profile."""
        return self.job.colour.rebuilds_tables or self.drift is not None

    @property
    def name(self) -> str:
        """The job's name, or that of its file."""
        return self.job.job.name or self.job_file.path.stem

    @property
    def seed(self) -> int:
        """The job seed."""
        return self.job.texture.seed

    @property
    def tile_mm(self) -> SizeMm:
        """Finished size of a tile."""
        width, height = self.job.tile.size_mm
        return SizeMm(width, height)

    @property
    def tile_px(self) -> SizePx:
        """Finished size of a tile in print pixels."""
        return size_px_from_mm(self.tile_mm, self.job.tile.dpi)

    @property
    def bleed_px(self) -> int:
        """Bleed in print pixels."""
        return px_from_mm(self.job.tile.bleed_mm, self.job.tile.dpi)

    @property
    def ink_names(self) -> tuple[str, ...]:
        """Name of each ink."""
        return tuple(self.job.colour.ink_names or self.press_profile.ink_names)

    @property
    def feature_px(self) -> int | None:
        """Size of the largest thing that should stay whole, in print pixels, if the job says it."""
        feature_mm = self.job.texture.feature_mm
        return None if feature_mm is None else max(1, px_from_mm(feature_mm, self.job.tile.dpi))

    def layout(self, texture: TextureMap) -> PlaneLayout:
        """Where the faces lie on the plane of a texture map."""
        rows, cols = texture.cell_shape
        return PlaneLayout(
            kind=self.job.tile.layout,
            seed=self.seed,
            face_rows=self.tile_px.rows,
            face_cols=self.tile_px.cols,
            bleed_px=self.bleed_px,
            cell_rows=rows,
            cell_cols=cols,
            columns=self.job.tile.columns or 1,
            reach_px=texture.overlap_px // 2 if isinstance(texture, CropMap) else 0,
        )


def check_scan_profile(path: Path, channels: int, profile: bytes | None) -> None:
    """Make sure that a scan's colours are known.

    Raises
    ------
    ProfileError
        If its profile is damaged or for other channels, or a CMYK scan has none.
    """
    expected = {1: "GRAY", 3: "RGB", 4: "CMYK"}.get(channels)
    if profile is None:
        if channels == 4:
            raise ProfileError(
                f"{path}: a CMYK scan without a profile: its colours are unknown; embed the profile, name it as "
                "input_profile, or scan as RGB",
                path=str(path),
            )
        return
    parsed = parse_icc_profile(profile, f"{path} (embedded profile)")
    if expected is not None and parsed.colour_space != expected:
        raise ProfileError(
            f"{path}: its embedded profile is for {parsed.colour_space}, but the scan is {expected}; save it again "
            "with a profile that fits, or name one as input_profile",
            path=str(path),
        )


def shipped_profiles() -> Path:
    """Folder of the press profiles that come with tilefab."""
    package = Path(str(importlib.resources.files("tilefab")))
    installed = package / "shipped_profiles"
    return installed if installed.is_dir() else package.parent / "profiles"


def plan_job(job_file: JobFile, output: Path | None = None) -> Plan:
    """Find and check every file a job names.

    Parameters
    ----------
    job_file
        The job as read.
    output
        Folder to use instead of the job's own.

    Raises
    ------
    ConfigError
        If a file is missing or a setting doesn't fit what is in it; carries all problems.
    ProfileError, ImageError
        If the only problem is a profile or an image that can't be used.
    """
    return _Planner(job_file).plan(output)


def require_drift_of(drift: DriftFile, profile: IccProfile, name: str) -> None:
    """Make sure that a drift state belongs to a profile.

    Raises
    ------
    ProfileError
        If it is of other inks or of another profile.
    """
    same_inks(drift.ink_names, profile, name)
    if drift.profile_sha256 != profile.sha256:
        raise ProfileError(
            f"{name}: is the drift from another profile than {profile.path}: fit it anew with tilefab profile drift",
            path=name,
        )


class _Planner:
    def __init__(self, job_file: JobFile) -> None:
        self.file, self.job = job_file, job_file.job
        self.problems: list[Problem] = []
        self.causes: list[ProfileError | ImageError] = []

    def plan(self, output: Path | None) -> Plan:
        job = self.job
        scans = self._scans()
        input_profile = self._input_profile()
        press_profile = self._press_profile()
        drift, drift_sha256 = self._drift(press_profile)
        if press_profile is not None and job.colour.rebuilds_tables:
            self._check_measurements(press_profile)
        if len(self.problems) == 1 and len(self.causes) == 1:
            cause = self.causes[0]
            raise type(cause)(str(self.problems[0]), path=cause.path) from cause
        if self.problems or press_profile is None:
            raise ConfigError(self.problems)
        other = "tile" if job.texture.design == "crops" else "crops"
        # What came later counts only where it is used, so that earlier jobs keep their keys.
        unused = {"grow", "grown_size_mm"} if job.texture.grow is None else set()
        texture = job.texture.model_dump(exclude={*OF_DESIGN[other], *unused})
        slab_facts = {
            "preparation": PREPARATION_VERSION,
            "scans": [[_file_hash(s.path), _optional_hash(s.mask), _optional_hash(s.weights), s.dpi] for s in scans],
            "input_profile": input_profile.sha256 if input_profile else "",
            "slab": job.slab.model_dump(exclude={"scans", "masks", "weights", "input_profile"}),
            "dpi": job.tile.dpi,
        }
        build_facts = {
            "format": FORMAT_VERSION,
            "slab": slab_facts,
            "texture": {key: value for key, value in texture.items() if key not in ("drop", "keep")},
        }
        chosen = {key: sorted(set(texture.get(key, []))) for key in ("drop", "keep")}
        map_facts = [build_facts, chosen]
        facts = press_facts(job, press_profile, drift_sha256)
        face_facts = {
            "size_mm": job.tile.size_mm,
            "bleed_mm": job.tile.bleed_mm,
            "layout": job.tile.layout,
            "columns": job.tile.columns,
        }
        folder = output if output is not None else self._from_job(job.output.directory)
        return Plan(
            job_file=self.file,
            scans=scans,
            input_profile=input_profile,
            press_profile=press_profile,
            output=Path(folder).resolve(),
            slab_key=hash_of(slab_facts),
            build_key=hash_of(build_facts),
            map_key=hash_of(map_facts),
            press_key=hash_of(facts),
            job_hash=hash_of([map_facts, facts, face_facts]),
            drift=drift,
            drift_sha256=drift_sha256,
        )

    def _scans(self) -> tuple[SlabScan, ...]:
        slab = self.job.slab
        if slab.weights is not None and self.job.texture.design == "tile":
            message = 'only seams between crops take notice of weights: remove them, or write design = "crops"'
            self.problems.append(self.file.problem("slab", "weights", message))
        scans = []
        nothing = [""] * len(slab.scans)
        for name, *names in zip(slab.scans, slab.masks or nothing, slab.weights or nothing, strict=True):
            path = self._find(name, "scans")
            mask, weights = (
                self._find(other, key) if other else None
                for other, key in zip(names, ("masks", "weights"), strict=True)
            )
            if path is None or any(other and not found for other, found in zip(names, (mask, weights), strict=True)):
                continue
            try:
                facts = scan_facts(path)
            except ImageError as error:
                self._add("scans", error)
                continue
            dpi = slab.dpi if slab.dpi is not None else facts.dpi
            if dpi is None:
                message = f"{path} doesn't state its resolution; say it with dpi = ... in [slab]"
                self.problems.append(self.file.problem("slab", "scans", message))
                continue
            fits = [
                other is None or self._fits(other, path, facts, key)
                for other, key in ((mask, "masks"), (weights, "weights"))
            ]
            if self._colours_are_known(path, facts) and all(fits):
                scans.append(SlabScan(path, mask, facts, dpi, weights))
        return tuple(scans)

    def _colours_are_known(self, path: Path, facts: ScanFacts) -> bool:
        """Whether a scan's own profile, or the lack of one, will do; an input profile of the job is checked apart."""
        try:
            if self.job.slab.input_profile is None:
                check_scan_profile(path, facts.channels, facts.icc_profile)
        except ProfileError as error:
            self._add("scans", error)
            return False
        return True

    def _fits(self, other: Path, path: Path, facts: ScanFacts, key: str) -> bool:
        what = "mask" if key == "masks" else "image of weights"
        try:
            size = scan_facts(other).size
            if size != facts.size:
                raise ImageError(
                    f"{other}: the {what} has {size.cols} x {size.rows} pixels but its scan {path.name} "
                    f"{facts.size.cols} x {facts.size.rows}; both must be of one size",
                    path=str(other),
                )
        except ImageError as error:
            self._add(key, error)
            return False
        return True

    def _input_profile(self) -> IccProfile | None:
        name = self.job.slab.input_profile
        path = self._find(name, "input_profile") if name else None
        if path is None:
            return None
        try:
            profile = read_icc_profile(path)
            if profile.device_class not in ("scnr", "mntr", "spac", "prtr"):
                raise ProfileError(
                    f"{path}: a profile of class {profile.device_class} doesn't describe a scanner; give the "
                    "scanner's input profile",
                    path=str(path),
                )
        except ProfileError as error:
            self._add("input_profile", error)
            return None
        return profile

    def _press_profile(self) -> IccProfile | None:
        path = self._find(self.job.colour.press_profile, "press_profile", section="colour")
        if path is None:
            return None
        try:
            profile = require_inks(require_press_profile(read_icc_profile(path)))
        except ProfileError as error:
            self._add("press_profile", error, section="colour")
            return None
        names = self.job.colour.ink_names
        if names is not None and len(names) != profile.channels:
            message = f"{len(names)} names for the {profile.channels} inks of {path.name}"
            self.problems.append(self.file.problem("colour", "ink_names", message))
        return profile

    def _drift(self, profile: IccProfile | None) -> tuple[DriftFile | None, str]:
        name = self.job.colour.drift
        path = self._find(name, "drift", section="colour") if name else None
        if path is None:
            return None, ""
        try:
            drift, sha256 = read_drift_file(path)
            if profile is not None:
                require_drift_of(drift, profile, str(path))
        except ProfileError as error:
            self._add("drift", error, section="colour")
            return None, ""
        return drift, sha256

    def _check_measurements(self, profile: IccProfile) -> None:
        """Tables are rebuilt from what the profile carries, with prices for its inks."""
        try:
            carried_measurements(profile)
        except ProfileError as error:
            self._add("press_profile", error, section="colour")
        names = self.job.colour.ink_names or profile.ink_names
        known = {name.casefold() for name in names}
        for ink in self.job.colour.ink_prices or {}:
            if ink.casefold() not in known:
                message = f"there is no ink {ink!r}; the inks are {', '.join(names)}"
                self.problems.append(self.file.problem("colour", "ink_prices", message))

    def _add(self, key: str, error: ProfileError | ImageError, section: str = "slab") -> None:
        self.problems.append(self.file.problem(section, key, error.message))
        self.causes.append(error)

    def _from_job(self, name: str) -> Path:
        return self.file.path.absolute().parent / _expanded(name)

    def _find(self, name: str, key: str, section: str = "slab") -> Path | None:
        """Find a file named by the job: beside the job file, in the current folder, or shipped with tilefab."""
        if name.startswith(PACKAGE_SCHEME):
            path = _in_package(name.removeprefix(PACKAGE_SCHEME))
            if path is None:
                message = f"{name}: no installed package holds this file; write package:NAME/FOLDER/FILE"
                self.problems.append(self.file.problem(section, key, message))
            return path
        tried = [self._from_job(name), _expanded(name).absolute()]
        if key == "press_profile":
            tried.append(shipped_profiles() / name)
        for path in tried:
            with suppress(OSError):  # too long a name, a folder that may not be looked into
                if path.is_file():
                    return path.resolve()
        places = " nor ".join(dict.fromkeys(str(path) for path in tried))
        self.problems.append(self.file.problem(section, key, f"there is no file {places}"))
        return None


def _expanded(name: str) -> Path:
    """A path with ~ resolved; one of an unknown user is taken as it stands."""
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)


def _in_package(name: str) -> Path | None:
    """File inside an installed package, which is found but not imported: a job file must not run code."""
    package, _, inside = name.partition("/")
    if not package.isidentifier() or not inside:
        return None
    found = importlib.util.find_spec(package)
    for folder in (found.submodule_search_locations or []) if found is not None else []:
        path = Path(folder) / inside
        try:
            if path.is_file():
                return path
        except (OSError, ValueError):
            return None
    return None


def _file_hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _optional_hash(path: Path | None) -> str:
    return _file_hash(path) if path is not None else ""


def press_facts(job: Job, profile: IccProfile, drift_sha256: str) -> dict[str, object]:
    """All that a job's map in inks depends on, but for the map; the drift's hash is empty where there is none."""
    facts: dict[str, object] = {
        "conversion": CONVERSION_VERSION,
        "profile": profile.sha256,
        "intent": job.colour.intent,
        "limit": job.colour.ink_limit_percent,
        "bits": job.output.bits,
    }
    if job.colour.rebuilds_tables or drift_sha256:
        facts["tables"] = {
            "separation": job.colour.separation,
            "prices": job.colour.ink_prices,
            "gamut": job.colour.gamut,
            "drift": drift_sha256,
        }
    return facts


def hash_of(facts: object) -> str:
    """SHA-256 of facts, as hex digits."""
    text = json.dumps(facts, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
