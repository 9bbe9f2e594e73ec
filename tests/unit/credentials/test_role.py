"""The role in a certificate, as openssl wrote it."""

import ssl
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.certificates import ROLE, made

from altd.credentials.certificates import role_of

IDENTIFIER = bytes.fromhex("060b2b0601040183890c862201")


def der(folder: Path, *more: str) -> bytes:
    return ssl.PEM_cert_to_DER_cert(made(folder, "client", *more)[0].read_text())


@pytest.mark.parametrize(
    ("extension", "role"),
    [
        (ROLE + "operator", "operator"),
        (ROLE + "operator,engineer", "operator,engineer"),  # "the entire string", R-65
        (ROLE.replace("ASN1:", "ASN1:FORMAT:UTF8,") + "Führer", "Führer"),
        (ROLE.replace("UTF8String", "PRINTABLESTRING") + "operator", None),
        (ROLE.replace("ASN1:UTF8String:", "DER:") + "6f70657261746f72", None),
        (ROLE.replace("802.1", "802.2") + "operator", None),
        ("keyUsage=digitalSignature", None),
    ],
)
def test_the_role_is_the_text_of_its_extension(tmp_path: Path, extension: str, role: str | None) -> None:
    assert role_of(der(tmp_path, "-addext", extension)) == role


def test_a_role_in_the_name_of_a_client_is_none(tmp_path: Path) -> None:
    """A client chooses its name itself; the authority has only looked at it."""
    forged = IDENTIFIER + b"\x04\x0a\x0c\x08operator"
    certificate = der(tmp_path, "-addext", "nsComment=DER:" + "160e" + forged.hex())
    assert forged in certificate
    assert role_of(certificate) is None


@given(st.data())
def test_nothing_that_is_no_certificate_has_a_role_or_does_harm(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    role = role_of(data.draw(st.binary(max_size=60) | st.just(IDENTIFIER) | st.just(b"\x30\x80\xa3")))
    assert role is None
