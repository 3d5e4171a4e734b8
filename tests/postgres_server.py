"""A PostgreSQL server for tests alone, on a socket in a folder; where none is installed they say so and skip."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_ACCOUNT = "postgres"


def missing() -> str:
    """Why no server can be had here; empty if one can."""
    if importlib.util.find_spec("psycopg") is None:
        return "psycopg isn't installed (extra postgres)"
    if _programs() is None:
        return "PostgreSQL's server isn't installed"
    return ""


@contextmanager
def serving() -> Iterator[str]:
    """Start a server with an empty cluster; gives the url of its host, to which ``&dbname=...`` may be added."""
    programs = _programs()
    if programs is None:
        raise RuntimeError(missing())
    # The server refuses to be root's.
    account = _ACCOUNT if os.geteuid() == 0 else None
    folder = Path(tempfile.mkdtemp(prefix="tilefab-pg-"))
    try:
        if account is not None:
            shutil.chown(folder, account)
        cluster = folder / "cluster"

        def call(*arguments: str) -> None:
            subprocess.run(arguments, check=True, user=account, stdout=subprocess.DEVNULL, cwd=folder, timeout=60)

        call(str(programs / "initdb"), "-D", str(cluster), "-U", _ACCOUNT, "-A", "trust", "--no-sync", "-E", "UTF8")
        options = f"-c listen_addresses='' -c unix_socket_directories='{folder}'"
        control = str(programs / "pg_ctl"), "-D", str(cluster), "-w", "-s"
        call(*control, "-l", str(folder / "log"), "-o", options, "start")
        try:
            yield f"postgresql://{_ACCOUNT}@/?host={folder}"
        finally:
            call(*control, "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _programs() -> Path | None:
    """Folder of the server's programs."""
    found = shutil.which("initdb")
    if found is not None:
        return Path(found).resolve().parent
    installed = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: path.parts[-3].zfill(4))
    return installed[-1].parent if installed else None
