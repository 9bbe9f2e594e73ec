"""Parts of libraries that altd replaces and reads: a new release that lacks one fails here, by name."""

import inspect
import re
import tomllib
from importlib.metadata import version

import aiomqtt
import pytest
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.uaprocessor import UaProcessor
from packaging.requirements import Requirement
from paho.mqtt.client import Client as PahoClient
from support.places import ROOT

from altd.publish.http.pictures import BoundedWebSocket
from altd.publish.http.server import _BoundedProtocol
from altd.publish.mqtt.broker import Broker
from altd.publish.opcua.server import LimitedServer, OpcUaServer, _Connection, _Limits
from altd.publish.opcua.sessions import Session

LIBRARIES = ("aiomqtt", "asyncua", "uvicorn")
OF_AIOMQTT = {
    *("_client", "_client_connect", "_connected", "_disconnected", "_loop", "_misc_loop", "_misc_task"),
    *("_on_connect", "_on_disconnect", "_on_message", "_on_publish", "_on_socket_close", "_on_socket_open"),
    *("_on_socket_register_write", "_on_socket_unregister_write"),
}


def private_names(*kinds: type) -> set[str]:
    """Methods and attributes of classes whose names begin with one underscore."""
    text = "".join(inspect.getsource(kind) for kind in kinds)
    return set(re.findall(r"(?:\bself\.|\bdef |^    )(_[a-z]\w*)", text, re.MULTILINE))


@pytest.mark.parametrize(
    ("kind", "private", "own"),
    [
        (_BoundedProtocol, {"_should_upgrade_to_ws"}, set()),
        (BoundedWebSocket, set(), set()),
        (_Connection, {"_buffer"}, {"abort", "heard_s"}),
        (_Limits, set(), set()),
        (LimitedServer, set(), {"refuse"}),
        (OpcUaServer, {"_policies", "_setup_server_nodes"}, {"close_idle"}),
        (Session, set(), {"items", "is_left"}),
        (Broker, OF_AIOMQTT, {"lost", "own_address", "send", "subscribe_to"}),
    ],
)
def test_a_class_replaces_what_its_library_has_and_shares_no_other_private_name(
    kind: type, private: set[str], own: set[str]
) -> None:
    """A method that a library has renamed would not be called; a new private name would clash with ours."""
    bases = [base for base in kind.__mro__[1:] if base.__module__.split(".")[0] in LIBRARIES]
    assert private_names(kind) & private_names(*bases) == private
    inherited = {name for base in kind.__mro__[1:] for name in vars(base)}
    public = {name for name in vars(kind) if not name.startswith("_")}
    assert public - inherited == own


def test_what_altd_reads_in_other_objects_of_a_library_is_there() -> None:
    lines = [line for path in (ROOT / "altd").rglob("*.py") for line in path.read_text().splitlines()]
    assert not [line for line in lines if re.match(r"\s*(?:from|import) (?!altd)\S*\._[a-z]", line)]
    marked = [line for line in lines if "SLF001" in line]
    read = {re.findall(r"\.(_\w+)", line.partition("#")[0])[-1] for line in marked}
    assert read == {"_connection", "_not_acknowledged_results", "_in_messages", "_ping_t", "_send_pingreq"}
    assert "_connection" in private_names(UaProcessor)
    assert "_not_acknowledged_results" in private_names(InternalSubscription)
    assert {"_in_messages", "_ping_t", "_send_pingreq"} <= private_names(PahoClient)


def test_a_replaced_callback_of_aiomqtt_has_its_arguments() -> None:
    for name in sorted(OF_AIOMQTT & vars(Broker).keys()):
        theirs = inspect.signature(getattr(aiomqtt.Client, name)).parameters
        assert list(inspect.signature(getattr(Broker, name)).parameters) == list(theirs), name


@pytest.mark.parametrize("name", [*LIBRARIES, "paho-mqtt"])
def test_only_the_tested_minor_of_such_a_library_is_accepted(name: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [*project["dependencies"], *project["optional-dependencies"]["opcua"]]
    (range_,) = (one.specifier for one in map(Requirement, lines) if one.name == name)
    major, minor, *_ = map(int, version(name).split("."))
    assert version(name) in range_
    assert f"{major}.{minor - 1}.99" not in range_
    assert f"{major}.{minor + 1}.0" not in range_
