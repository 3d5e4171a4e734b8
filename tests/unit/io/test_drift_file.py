"""Drift state files: what is written is read back, and nothing else is believed."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tilefab.colour.drift import DriftState, no_drift
from tilefab.errors import ProfileError
from tilefab.io.drift_file import DriftFile, read_drift_file, write_drift_file

INKS = ("Blue", "Brown", "Ocre é")


def drift() -> DriftFile:
    fresh = no_drift(3)
    random = np.random.default_rng(1)
    lean = random.normal(size=fresh.covariance.shape)
    covariance = fresh.covariance + 1e-4 * lean @ lean.T
    return DriftFile(DriftState(0.02 * random.normal(size=len(fresh.mean)), covariance, 3), INKS, "ab" * 32, 48, "of x")


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path, given = tmp_path / "state.json", drift()
    write_drift_file(path, given)
    found, sha256 = read_drift_file(path)
    np.testing.assert_array_equal(found.state.mean, given.state.mean)
    np.testing.assert_array_equal(found.state.covariance, given.state.covariance)
    assert (found.ink_names, found.profile_sha256, found.patches, found.note) == (INKS, "ab" * 32, 48, "of x")
    assert found.state.inks == 3
    assert sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    again = tmp_path / "again.json"
    write_drift_file(again, found)
    assert again.read_bytes() == path.read_bytes()
    assert sorted(one.name for one in tmp_path.iterdir()) == ["again.json", "state.json"]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("schema_version", 2, "schema_version 2"),
        ("schema_version", None, "schema_version None"),
        ("ink_names", [], "1 to 8 names"),
        ("ink_names", ["a", 3, "b"], "1 to 8 names"),
        ("ink_names", ["a", "b"], "mean must be"),
        ("profile_sha256", "../x", "64 hexadecimal"),
        ("patches", -1, "whole number"),
        ("patches", True, "whole number"),
        ("note", 5, "must be a text"),
        ("mean", [0.0], "27 numbers"),
        ("mean", ["a"] * 27, "27 numbers"),
        ("mean", [[0.0]] + [0.0] * 26, "27 numbers"),
        ("mean", [0.7] + [0.0] * 26, "no press goes through"),
        ("mean", [0.0] * 26 + [99.0], "no press goes through"),
        ("mean", [0.0] * 26 + [10**400], "27 numbers"),
        ("covariance", 1, "27 x 27 numbers"),
        ("covariance", np.tri(27).tolist(), "symmetric"),
        ("covariance", (-np.eye(27)).tolist(), "positive"),
    ],
)
def test_what_no_state_holds_is_refused(tmp_path: Path, key: str, value: Any, message: str) -> None:
    path = tmp_path / "state.json"
    write_drift_file(path, drift())
    content = json.loads(path.read_text())
    content[key] = value
    path.write_text(json.dumps(content))
    with pytest.raises(ProfileError, match=message) as caught:
        read_drift_file(path)
    assert "\n" not in caught.value.message
    assert caught.value.message.startswith(str(path))
    assert caught.value.message.endswith("give a drift state written by `tilefab profile drift`")


@pytest.mark.parametrize("data", [b"", b"{", b"[1]", b"\xff\xfe", b"[" * 100_000, b'{"mean": NaN}', b" " * (5 << 20)])
def test_what_is_no_state_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(data)
    with pytest.raises(ProfileError):
        read_drift_file(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"none\.json: can't be read: No such file"):
        read_drift_file(tmp_path / "none.json")
