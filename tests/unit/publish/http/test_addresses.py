"""Which addresses may connect, and by which names the unit is asked."""

from __future__ import annotations

import pytest

from altd.publish.http.clients import Allowed, OwnNames


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("10.1.2.3", True),
        ("::ffff:10.1.2.3", True),
        ("11.0.0.1", False),
        ("::ffff:11.0.0.1", False),
        ("192.168.7.9", True),
        ("192.168.7.10", False),
        ("fd00::17", True),
        ("fe80::1%eth0", False),
        ("2001:db8::1", False),
        ("::10.1.2.3", False),
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("::ffff:127.0.0.1", True),
        ("", False),
        ("unit.local", False),
    ],
)
def test_who_may_connect(host: str, expected: bool) -> None:
    assert (host in Allowed(["10.0.0.0/8", "192.168.7.9", "fd00::/8"])) is expected


@pytest.mark.parametrize("host", ["8.8.8.8", "fe80::1%eth0", "::1"])
def test_without_networks_everybody_may(host: str) -> None:
    assert host in Allowed([])


def test_a_wide_network_of_one_kind_lets_in_none_of_the_other() -> None:
    assert "::1:2" not in Allowed(["0.0.0.0/0"])
    assert "8.8.8.8" not in Allowed(["::/0"])
    assert "8.8.8.8" in Allowed(["0.0.0.0/0"])


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("192.0.2.7", True),
        ("192.0.2.7:8080", True),
        ("[2001:db8::7]:8080", True),
        ("localhost:8080", True),
        ("Unit-7:8080", True),
        ("unit-7.local", True),
        ("unit-7.plant.example.:8080", True),
        ("ALT.plant", True),
        ("", True),
        ("evil.example", False),
        ("unit-7.evil.example", False),
        ("localhost.evil.example", False),
        ("192.0.2.7.evil.example", False),
        ("[evil.example]", False),
    ],
)
def test_the_unit_is_asked_by_its_own_names(
    monkeypatch: pytest.MonkeyPatch, header: str, expected: bool
) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "unit-7.plant.example")
    assert (header in OwnNames(["alt.plant"])) is expected
