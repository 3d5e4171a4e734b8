"""What a loss of power may leave of SQLite's files.

`Recorder` puts itself between SQLite and its VFS, in the very library that Python's `sqlite3` uses: real files are
still written, and every write, truncation, sync, creation and deletion is put down. `Disk` plays them back as far as
one likes and then loses power: what was synced is there; of the rest nothing, all, or any part, in sectors of 512
bytes; names of files likewise. That a write changes nothing beside its own bytes is SQLite's own assumption (powersafe
overwrite).
"""

from __future__ import annotations

import ctypes
import random
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import CFUNCTYPE, POINTER, Structure, c_char_p, c_int, c_int64, c_void_p
from dataclasses import dataclass, field
from pathlib import Path

SECTOR = 512
WAYS = ("none", "all", "torn", "random", "garbage")
"""Of what wasn't synced: nothing; all; a prefix, cut at a sector; any sectors; any, and rubbish where a file grew."""

_OK, _OPEN_CREATE = 0, 0x4


class Unreachable(Exception):  # noqa: N818 - a reason to skip, not an error
    """The interpreter's SQLite can't be reached; says why."""


@dataclass(frozen=True)
class Event:
    """Something that SQLite asked of the system.

    ``kind`` is ``create``, ``delete`` (of ``path``), ``sync_folder`` (``path``), ``write``, ``truncate`` (``offset`` is
    the size) or ``sync`` (of ``file``).
    """

    kind: str
    path: str = ""
    file: int = -1
    offset: int = 0
    data: bytes = field(default=b"", repr=False)


_METHOD_NAMES = (
    "close read write truncate sync file_size lock unlock check_reserved_lock file_control sector_size "
    "device_characteristics shm_map shm_lock shm_barrier shm_unmap fetch unfetch"
)
_VFS_NAMES = (
    "app_data open delete access full_pathname dl_open dl_error dl_sym dl_close randomness sleep current_time "
    "get_last_error current_time_int64 set_system_call get_system_call next_system_call"
)


class _Methods(Structure):
    _fields_ = [
        ("version", c_int),
        *((name, c_void_p) for name in _METHOD_NAMES.split()),
    ]


class _File(Structure):
    _fields_ = [("methods", POINTER(_Methods))]


class _Vfs(Structure):
    _fields_ = [
        ("version", c_int),
        ("file_size", c_int),
        ("most_path", c_int),
        ("next", c_void_p),
        ("name", c_char_p),
        *((name, c_void_p) for name in _VFS_NAMES.split()),
    ]


_OPEN = CFUNCTYPE(c_int, c_void_p, c_void_p, POINTER(_File), c_int, c_void_p)
_DELETE = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int)
_CLOSE = CFUNCTYPE(c_int, c_void_p)
_WRITE = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int, c_int64)
_TRUNCATE = CFUNCTYPE(c_int, c_void_p, c_int64)
_SYNC = CFUNCTYPE(c_int, c_void_p, c_int)
_SET_CALL = CFUNCTYPE(c_int, c_void_p, c_char_p, c_void_p)
_GET_CALL = CFUNCTYPE(c_void_p, c_void_p, c_char_p)
_OPEN_FOLDER = CFUNCTYPE(c_int, c_void_p, c_void_p)


def _library() -> ctypes.CDLL:
    """The SQLite that `sqlite3` uses, or `Unreachable`."""
    maps = Path("/proc/self/maps")
    if not maps.exists():
        raise Unreachable("the system doesn't say which libraries are loaded")
    loaded = {line.split(maxsplit=5)[-1].strip() for line in maps.read_text().splitlines() if "sqlite3" in line}
    source = sqlite3.connect(":memory:")
    try:
        wanted = source.execute("SELECT sqlite_source_id()").fetchone()[0]
    finally:
        source.close()
    for path in sorted(name for name in loaded if ".so" in name):
        library = ctypes.CDLL(path)
        try:
            library.sqlite3_sourceid.restype = c_char_p
            library.sqlite3_vfs_find.argtypes, library.sqlite3_vfs_find.restype = [c_char_p], POINTER(_Vfs)
            library.sqlite3_vfs_register.argtypes = [POINTER(_Vfs), c_int]
            library.sqlite3_vfs_unregister.argtypes = [POINTER(_Vfs)]
        except AttributeError:
            continue
        if library.sqlite3_sourceid().decode() == wanted:
            return library
    raise Unreachable("SQLite is linked into the interpreter, or its functions aren't exported")


