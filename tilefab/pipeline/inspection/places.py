"""Where a line's inspections are kept."""

from __future__ import annotations

from pathlib import Path

from tilefab.config.line import LineFile
from tilefab.io.journal import sqlite_url

STORE_FILE = "inspection.db"
LOG_FILE = "inspection.log"


def store_url(line_file: LineFile) -> str:
    """Where a line's inspections are kept: beside its journal."""
    if line_file.journal_url.startswith("postgresql"):
        return line_file.journal_url
    return sqlite_url(line_file.state_directory / STORE_FILE)


def inspection_log_path(line_file: LineFile) -> Path:
    """File of the inspector's log."""
    return line_file.state_directory / LOG_FILE
