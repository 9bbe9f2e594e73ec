"""Hashes of passwords and tokens, and comparisons with them in constant time.

A password, which people choose, is hashed slowly and with a salt: scrypt (RFC 7914). A token is 256 random
bits and cannot be guessed: one SHA-256 is enough, and costs no time with every request.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from typing import Self

SCRYPT_N, SCRYPT_R, SCRYPT_P = 1 << 14, 8, 5
"""Cost: 16 MB and about 0.2 s on a small computer; as strong as OWASP's 2¹⁷, 8, 1, which takes 128 MB."""

MAX_PASSWORD_BYTES = 1024
MIN_PASSWORD_CHARACTERS = 8

_MAX_BYTES = 64 << 20
_SALT_BYTES = range(16, 65)
_HASH_BYTES = 32
_TOKEN_BYTES = 32


@dataclass(frozen=True, slots=True)
class PasswordHash:
    """The stored hash of a password. Raises ValueError for parameters outside sensible limits."""

    n: int
    r: int
    p: int
    salt: bytes
    digest: bytes

    def __post_init__(self) -> None:
        sane = self.n > 1 and self.n & (self.n - 1) == 0 and 1 <= self.r <= 32 and 1 <= self.p <= 16
        if not sane or self._memory_bytes() > _MAX_BYTES:
            raise ValueError("its scrypt parameters are not possible")
        if len(self.salt) not in _SALT_BYTES or len(self.digest) != _HASH_BYTES:
            raise ValueError("its salt or hash has a wrong length")

    @classmethod
    def of(cls, password: str) -> Self:
        """Hash a new password, with its own salt."""
        salt = secrets.token_bytes(_SALT_BYTES[0])
        blank = cls(SCRYPT_N, SCRYPT_R, SCRYPT_P, salt, bytes(_HASH_BYTES))
        return cls(SCRYPT_N, SCRYPT_R, SCRYPT_P, salt, blank.hashed(password))

    def fits(self, password: str) -> bool:
        """Whether it is that password. Takes equally long for all passwords.

        One with a NUL is refused, as no password has it: scrypt's HMAC pads with NUL (RFC 2104, section 2),
        so a password with NULs at its end has the digest of the one without.
        """
        fits = hmac.compare_digest(self.digest, self.hashed(password))
        return fits and "\0" not in password

    def hashed(self, password: str) -> bytes:
        """Return the digest of a password with these parameters."""
        return hashlib.scrypt(
            password.encode("utf-8", "surrogatepass"),
            salt=self.salt,
            n=self.n,
            r=self.r,
            p=self.p,
            maxmem=2 * self._memory_bytes(),
            dklen=_HASH_BYTES,
        )

    def _memory_bytes(self) -> int:
        return 128 * self.r * (self.n + self.p + 2)


DUMMY_HASH = PasswordHash(SCRYPT_N, SCRYPT_R, SCRYPT_P, secrets.token_bytes(16), secrets.token_bytes(32))
"""Compared with the password of an unknown name, so that it takes as long as a known one."""


def new_token() -> str:
    """Return a new token: 43 characters of A-Z a-z 0-9 - _."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def token_digest(token: str) -> bytes:
    """Return the stored hash of a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).digest()
