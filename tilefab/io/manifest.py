"""The record of a run: one line of JSON for every finished face, and a lock so that only one run writes."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_type_hints

from tilefab.errors import OutputError
from tilefab.io.atomic import atomic_write_bytes, make_folder, output_error

MANIFEST_NAME = "manifest.jsonl"
JOB_RECORD_NAME = "job.json"
LOCK_NAME = ".lock"


@dataclass(frozen=True)
class FaceRecord:
    """One finished face.

    Attributes
    ----------
    face
        Its index.
    file
        Its file, relative to the output folder.
    rows, cols, channels, dtype
        Shape and type of its pixels, bleed included.
    dpi
        Print resolution.
    origin
        [row, col] on the plane of its top left pixel.
    sha256
        Of the raw pixels: C order, little-endian.
    texture_map, press_map, press_profile, job
        Hashes of the texture map, of the same map in inks, of the profile, and of all in the job that decides pixels.
    seed
        Job seed.
    proof
        Its proof's file, or ``None``.
    """

    face: int
    file: str
    rows: int
    cols: int
    channels: int
    dtype: str
    dpi: float
    origin: list[int]
    sha256: str
    texture_map: str
    press_map: str
    press_profile: str
    job: str
    seed: int
    proof: str | None = None


class Manifest:
    """The manifest of one output folder.

    A line is synced before the next face is begun. A line that a crash cut short is dropped, and its face, which has
    its file already, is compared with that file when it is made again.

    Parameters
    ----------
    folder
        The output folder.
    repair
        Also remove a line that was cut short from the file. Only for who holds the folder (`locked_folder`): to
        others such a line may be one that a run is just writing.

    Raises
    ------
    OutputError
        If the file can't be read, or a line of it isn't a record or contradicts another.
    """

    def __init__(self, folder: Path, *, repair: bool = False) -> None:
        self.path = folder / MANIFEST_NAME
        self.records: dict[int, FaceRecord] = {}
        if not self.path.exists():
            return
        try:
            raw = self.path.read_bytes()
        except OSError as error:
            raise OutputError(f"{self.path}: can't be read: {error.strerror}", path=str(self.path)) from error
        whole = raw[: raw.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                record = _record(line)
            except (ValueError, TypeError, KeyError, RecursionError) as error:
                raise OutputError(
                    f"{self.path}:{number}: not a line of a manifest ({error}); use another output folder, or "
                    "restore the manifest",
                    path=str(self.path),
                ) from error
            earlier = self.records.setdefault(record.face, record)
            if earlier.sha256 != record.sha256:
                raise OutputError(
                    f"{self.path}:{number}: face {record.face} is recorded twice with different pixels; use "
                    "another output folder",
                    path=str(self.path),
                )
        if repair and whole != raw:
            atomic_write_bytes(self.path, whole)

    def append(self, record: FaceRecord) -> None:
        """Record a finished face for good.

        Raises
        ------
        OutputError
            If the line can't be written; nothing of it stays behind.
        """
        line = (json.dumps(asdict(record), sort_keys=False) + "\n").encode()
        try:
            with self.path.open("ab", buffering=0) as file:
                begin = file.tell()
                try:
                    written = 0
                    while written < len(line):
                        written += file.write(line[written:])
                    os.fsync(file.fileno())
                except OSError:
                    os.ftruncate(file.fileno(), begin)
                    raise
        except OSError as error:
            raise output_error("record a face", self.path, error) from error
        self.records[record.face] = record


def _record(line: bytes) -> FaceRecord:
    values = json.loads(line)
    if not isinstance(values, dict):
        raise TypeError("no record")
    kinds = get_type_hints(FaceRecord)
    record = FaceRecord(**{name: value for name, value in values.items() if name in kinds})
    for name, kind in kinds.items():
        value = getattr(record, name)
        if not isinstance(value, list if name == "origin" else kind) or isinstance(value, bool):
            raise TypeError(f"{name} is {value!r}")
    for file in (record.file, record.proof or ""):
        if Path(file).is_absolute() or ".." in Path(file).parts:
            raise ValueError(f"{file} is outside the folder")
    return record


def folder_owner(folder: Path) -> str | None:
    """Hash of the job that a folder belongs to; ``None`` if it is nobody's yet.

    Raises
    ------
    OutputError
        If its record can't be read.
    """
    path = folder / JOB_RECORD_NAME
    if not path.exists():
        return None
    try:
        return str(json.loads(path.read_bytes())["job"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(
            f"{path}: can't be read, so it isn't known whose folder this is; use another output folder", path=str(path)
        ) from error


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold an output folder, so that no other run writes to it at the same time.

    The lock is the operating system's and goes with the process, however it ends.

    Raises
    ------
    OutputError
        If another run holds the folder, or it can't be written to.
    """
    make_folder(folder)
    path = folder / LOCK_NAME
    try:
        file = path.open("ab")
    except OSError as error:
        raise output_error("write to this folder", folder, error) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OutputError(
                f"{folder}: another run is writing to this folder; wait for it or use another",
                path=str(folder),
            ) from error
        yield
