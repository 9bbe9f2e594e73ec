"""The file of credentials: what it may hold, who may read it, that it never shows it; its hashes."""

import contextlib
import hashlib
import os
import re
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from altd.credentials.file import (
    MAX_ENTRIES,
    Credentials,
    CredentialsKeeper,
    change,
    load_credentials,
    save_credentials,
)
from altd.credentials.hashes import SCRYPT_N, SCRYPT_P, SCRYPT_R, PasswordHash, new_token, token_digest
from altd.errors import BadInputError

HASH = PasswordHash(2, 1, 1, bytes(16), PasswordHash(2, 1, 1, bytes(16), bytes(32)).hashed("open sesame"))
TOKEN = new_token()
KNOWN = Credentials({"ana": HASH}, {"press": token_digest(TOKEN)})
GOOD = f"password ana scrypt 2 1 1 {'00' * 16} {HASH.digest.hex()}\ntoken press sha256 {'ab' * 32}\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "credentials"


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_what_was_saved_is_read_again_and_holds_no_secret(path: Path) -> None:
    save_credentials(path, KNOWN)
    path.chmod(0o640)
    assert load_credentials(path) == KNOWN
    assert TOKEN not in path.read_text()
    assert "sesame" not in path.read_text()


def test_who_fits() -> None:
    assert KNOWN.is_password("ana", "open sesame")
    assert not KNOWN.is_password("ana", "open sesam")
    assert not KNOWN.is_password("bob", "open sesame")
    assert not KNOWN.is_password("press", TOKEN)
    assert KNOWN.name_of_token(TOKEN) == "press"
    assert KNOWN.name_of_token(TOKEN[:-1]) is None
    assert KNOWN.name_of_token("") is None
    assert KNOWN.names == {"ana", "press"}


def test_a_name_that_is_none_takes_the_same_work(monkeypatch: pytest.MonkeyPatch) -> None:
    strengths: list[tuple[int, int, int]] = []
    hashed = PasswordHash.hashed

    def noted(self: PasswordHash, password: str) -> bytes:
        strengths.append((self.n, self.r, self.p))
        return hashed(self, password)

    known = Credentials({"ana": PasswordHash.of("open sesame")})
    monkeypatch.setattr(PasswordHash, "hashed", noted)
    known.is_password("ana", "open sesame")
    known.is_password("nobody", "open sesame")
    assert len(strengths) == 2
    assert strengths[0] == strengths[1]


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o602, 0o660, 0o601, 0o620, 0o777])
def test_a_file_that_others_may_read_or_write_is_refused(path: Path, mode: int) -> None:
    with pytest.raises(BadInputError, match=rf"mode {mode:04o}\): chmod 640"):
        load_credentials(written(path, GOOD, mode))


@pytest.mark.parametrize(
    "line",
    [
        "ana:geheim",
        "password ana geheim",
        f"password Ana scrypt 2 1 1 {'00' * 16} {'00' * 32}",
        f"password ana scrypt 1099511627776 8 1 {'00' * 16} {'00' * 32}",
        f"password ana scrypt 1048576 32 16 {'00' * 16} {'00' * 32}",
        f"password ana scrypt -2 1 1 {'00' * 16} {'00' * 32}",
        f"password ana scrypt 2 1 1 {'00' * 16} {'00' * 31}",
        f"password ana scrypt 2 1 1 {'0g' * 16} {'00' * 32}",
        f"password ana scrypt 2 1 1 {'00' * 16} {'00' * 32} more",
        "token press sha256 abcd",
        f"token {'x' * 33} sha256 {'ab' * 32}",
        f"token press md5 {'ab' * 32}",
        "password ana scrypt",
    ],
)
def test_a_line_that_is_none_is_named_and_not_shown(path: Path, line: str) -> None:
    with pytest.raises(BadInputError, match="line 2: ") as caught:
        load_credentials(written(path, f"# ours\n{line}\n"))
    assert "geheim" not in str(caught.value)
    assert "abcd" not in str(caught.value)


def test_a_name_twice_is_refused(path: Path) -> None:
    for line in GOOD.splitlines():
        with pytest.raises(BadInputError, match=r"line 2: .* already"):
            load_credentials(written(path, f"{line}\n{line}\n"))


def test_there_are_only_so_many_and_the_file_is_only_so_long(path: Path) -> None:
    many = "".join(f"token n{number} sha256 {'ab' * 32}\n" for number in range(MAX_ENTRIES + 1))
    with pytest.raises(BadInputError, match="more than 64"):
        load_credentials(written(path, many))
    with pytest.raises(BadInputError, match="bytes long"):
        load_credentials(written(path, "#" * 1_000_000))
    full = Credentials({}, {f"n{number}": bytes(32) for number in range(MAX_ENTRIES + 1)})
    with pytest.raises(BadInputError, match="entries already"):
        save_credentials(path, full)


