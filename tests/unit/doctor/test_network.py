"""The way to a GigE Vision camera and the addresses to listen on: on a tree, and on this kernel."""

import os
import socket
from typing import Any

import pytest
from support.ports import free_port

from altd.config import Config
from altd.devices.aravis import gvcp
from altd.devices.aravis.gvcp import DiscoveredCamera
from altd.doctor import network
from altd.process.machine import Account, Finding, Machine, Verdict

from .conftest import Tree, configured, driver_findings, says

ROUTES = "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n"


@pytest.fixture
def computer(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> Tree:
    """A computer with one good network interface for a camera at 192.168.77.x, and one to the world."""
    tree.write(
        "/proc/net/route",
        ROUTES
        + "eth0 00000000 0100000A 0003 0 0 0 00000000 0 0 0\n"
        + "eth1 004DA8C0 00000000 0001 0 0 0 00FFFFFF 0 0 0",
    )
    interface(tree, "eth0")
    interface(tree, "eth1")
    monkeypatch.setattr(gvcp, "discover_at", lambda address, _: camera(address))
    monkeypatch.setattr(gvcp, "discover", lambda _: [camera(name="Maker-1234")])
    monkeypatch.setattr(gvcp, "control_privilege", lambda *_: 0)
    tree.write("/proc/sys/net/core/rmem_max", 4194304)
    tree.write("/proc/sys/net/ipv4/conf/all/rp_filter", 1)
    return tree


def interface(tree: Tree, name: str, speed: object = 1000, mtu: int = 9000, state: str = "up") -> None:
    for key, value in (("speed", speed), ("mtu", mtu), ("operstate", state), ("device/vendor", "0x8086")):
        tree.write(f"/sys/class/net/{name}/{key}", value)


def gige(device: str = "192.168.77.20", **fields: object) -> Config:
    camera = {"driver": "aravis", "device": device, **fields}
    return configured(cameras={"front": camera, "rear": camera})


def camera(address: str = "192.168.77.20", name: str = "") -> DiscoveredCamera:
    return DiscoveredCamera(address, "Maker", "M1", "1234", name)


def found(config: Config, tree: Tree) -> list[Finding]:
    return list(dict.fromkeys(driver_findings(config, tree)))


def test_a_good_network(computer: Tree) -> None:
    findings = driver_findings(gige(), computer)
    assert {finding.verdict for finding in findings} == {Verdict.GOOD}


def test_a_camera_that_is_off_is_wrong(computer: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    elsewhere = f"127.98.{os.getpid() % 250}.{os.getpid() // 250 % 250 + 1}"
    findings = found(gige(elsewhere), computer)
    wrong = [finding for finding in findings if finding.verdict is Verdict.ERROR]
    assert [(finding.subject, finding.text) for finding in wrong] == [
        (f"camera {name} {elsewhere}", "no GigE Vision camera answers") for name in ("front", "rear")
    ]
    assert "altd devices" in wrong[0].remedy


@pytest.mark.parametrize(
    ("device", "there", "privilege", "process", "verdict", "words"),
    [
        ("192.168.77.20", [camera()], 0, "", Verdict.GOOD, "Maker M1 at 192.168.77.20 answers"),
        ("front-eye", [camera(name="front-eye")], 0, "", Verdict.GOOD, "answers"),
        ("192.168.77.20", [camera()], 2, "/opt/altd/bin/altd\0run\0", Verdict.GOOD, "in use by altd"),
        ("192.168.77.20", [camera()], 2, "/opt/altd/bin/altd\0doctor\0", Verdict.ERROR, "another program"),
        ("192.168.77.20", [camera()], 2, "/usr/bin/arv-viewer\0", Verdict.ERROR, "another program"),
        ("192.168.77.20", [camera()], None, "", Verdict.ERROR, "registers cannot be read"),
        ("192.168.77.20", [], 0, "", Verdict.ERROR, "no GigE Vision camera answers"),
        ("front-eye", [camera(name="other")], 0, "", Verdict.ERROR, "no GigE Vision camera answers"),
        ("eye", [camera(name="eye"), camera("10.1.2.3", "eye")], 0, "", Verdict.ERROR, "2 cameras have this"),
    ],
)
def test_what_a_camera_itself_says(
    computer: Tree,
    monkeypatch: pytest.MonkeyPatch,
    device: str,
    there: list[DiscoveredCamera],
    privilege: int | None,
    process: str,
    verdict: Verdict,
    words: str,
) -> None:
    monkeypatch.setattr(gvcp, "discover_at", lambda *_: there[0] if there else None)
    monkeypatch.setattr(gvcp, "discover", lambda _: there)
    monkeypatch.setattr(gvcp, "control_privilege", lambda *_: privilege)
    computer.write("/proc/77/cmdline", process)
    findings = [one for one in found(gige(device), computer) if one.subject.startswith("camera front")]
    assert says(findings[-1:], verdict, words)


@pytest.mark.parametrize(
    ("link", "said", "remedy"),
    [
        ({"speed": 100}, "runs at 100 Mbit/s", "ethtool"),
        ({"state": "down"}, "is down", "ip link set eth1 up"),
    ],
)
def test_a_link_that_is_slow_or_down(computer: Tree, link: dict[str, Any], said: str, remedy: str) -> None:
    interface(computer, "eth1", **link)
    assert remedy in says(found(gige(), computer), Verdict.ERROR, said).remedy


def test_packets_that_do_not_fit(computer: Tree) -> None:
    interface(computer, "eth1", mtu=1500)
    assert "mtu 9000" in says(found(gige(), computer), Verdict.WARNING, "its MTU is 1500").remedy
    findings = found(gige(packet_bytes=8000), computer)
    assert says(findings, Verdict.ERROR, "its MTU is 1500 but packet_bytes 8000")


def test_a_small_receive_buffer(computer: Tree) -> None:
    computer.write("/proc/sys/net/core/rmem_max", 212992)
    finding = says(found(gige(), computer), Verdict.WARNING, "is 212992 bytes at most")
    assert "sysctl" in finding.remedy


@pytest.mark.parametrize(("of_all", "of_eth0", "is_well"), [(1, 0, True), (0, 0, False), (1, 2, False)])
def test_a_camera_s_name_in_another_network(computer: Tree, of_all: int, of_eth0: int, is_well: bool) -> None:
    """The kernel takes the larger of the two settings; 2 is loose: any interface will do."""
    computer.write("/proc/sys/net/ipv4/conf/all/rp_filter", of_all)
    computer.write("/proc/sys/net/ipv4/conf/eth0/rp_filter", of_eth0)
    computer.write("/proc/sys/net/ipv4/conf/eth1/rp_filter", 1)
    (finding,) = (one for one in found(gige(), computer) if one.subject == "network source check")
    assert finding.verdict is (Verdict.GOOD if is_well else Verdict.WARNING)
    assert ("net.ipv4.conf.eth0.rp_filter=1" in finding.remedy) != is_well


def test_a_camera_in_a_network_of_nobodys(computer: Tree) -> None:
    finding = says(found(gige("169.254.3.4"), computer)[:1], Verdict.ERROR, "to the gateway at eth0")
    assert "ip address add 169.254.3.1/24" in finding.remedy
    computer.write("/proc/net/route", ROUTES)
    assert says(found(gige(), computer)[:1], Verdict.ERROR, "no route to it")


@pytest.mark.parametrize(("rp_filter", "drops"), [(1, True), (2, False), (0, False)])
def test_two_interfaces_with_the_same_network(computer: Tree, rp_filter: int, drops: bool) -> None:
    interface(computer, "eth2")
    routes = computer.root / "proc/net/route"
    routes.write_text(routes.read_text() + "eth2 004DA8C0 00000000 0001 0 0 5 00FFFFFF 0 0 0\n")
    computer.write("/proc/sys/net/ipv4/conf/all/rp_filter", 0)
    computer.write("/proc/sys/net/ipv4/conf/eth2/rp_filter", rp_filter)
    finding = says(found(gige(), computer)[:1], Verdict.ERROR, "eth1 and eth2 have the same network")
    assert ("rp_filter" in finding.text) == drops


def test_a_camera_by_its_serial_number_may_be_on_any_interface(computer: Tree) -> None:
    interface(computer, "eth1", speed=100)
    assert says(found(gige("Maker-1234"), computer), Verdict.ERROR, "runs at 100").subject == "network eth1"
    for name in ("eth0", "eth1"):
        interface(computer, name, state="down")
    assert says(found(gige("Maker-1234"), computer)[:1], Verdict.ERROR, "no network interface is up")


class TestListening:
    def findings(self, port: int, machine: Machine, host: str = "127.0.0.1") -> list[Finding]:
        return list(network.listening(configured(http={"host": host, "port": port}), machine))

    def test_a_unit_that_is_open_is_advised_and_not_at_fault(self) -> None:
        def said(**http: object) -> list[Finding]:
            settings = {"host": "0.0.0.0", "port": 0, **http}
            return list(network.listening(configured(http=settings), Machine()))

        known, tls = {"credentials": "c"}, {"certificate": "c.pem", "key": "c.key"}
        (finding,) = said()
        assert finding.verdict is Verdict.WARNING
        assert "(no allow, no credentials, no TLS)" in finding.text
        assert "(no allow, no TLS)" in said(**known)[0].text
        assert "unencrypted, without TLS" in said(allow=["10.0.0.0/8"], **known)[0].text
        assert said(allow=["10.0.0.0/8"]) == said(allow=["10.0.0.0/8"], **known, **tls) == []
        for own in ("127.0.0.1", "localhost", "::1"):
            assert said(host=own) == []

    @pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "::", "localhost"])
    def test_an_address_that_another_program_listens_on(self, host: str) -> None:
        port = free_port()
        with socket.create_server(("127.0.0.1", port)):
            finding = says(self.findings(port, Machine(), host), Verdict.ERROR, "listens there")
            assert f"(process {os.getpid()})" in finding.text
            assert f":{port}" in finding.remedy
        assert says(self.findings(port, Machine(), host), Verdict.GOOD, "is free")

    def test_the_address_of_opc_ua_is_looked_at(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            settings = {"host": "127.0.0.1", "port": server.getsockname()[1]}
            (finding,) = network.listening(configured(opcua=settings), Machine())
        assert says([finding], Verdict.ERROR, "listens there").subject.startswith("opcua")

    def test_the_same_port_of_another_address_is_free(self) -> None:
        port = free_port()
        with socket.create_server(("127.0.0.2", port)):
            assert says(self.findings(port, Machine()), Verdict.GOOD, "is free")

    def test_a_program_that_may_not_be_seen(self, tree: Tree) -> None:
        tree.write("/proc/net/tcp", "head\n0: 00000000:1F90 00000000:0000 0A 0:0 0:0 0 0 0 777 1")
        assert says(self.findings(8080, tree.machine), Verdict.WARNING, "altd itself?")

    @pytest.mark.parametrize("line", ["python\0/opt/altd/bin/altd\0run", "python\0-m\0altd.publish.opcua"])
    def test_altd_itself_may_listen(self, tree: Tree, line: str) -> None:
        tree.write("/proc/net/tcp", "head\n0: 00000000:1F90 00000000:0000 0A 0:0 0:0 0 0 0 777 1")
        tree.link("/proc/123/fd/5", "socket:[777]")
        tree.write("/proc/123/cmdline", line)
        assert says(self.findings(8080, tree.machine), Verdict.GOOD, "altd listens there (process 123)")

    def test_a_low_port_and_a_user_who_may_not(self, tree: Tree) -> None:
        tree.write("/proc/sys/net/ipv4/ip_unprivileged_port_start", 1024)
        words = "somebody may not listen on a port below 1024"
        assert says(self.findings(502, tree.machine), Verdict.ERROR, words)
        tree.account = Account("root", 0, frozenset())
        assert says(self.findings(502, tree.machine), Verdict.GOOD, "is free")
        tree.write("/etc/systemd/system/altd.service", "[Service]\nUser=altd")
        words = "the service may not listen on a port below 1024"
        found = says(self.findings(502, tree.machine), Verdict.ERROR, words)
        assert "ip_unprivileged_port_start=502" in found.remedy
        tree.write("/proc/sys/net/ipv4/ip_unprivileged_port_start", 502)
        assert says(self.findings(502, tree.machine), Verdict.GOOD, "is free")
        tree.write("/proc/sys/net/ipv4/ip_unprivileged_port_start", 1024)
        tree.write("/etc/systemd/system/altd.service", "[Service]\nAmbientCapabilities=CAP_NET_BIND_SERVICE")
        assert says(self.findings(502, tree.machine), Verdict.GOOD, "is free")

    def test_an_address_that_no_interface_has(self) -> None:
        """192.0.2.1 is for books (RFC 5737) and 2001:db8::1 too (RFC 3849); this kernel says what it has."""
        for host in ("192.0.2.1", "2001:db8::1"):
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            with pytest.raises(OSError, match="assign"):
                socket.create_server((host, 0), family=family)
            finding = says(self.findings(8080, Machine(), host), Verdict.ERROR, "no interface of this")
            assert finding.remedy.startswith("ip -brief address")

    def test_addresses_that_it_has(self, tree: Tree) -> None:
        trie = "Local:\n  |-- 10.0.0.0\n  /24 link UNICAST\n  |-- 10.0.0.7\n  /32 host LOCAL"
        tree.write("/proc/net/fib_trie", trie)
        tree.write("/proc/net/if_inet6", "fe80000000000000020000fffe000001 02 40 20 80 eth0")
        for host in ("10.0.0.7", "fe80::200:ff:fe00:1%eth0", "127.0.0.5", "localhost", "0.0.0.0", "::"):
            assert says(self.findings(8080, tree.machine, host), Verdict.GOOD, "is free")
        for host in ("10.0.0.8", "10.0.0.0", "fe80::2%eth0"):
            words = "it has 10.0.0.7, fe80::200:ff:fe00:1"
            assert says(self.findings(8080, tree.machine, host), Verdict.ERROR, words)


def test_a_broker_is_reached_or_not() -> None:
    assert list(network.broker(configured())) == []
    with socket.create_server(("127.0.0.1", 0)) as server:
        config = configured(mqtt={"host": "127.0.0.1", "port": server.getsockname()[1]})
        assert says(list(network.broker(config)), Verdict.GOOD, "accepts connections")
    says(list(network.broker(config)), Verdict.ERROR, "cannot be reached: Connection refused")
    config = configured(mqtt={"host": "broker.invalid"})
    finding = says(list(network.broker(config)), Verdict.ERROR, "cannot be reached: ")
    assert finding.subject == "mqtt broker.invalid:1883"
