"""Every job file that is shipped runs as it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

# A line and a plant lie beside them.
JOBS = [path for path in sorted((Path(__file__).parents[2] / "jobs").glob("*.toml")) if "[slab]" in path.read_text()]


def test_there_are_some() -> None:
    assert "demo" in {path.stem for path in JOBS}


@pytest.mark.parametrize("job", JOBS, ids=lambda path: path.stem)
def test_a_shipped_job_runs(workshop: Any, job: Path) -> None:
    done = workshop.cli("run", job, "--faces", "0:1", "--out", workshop.out, "--json")
    assert done.code == 0, done.err
    assert (done.json["written"], done.json["faces"]) == (1, 1)
    assert list(workshop.hashes()) == [0]
    assert Path(done.json["report"]).read_bytes().startswith(b"%PDF-")
    assert done.json["warnings"] == []
