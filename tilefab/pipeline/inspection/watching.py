"""The camera's folder: which images in it are new, whole, and in which order they were taken."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

_KINDS = frozenset({".png", ".tif", ".tiff", ".jpg", ".jpeg"})
_TIMED = re.compile(r"(\d{8}T\d{6})(\.\d{1,6})?Z(?![0-9A-Za-z])")
_MOST_NAME = 200
_SETTLED_LOOKS = 2
"""How often in a row a file must look the same before it is read: a camera may be writing it."""
_EMPTY_LOOKS = 20
_MOST_TRIES = 4
_MANY_NAMES = 2000
"""From here on a folder is listed only when it has changed,"""
_LOOKS_LEFT_OUT = 20
"""and after so many looks in any case: two changes within a tick of the file system's clock look like one."""


@dataclass(frozen=True)
class ImageFile:
    """An image that waits to be inspected.

    Attributes
    ----------
    name
        Of its file.
    path
        The file.
    taken_at
        When it was taken: as its name says, or else when the file was written last.
    """

    name: str
    path: Path
    taken_at: datetime


@dataclass
class _Seen:
    size: int
    changed_ns: int
    looks: int = 1
    tries: int = 0
    wait: int = 0


def time_in_name(name: str) -> datetime | None:
    """The time, UTC, that the name of an image begins with.

    >>> time_in_name("20261124T083015.250Z_17.png")
    datetime.datetime(2026, 11, 24, 8, 30, 15, 250000, tzinfo=datetime.timezone.utc)
    >>> time_in_name("tile_17.png") is None
    True
    """
    found = _TIMED.match(name)
    if found is None:
        return None
    try:
        whole = datetime.strptime(found[1], "%Y%m%dT%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    return whole.replace(microsecond=round(float(found[2] or 0.0) * 1_000_000) % 1_000_000)


class CameraFolder:
    """New images of a folder, in the order they were taken.

    Parameters
    ----------
    folder
        The folder; it may come later, or go and come again.
    done
        Says which of some names need not be looked at any more. Asked once for each name.
    """

    def __init__(self, folder: Path, done: Callable[[Sequence[str]], frozenset[str]]) -> None:
        self._folder, self._done = folder, done
        self._finished: set[str] = set()
        self._waiting: dict[str, _Seen] = {}
        self._changed_ns: int | None = None
        self._left_out = 0
        self.problem = ""

    def look(self) -> list[ImageFile]:
        """Images that are whole and wait, oldest first.

        An image is taken for whole once it looked the same twice in a row. Hidden files, folders and files of other
        kinds are left alone. ``problem`` tells why the folder can't be read; it is empty if it can.
        """
        try:
            changed_ns = self._folder.stat().st_mtime_ns
            if changed_ns == self._changed_ns and not self._waiting and self._left_out < _LOOKS_LEFT_OUT:
                self._left_out += 1
                return []
            with os.scandir(self._folder) as entries:
                names = [entry.name for entry in entries if _is_image(entry.name)]
        except OSError as error:
            self.problem = f"{self._folder}: {error.strerror or error}"
            return []
        self.problem = ""
        self._changed_ns = changed_ns if len(names) > _MANY_NAMES else None
        self._left_out = 0
        there = set(names)
        self._finished &= there
        self._waiting = {name: seen for name, seen in self._waiting.items() if name in there}
        fresh = [name for name in names if name not in self._finished and name not in self._waiting]
        if fresh:
            self._finished |= self._done(fresh)
        images = [self._whole(name) for name in names if name not in self._finished]
        return sorted((image for image in images if image is not None), key=lambda image: (image.taken_at, image.name))

    def finish(self, names: Sequence[str]) -> None:
        """Never tell of images again."""
        for name in names:
            self._waiting.pop(name, None)
            self._finished.add(name)

    def retry(self, name: str) -> bool:
        """Tell of an image again after a while, since it couldn't be read; whether that is worth it."""
        seen = self._waiting.get(name)
        if seen is None:
            return False
        seen.tries += 1
        seen.wait = 2**seen.tries
        return seen.tries < _MOST_TRIES

    def _whole(self, name: str) -> ImageFile | None:
        path = self._folder / name
        try:
            facts = path.stat()
        except OSError:
            # Gone again, or a link to nowhere.
            self._waiting.pop(name, None)
            return None
        seen = self._waiting.get(name)
        if seen is None or (seen.size, seen.changed_ns) != (facts.st_size, facts.st_mtime_ns):
            self._waiting[name] = _Seen(facts.st_size, facts.st_mtime_ns, tries=0 if seen is None else seen.tries)
            return None
        seen.looks += 1
        if seen.wait:
            seen.wait -= 1
            return None
        if seen.looks < (_SETTLED_LOOKS if facts.st_size else _EMPTY_LOOKS) or not path.is_file():
            return None
        return ImageFile(name, path, time_in_name(name) or datetime.fromtimestamp(facts.st_mtime, UTC))


def thinned(images: Sequence[ImageFile], most: int) -> tuple[list[ImageFile], list[ImageFile]]:
    """Leave out images evenly, so that no more than ``most`` are left.

    Returns
    -------
    tuple
        Those kept, the newest among them, and those left out; both in order.
    """
    if len(images) <= most:
        return list(images), []
    step = -(-len(images) // most)
    last = (len(images) - 1) % step
    kept = [image for place, image in enumerate(images) if place % step == last]
    left = [image for place, image in enumerate(images) if place % step != last]
    return kept, left


def _is_image(name: str) -> bool:
    return not name.startswith(".") and Path(name).suffix.lower() in _KINDS and len(name) <= _MOST_NAME