@given(st.binary(max_size=200) | st.text(max_size=100).map(str.encode))
@settings(max_examples=200)
def test_no_bytes_make_false_credentials(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any"
    path.write_bytes(content)
    path.chmod(0o600)
    with contextlib.suppress(BadInputError):
        assert load_credentials(path).names == frozenset()


def test_a_pipe_or_a_folder_is_refused_and_not_waited_for(path: Path) -> None:
    os.mkfifo(path, 0o600)
    with pytest.raises(BadInputError, match="is a pipe"):
        load_credentials(path)


def test_a_new_file_is_for_its_owner_alone_and_an_old_one_keeps_its_mode(path: Path) -> None:
    before = os.umask(0)
    try:
        change(path, "ana", lambda known: known.with_password("ana", HASH))
        assert path.stat().st_mode & 0o777 == 0o600
        path.chmod(0o640)
        change(path, "press", lambda known: known.with_token("press", token_digest(TOKEN)))
    finally:
        assert os.umask(before) == 0
    assert path.stat().st_mode & 0o777 == 0o640
    assert load_credentials(path) == KNOWN


def test_what_is_not_there_cannot_be_removed(path: Path) -> None:
    save_credentials(path, KNOWN)
    path.chmod(0o600)
    content = path.read_bytes()
    with pytest.raises(BadInputError, match="bob has none to remove"):
        change(path, "bob", lambda known: known.with_password("bob", None))
    with pytest.raises(BadInputError, match=re.escape("'Bob!' is not a valid name")):
        change(path, "Bob!", lambda known: known.with_password("Bob!", HASH))
    assert path.read_bytes() == content


def test_who_is_taken_out_of_the_file_may_act_no_more(path: Path) -> None:
    said: list[str] = []
    keeper = CredentialsKeeper(written(path, GOOD), said.append)
    assert keeper.current().names == {"ana", "press"}
    change(path, "ana", lambda known: known.with_password("ana", None))
    assert keeper.current().names == {"press"}
    written(path, "nonsense\n")
    assert keeper.current().names == frozenset()
    path.unlink()
    assert keeper.current().names == frozenset()
    assert [text.rpartition(": ")[2] for text in said[:1]] == [""]
    assert "line 1" in said[1]
    assert said[2].endswith(f"No such file or directory; `altd password {path} NAME` makes it")
    written(path, GOOD)
    assert keeper.current().names == {"ana", "press"}
    path.chmod(0o644)
    assert keeper.current().names == frozenset()


def quick(password: str) -> PasswordHash:
    blank = PasswordHash(2, 1, 1, bytes(16), bytes(32))
    return PasswordHash(2, 1, 1, bytes(16), blank.hashed(password))


def test_a_password_is_hashed_as_rfc_7914_does() -> None:
    """Section 12: scrypt (P="pleaseletmein", S="SodiumChloride", N=16384, r=8, p=1), its first 32 bytes."""
    expected = bytes.fromhex("7023bdcb3afd7348461c06cd81fd38ebfda8fbba904f8e3ea9b543f6545da1f2")
    digest = hashlib.scrypt(b"pleaseletmein", salt=b"SodiumChloride", n=16384, r=8, p=1, dklen=32)
    assert digest == expected  # the library that ours is made of
    salt = b"SodiumChloride" + bytes(2)
    ours = PasswordHash(16384, 8, 1, salt, bytes(32)).hashed("pleaseletmein")
    assert ours == hashlib.scrypt(b"pleaseletmein", salt=salt, n=16384, r=8, p=1, dklen=32)


def test_a_new_hash_has_a_salt_of_its_own_and_the_strength_that_is_promised() -> None:
    one, other = PasswordHash.of("Gewächshaus 7"), PasswordHash.of("Gewächshaus 7")
    assert one.salt != other.salt
    assert one.digest != other.digest
    assert (one.n, one.r, one.p) == (SCRYPT_N, SCRYPT_R, SCRYPT_P)
    assert one.n * one.r * one.p >= 16384 * 8 * 5  # OWASP's least for 16 MB
    assert one.fits("Gewächshaus 7")
    assert not one.fits("Gewächshaus 8")


@given(st.text(st.characters(exclude_characters="\0"), max_size=30), st.text(max_size=30))
@example("", "\0")
@example("open sesame", "open sesame\0\0")
@settings(max_examples=50)
def test_only_the_same_password_fits(one: str, other: str) -> None:
    assert quick(one).fits(other) == (one == other)


@pytest.mark.parametrize(
    ("n", "r", "p", "salt", "digest"),
    [
        (0, 8, 1, 16, 32),
        (3, 8, 1, 16, 32),
        (1 << 30, 8, 1, 16, 32),
        (1 << 14, 0, 1, 16, 32),
        (1 << 14, 8, 0, 16, 32),
        (1 << 14, 8, 1 << 20, 16, 32),
        (1 << 14, 8, 1, 8, 32),
        (1 << 14, 8, 1, 16, 0),
    ],
)
def test_parameters_beyond_the_computer_are_refused(n: int, r: int, p: int, salt: int, digest: int) -> None:
    with pytest.raises(ValueError, match="its "):
        PasswordHash(n, r, p, bytes(salt), bytes(digest))


def test_tokens_are_256_bits_that_differ() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert all(re.fullmatch(r"[A-Za-z0-9_-]{43}", token) for token in tokens)
    assert len({token_digest(token) for token in tokens}) == 100
