"""Addresses of TCP clients: which of them count as one, and which lie in networks of the settings."""

from __future__ import annotations

import pytest

from altd.tcp_port import Networks, address_of, group_of


@pytest.mark.parametrize(
    ("host", "group"),
    [
        ("192.168.1.10", "192.168.1.10"),
        ("::ffff:10.0.0.1", "10.0.0.1"),
        ("2001:db8::1", "2001:db8::/64"),
        ("2001:db8::ffff:1", "2001:db8::/64"),
        ("2001:db8:0:1::1", "2001:db8:0:1::/64"),
        ("fe80::1%eth0", "fe80::/64"),
    ],
)
def test_a_host_with_a_network_of_its_own_counts_once(host: str, group: str) -> None:
    address = address_of(host)
    assert address is not None
    assert group_of(address) == group


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("192.168.1.10", True),
        ("::ffff:192.168.1.10", True),
        ("192.168.1.11", False),
        ("fd00::7", True),
        ("127.0.0.1", False),
        ("unit", False),
    ],
)
def test_networks_hold_their_addresses_and_nothing_else(host: str, expected: bool) -> None:
    assert (address_of(host) in Networks(["192.168.1.10", "fd00::/8"])) is expected
