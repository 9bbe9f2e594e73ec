"""Private parts of libraries that altd uses: a new minor version without one fails here by its name."""

import inspect
import re
import tomllib
from typing import Any

import aiomqtt
import pytest
from asyncua.server import Server
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.uaprocessor import UaProcessor
from paho.mqtt.client import Client as PahoClient
from support.places import ROOT
from uvicorn.protocols.http.h11_impl import H11Protocol

from altd.publish.http.server import _BoundedProtocol
from altd.publish.mqtt.broker import Broker

PINNED = ("aiomqtt", "paho-mqtt", "uvicorn", "asyncua")
"""Libraries whose parts are used."""


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(Broker, aiomqtt.Client), (_BoundedProtocol, H11Protocol)],
    ids=["aiomqtt", "uvicorn"],
)
def test_each_method_that_is_replaced_exists_with_these_arguments(ours: type, theirs: type) -> None:
    replaced = [
        name
        for name, made in vars(ours).items()
        if inspect.isfunction(made) and name in dir(theirs) and not name.startswith("__")
    ]
    assert replaced
    for name in replaced:
        ours_, theirs_ = (list(inspect.signature(getattr(of, name)).parameters) for of in (ours, theirs))
        assert ours_ == theirs_, name


async def test_each_private_attribute_exists() -> None:
    client = aiomqtt.Client("localhost")
    for name in ("_client", "_connected", "_disconnected", "_loop", "_misc_loop", "_client_connect"):
        assert hasattr(client, name), f"aiomqtt.Client.{name}"
    paho: Any = client._client  # noqa: SLF001
    assert isinstance(paho, PahoClient)
    for name in ("_send_pingreq", "_in_messages", "_ping_t"):
        assert hasattr(paho, name), f"paho.mqtt.client.Client.{name}"


@pytest.mark.parametrize(
    ("of", "name"),
    [
        (OPCUAProtocol, "_buffer"),
        (UaProcessor, "_connection"),
        (Server, "_setup_server_nodes"),
        (Server, "_policies"),
        (InternalSubscription, "_not_acknowledged_results"),
        (H11Protocol, "_should_upgrade_to_ws"),
    ],
)
def test_each_private_part_of_a_class_exists(of: type, name: str) -> None:
    assert hasattr(of, name) or f"self.{name}" in inspect.getsource(of)


def test_libraries_whose_parts_are_used_are_pinned_to_a_tested_minor() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = project["dependencies"] + [
        each for of in project["optional-dependencies"].values() for each in of
    ]
    bounds = {name: bound for each in asked for name, bound in re.findall(r"^([\w-]+)\S*<([\d.]+)", each)}
    for name in PINNED:
        assert "." in bounds[name], f"{name} below {bounds[name]}"
