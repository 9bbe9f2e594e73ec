"""``altd password`` and ``altd token`` as a technician calls them, at a terminal too."""

import os
import pty
import sys
import time
from pathlib import Path

import pytest
from support.cli import altd_here, refusal

from altd.credentials.file import load_credentials


def test_a_password_is_read_and_kept_as_a_hash(tmp_path: Path) -> None:
    path = tmp_path / "credentials"
    outcome = altd_here("password", path, "ana", stdin="open sesame\n")
    assert (outcome.status, outcome.out, outcome.err) == (0, f"{path}: ana has a new password\n", "")
    assert load_credentials(path).is_password("ana", "open sesame")
    assert path.stat().st_mode & 0o777 == 0o600
    assert altd_here("password", path, "ana", "--remove").status == 0
    assert load_credentials(path).names == frozenset()


def test_a_token_is_shown_once_and_kept_as_a_hash(tmp_path: Path) -> None:
    path = tmp_path / "credentials"
    token = altd_here("token", path, "press").out.strip()
    assert load_credentials(path).name_of_token(token) == "press"
    other = altd_here("token", path, "press").out.strip()
    assert load_credentials(path).name_of_token(token) is None
    assert load_credentials(path).name_of_token(other) == "press"
    assert altd_here("token", path, "press", "--remove").status == 0
    assert load_credentials(path).names == frozenset()


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("", "must have at least 8 characters"),
        ("short\n", "must have at least 8 characters"),
        ("with\x07bell\n", "all of them printable"),
        ("x" * 1025 + "\n", "must have at most 1024 bytes"),
        ("x" * 5000 + "\n", "must have at most 1024 bytes"),
    ],
)
def test_a_password_that_is_none_changes_nothing(tmp_path: Path, typed: str, said: str) -> None:
    line = refusal(altd_here("password", tmp_path / "credentials", "ana", stdin=typed))
    assert said in line
    assert not (tmp_path / "credentials").exists()


@pytest.mark.parametrize("command", ["password", "token"])
def test_names_and_places_that_cannot_be_are_named(tmp_path: Path, command: str) -> None:
    path = tmp_path / "credentials"
    assert "'Ana' is not a valid name" in refusal(altd_here(command, path, "Ana", stdin="open sesame\n"))
    assert "has none to remove" in refusal(altd_here(command, path, "ana", "--remove"))
    missing = tmp_path / "nowhere" / "credentials"
    assert str(missing) in refusal(altd_here(command, missing, "ana", stdin="open sesame\n"))


def test_at_a_terminal_it_asks_twice_and_shows_nothing(tmp_path: Path) -> None:
    path = tmp_path / "credentials"
    assert "the passwords differ" in typed_at_terminal(path, b"open sesame", b"open sesamy")
    assert not path.exists()
    said = typed_at_terminal(path, b"open sesame", b"open sesame")
    assert "sesame" not in said
    assert load_credentials(path).is_password("ana", "open sesame")


def typed_at_terminal(path: Path, *answers: bytes) -> str:
    """The terminal's text while a person answers each prompt."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-m", "altd.cli", "password", str(path), "ana"])
    shown, left, deadline = b"", list(answers), time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            shown += os.read(terminal, 1024)
        except OSError:  # it has ended
            break
        if left and shown.count(b": ") > len(answers) - len(left):
            os.write(terminal, left.pop(0) + b"\n")
    os.waitpid(pid, 0)
    os.close(terminal)
    return shown.decode()


def test_the_password_is_no_argument(tmp_path: Path) -> None:
    line = refusal(altd_here("password", tmp_path / "credentials", "ana", "open sesame"))
    assert "is unexpected; usage" in line