class Recorder:
    """Every write, sync and name under a folder, in order.

    Parameters
    ----------
    folder
        What is in it when recording begins counts as synced.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder.resolve())
        self.events: list[Event] = []
        self.names: dict[str, int] = {}
        self.base: dict[str, bytes] = {}
        for path in sorted(folder.resolve().iterdir()):
            self.names[str(path)] = len(self.names)
            self.base[str(path)] = path.read_bytes()
        self._files = len(self.names)
        self._open: dict[int, int] = {}
        self._callbacks: dict[int, list[object]] = {}
        self._methods: dict[int, _Methods] = {}

    def disk(self) -> Disk:
        """The disk as it was when recording began."""
        names = {path: number for number, path in enumerate(sorted(self.base))}
        return Disk(names, {names[path]: bytearray(data) for path, data in self.base.items()})

    @contextmanager
    def recording(self) -> Iterator[Recorder]:
        """Record what connections opened meanwhile do; they must be closed meanwhile, too.

        Raises
        ------
        Unreachable
            If this interpreter's SQLite can't be listened to.
        """
        library = _library()
        found = library.sqlite3_vfs_find(b"unix")
        if not found or found.contents.version < 3:
            raise Unreachable("SQLite has no VFS of the Unix kind")
        original = found.contents
        vfs = _Vfs.from_buffer_copy(original)
        vfs.name = b"tilefab-recorder"
        open_original, delete_original = _OPEN(original.open), _DELETE(original.delete)

        def open_file(_: int, name: int, file: object, flags: int, told: int) -> int:
            path = ctypes.string_at(name).decode() if name else ""
            ours = path.startswith(self.folder + "/")
            new = ours and flags & _OPEN_CREATE and not Path(path).exists()
            code = open_original(ctypes.addressof(vfs), name, file, flags, told)
            if code == _OK and ours and Path(path).exists():
                if new or path not in self.names:
                    self.names[path] = self._files
                    self._files += 1
                    self.events.append(Event("create", path, self.names[path]))
                self._wrap(file, self.names[path])
            return int(code)

        def delete_file(_: int, name: int, sync: int) -> int:
            path = ctypes.string_at(name).decode()
            if path in self.names and Path(path).exists():
                self.events.append(Event("delete", path, self.names.pop(path)))
            return int(delete_original(ctypes.addressof(vfs), name, sync))

        get_call, set_call = _GET_CALL(original.get_system_call), _SET_CALL(original.set_system_call)
        address = get_call(ctypes.addressof(original), b"openDirectory")
        open_folder_original = _OPEN_FOLDER(address)

        def open_folder(name: int, descriptor: int) -> int:
            # SQLite opens a folder only to sync it.
            path = str(Path(ctypes.string_at(name).decode()).parent)
            code = open_folder_original(name, descriptor)
            if code == _OK and path == self.folder:
                self.events.append(Event("sync_folder", path))
            return int(code)

        callbacks = _OPEN(open_file), _DELETE(delete_file), _OPEN_FOLDER(open_folder)
        vfs.open, vfs.delete = (ctypes.cast(callback, c_void_p).value for callback in callbacks[:2])
        library.sqlite3_vfs_register(vfs, 1)
        set_call(ctypes.addressof(original), b"openDirectory", ctypes.cast(callbacks[2], c_void_p))
        try:
            yield self
        finally:
            set_call(ctypes.addressof(original), b"openDirectory", None)
            library.sqlite3_vfs_unregister(vfs)
            if self._open:
                # The library would call what is about to be freed.
                raise RuntimeError("a connection outlived the recording")

    def _wrap(self, file: object, number: int) -> None:
        """Hear of what is done with an open file."""
        methods = file.contents.methods  # type: ignore[attr-defined]
        key = ctypes.addressof(methods.contents)
        if key not in self._methods:
            self._methods[key] = self._wrapped(methods.contents, key)
        self._open[ctypes.addressof(file.contents)] = number  # type: ignore[attr-defined]
        file.contents.methods = ctypes.pointer(self._methods[key])  # type: ignore[attr-defined]

    def _wrapped(self, methods: _Methods, key: int) -> _Methods:
        close_original, sync_original = _CLOSE(methods.close), _SYNC(methods.sync)
        write_original, truncate_original = _WRITE(methods.write), _TRUNCATE(methods.truncate)

        def close(file: int) -> int:
            self._open.pop(file, None)
            return int(close_original(file))

        def write(file: int, data: int, size: int, offset: int) -> int:
            code = write_original(file, data, size, offset)
            if code == _OK:
                content = ctypes.string_at(data, size)
                self.events.append(Event("write", file=self._open[file], offset=offset, data=content))
            return int(code)

        def truncate(file: int, size: int) -> int:
            code = truncate_original(file, size)
            if code == _OK:
                self.events.append(Event("truncate", file=self._open[file], offset=size))
            return int(code)

        def sync(file: int, flags: int) -> int:
            # Put down before: the folder's sync, if there is one, comes within.
            self.events.append(Event("sync", file=self._open[file]))
            return int(sync_original(file, flags))

        wrapped = _Methods.from_buffer_copy(methods)
        kept = [_CLOSE(close), _WRITE(write), _TRUNCATE(truncate), _SYNC(sync)]
        names = "close", "write", "truncate", "sync"
        for name, callback in zip(names, kept, strict=True):
            setattr(wrapped, name, ctypes.cast(callback, c_void_p).value)
        self._callbacks[key] = [*kept, methods]
        return wrapped


class Disk:
    """Files as they are on the platter, and what isn't there yet.

    Parameters
    ----------
    names
        File of each path.
    contents
        Content of each file.
    """

    def __init__(self, names: dict[str, int], contents: dict[int, bytearray]) -> None:
        self._names, self._contents = dict(names), contents
        self._pending: dict[int, list[Event]] = {}
        self._pending_names: list[Event] = []

    def apply(self, event: Event) -> None:
        """Go on by one event."""
        if event.kind == "sync":
            for done in self._pending.pop(event.file, []):
                _change(self._contents.setdefault(event.file, bytearray()), done)
        elif event.kind == "sync_folder":
            for done in self._pending_names:
                _rename(self._names, done)
            self._pending_names.clear()
        elif event.kind in ("create", "delete"):
            self._pending_names.append(event)
        else:
            self._pending.setdefault(event.file, []).append(event)

    def unsynced(self) -> int:
        """How many writes and names a loss of power puts at risk."""
        return sum(map(len, self._pending.values())) + len(self._pending_names)

    def after_power_loss(self, way: str, chance: random.Random) -> dict[str, bytes]:
        """Content of each file that is left, by path; see `WAYS`."""
        names = dict(self._names)
        for event in self._kept(self._pending_names, way, chance):
            _rename(names, event)
        left = {}
        for path, number in names.items():
            content = bytearray(self._contents.get(number, b""))
            pending = self._pending.get(number, [])
            if way in ("none", "all"):
                for event in pending if way == "all" else []:
                    _change(content, event)
            elif way == "torn":
                kept = pending[: chance.randint(0, len(pending))]
                for event in kept[:-1]:
                    _change(content, event)
                for event in kept[-1:]:
                    sectors = _sectors(event)
                    for part in sectors[: chance.randint(0, len(sectors))]:
                        _change(content, part)
            else:
                self._scatter(content, pending, way, chance)
            left[path] = bytes(content)
        return left

    @staticmethod
    def _kept(events: list[Event], way: str, chance: random.Random) -> list[Event]:
        if way in ("none", "all"):
            return events if way == "all" else []
        if way == "torn":
            return events[: chance.randint(0, len(events))]
        return [event for event in events if chance.random() < 0.5]

    @staticmethod
    def _scatter(content: bytearray, pending: list[Event], way: str, chance: random.Random) -> None:
        if way == "garbage":
            end = max((event.offset + len(event.data) for event in pending if event.kind == "write"), default=0)
            content += chance.randbytes(max(0, end - len(content)))
        likely = chance.choice((0.1, 0.5, 0.9))
        for event in pending:
            for part in _sectors(event):
                if chance.random() < likely:
                    _change(content, part)


def _sectors(event: Event) -> list[Event]:
    """The parts of a write that reach the disk each on its own."""
    if event.kind != "write":
        return [event]
    parts, begin, end = [], event.offset, event.offset + len(event.data)
    while begin < end:
        stop = min(end, (begin // SECTOR + 1) * SECTOR)
        data = event.data[begin - event.offset : stop - event.offset]
        parts.append(Event("write", file=event.file, offset=begin, data=data))
        begin = stop
    return parts


def _change(content: bytearray, event: Event) -> None:
    if event.kind == "truncate":
        del content[event.offset :]
        content += bytes(event.offset - len(content))
        return
    content += bytes(max(0, event.offset - len(content)))
    content[event.offset : event.offset + len(event.data)] = event.data


def _rename(names: dict[str, int], event: Event) -> None:
    if event.kind == "create":
        names[event.path] = event.file
    elif names.get(event.path) == event.file:
        del names[event.path]
