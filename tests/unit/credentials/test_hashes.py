"""Hashes of passwords against RFC 7914's own, tokens that cannot be guessed."""

from __future__ import annotations

import hashlib
import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from altd.credentials.hashes import SCRYPT_N, SCRYPT_P, SCRYPT_R, PasswordHash, new_token, token_digest


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
def test_parameters_that_would_take_the_computer_are_refused(
    n: int, r: int, p: int, salt: int, digest: int
) -> None:
    with pytest.raises(ValueError, match="its "):
        PasswordHash(n, r, p, bytes(salt), bytes(digest))


def test_tokens_are_256_bits_that_differ() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert all(re.fullmatch(r"[A-Za-z0-9_-]{43}", token) for token in tokens)
    assert len({token_digest(token) for token in tokens}) == 100
