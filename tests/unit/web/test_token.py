"""The token's file: made so that nobody else can read it, refused if somebody could."""

import os
import stat
from pathlib import Path

import pytest

from tilefab.errors import ConfigError
from tilefab.web import token as token_module
from tilefab.web.token import make_token, read_token, same_token


def test_a_new_token_is_its_owners_alone_and_stays(tmp_path: Path) -> None:
    before = os.umask(0)  # the least careful one
    try:
        token = make_token(tmp_path / "token")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "token").stat().st_mode) == 0o600
    assert len(token) >= 43
    assert make_token(tmp_path / "token") == token == read_token(tmp_path / "token")
    assert make_token(tmp_path / "other") != token


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o644, 0o666, 0o610])
def test_one_that_others_may_read_or_change_is_refused(tmp_path: Path, mode: int) -> None:
    make_token(tmp_path / "token")
    (tmp_path / "token").chmod(mode)
    for take in (read_token, make_token):
        with pytest.raises(ConfigError, match="others may read or change"):
            take(tmp_path / "token")


@pytest.mark.parametrize(
    "content", [b"", b"short", b"x" * 600, b"a" * 20 + b" " + b"a" * 20, "é".encode() * 20, b"a\x00" * 20]
)
def test_what_is_no_token_is_refused_and_not_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "token"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match="not a token") as caught:
        read_token(path)
    assert not content or content.decode() not in caught.value.message


def test_none_is_told_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="daemon makes one"):
        read_token(tmp_path / "token")
    with pytest.raises(ConfigError, match="can't be written"):
        make_token(tmp_path / "nowhere" / "token")


def test_links_folders_and_pipes_are_refused(tmp_path: Path) -> None:
    make_token(tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe", 0o600)
    for name in ("link", "folder", "pipe"):
        for take in (read_token, make_token):
            with pytest.raises(ConfigError):
                take(tmp_path / name)


def test_a_full_disk_leaves_no_half_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ConfigError, match="No space left"):
        make_token(tmp_path / "token")
    assert list(tmp_path.iterdir()) == []


def test_tokens_are_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[bytes, bytes]] = []

    def compare(a: bytes, b: bytes) -> bool:
        asked.append((a, b))
        return a == b

    monkeypatch.setattr(token_module.hmac, "compare_digest", compare)
    assert same_token("abc", "abc")
    assert not same_token("ab", "abc")
    assert asked == [(b"abc", b"abc"), (b"ab", b"abc")]


def test_any_text_can_be_compared() -> None:
    assert not same_token("é\udcff", "abc")
    assert not same_token("", "abc")
