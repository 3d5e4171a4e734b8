"""Writing files so that a crash never leaves half of one, or of two."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tilefab.errors import OutputError

TEMPORARY_PREFIX = ".tilefab-"

_ADVICE = {
    errno.ENOSPC: "the disk is full: free some space and run again",
    errno.EDQUOT: "the disk quota is used up: free some space and run again",
    errno.EFBIG: "the file would be larger than is allowed here",
    errno.EACCES: "permission denied: choose another folder or change its permissions",
    errno.EPERM: "not permitted: choose another folder or change its permissions",
    errno.EROFS: "the folder is read-only: choose another",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EEXIST: "a file of this name is in the way",
    errno.EISDIR: "a folder is in the way",
    errno.ENOENT: "the folder doesn't exist and can't be made here",
}


def output_error(action: str, path: Path, error: OSError) -> OutputError:
    """Explain a failed write to the user."""
    if error.errno is None and error.strerror is None:
        # NumPy's tofile doesn't say why it wrote less than it should.
        advice = f"not all of it could be written ({error}): is the disk full?"
    else:
        advice = _ADVICE.get(error.errno or 0, error.strerror or str(error))
    return OutputError(f"{path}: can't {action}: {advice}", path=str(path))


def refuse_overwriting(output: Path, read: Iterable[Path | None]) -> None:
    """Make sure that a result doesn't take the place of a file that it is made from.

    Raises
    ------
    OutputError
        If ``output`` is one of the files in ``read``.
    """
    if any(path is not None and path.resolve() == output.resolve() for path in read):
        raise OutputError(f"{output}: is one of the files to read: choose another name", path=str(output))


def make_folder(path: Path) -> None:
    """Make a folder and those above it.

    Raises
    ------
    OutputError
        If that isn't possible.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error("make this folder", path, error) from error


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder; when the block ends well it is synced and becomes ``path``.

    If the block raises, the temporary file is removed and an earlier file at ``path`` stays as it was.

    Raises
    ------
    OutputError
        If the file can't be written.
    """
    make_folder(path.parent)
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: can't write: something that is not a plain file is in the way", path=str(path))
    try:
        handle, name = tempfile.mkstemp(prefix=f"{TEMPORARY_PREFIX}{os.getpid()}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise output_error("write", path, error) from error
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise output_error("write", path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def atomic_write(path: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` make a file at a temporary path, then give it its name; see `atomic_path`."""
    with atomic_path(path) as temporary:
        write(temporary)


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Write a small file as a whole or not at all; see `atomic_path`."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def sync_folder(path: Path) -> None:
    """Make a rename in this folder survive a power cut, where the system can do that."""
    with suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of processes that are no more."""
    for path in folder.glob(f"{TEMPORARY_PREFIX}*"):
        owner = path.name.removeprefix(TEMPORARY_PREFIX).partition("-")[0]
        if not (owner.isdigit() and _is_alive(int(owner))):
            with suppress(OSError):
                path.unlink()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return process != os.getpid()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
