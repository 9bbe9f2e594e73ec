"""The address space: the unit as a device of OPC 10000-100, its quantities as AnalogItems of OPC 10000-8.

Namespace 2 is the unit's, the same for all units; 3 is that of OPC 10000-100.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from datetime import datetime
from typing import Any

from asyncua import ua
from asyncua.server import Server

from altd.publish.opcua.quality import Status
from altd.publish.opcua.start import Range, Start
from altd.publish.opcua.types import (
    DEVICE_HEALTH_ENUMERATION,
    DEVICE_SET,
    HEALTH_MEANING,
    OF_JOINT,
    TYPE,
    VARIABLES,
    VARIANTS,
    TypeNodes,
    is_array,
    unit_of,
)
from altd.records import Quantity

OF_PLACE: Mapping[str, tuple[str, int, str]] = {
    key: (*VARIABLES[key][:2], meaning)
    for key, meaning in (
        ("valid", "whether the spot on the target was measured"),
        ("status", "the codes of reasons and warnings, without the target's name"),
    )
}
"""BrowseName, type and meaning of the corresponding nodes of each target of a row, by key."""


class UnitNodes(TypeNodes):
    """The nodes of a unit; ``write`` sets their values."""

    def __init__(self, server: Server, start: Start) -> None:
        super().__init__(server, start)
        self._types: dict[str, ua.VariantType] = {}

    async def build(self) -> None:
        """Create all nodes; every value waits for initial data."""
        await self.build_types()
        await self._unit()
        quantities = self._start.quantities
        for quantity in quantities.of_unit:
            if not quantity.place:
                await self._analog(quantity, quantity.key, "unit", self._start.ranges.get(quantity.key))
        for target, ranges in self._start.targets.items():
            place = f"targets.{target}"
            await self.add(ua.ObjectAttributes(), place, "unit", target, ua.ObjectIds.BaseObjectType)
            for quantity in quantities.of_target:
                await self._analog(quantity, f"{place}.{quantity.key}", place, ranges.get(quantity.key))
            for quantity in quantities.of_unit:
                if quantity.place == target:
                    await self._analog(quantity, quantity.key, place, None)
            for key, (name, kind, meaning) in OF_PLACE.items() if quantities.has_places else ():
                await self._variable(f"{place}.{key}", place, name, kind, meaning)
        for key, (name, kind, meaning) in VARIABLES.items():
            await self._variable(key, "unit", name, kind, meaning)
        for key, (name, meaning) in OF_JOINT.items() if quantities.joint else ():
            about = meaning.format(", ".join(quantities.joint))
            await self._variable(key, "unit", name, ua.ObjectIds.Double, about)

    @property
    def keys(self) -> Set[str]:
        """Keys of the nodes that ``write`` accepts."""
        return self._types.keys()

    def quantity_of(self, node: ua.NodeId) -> str | None:
        """Key of a quantity in the history, ``TARGET.KEY`` for a target's; None: the node is none."""
        key = str(node.Identifier) if node.NamespaceIndex == self._own else ""
        is_number = self._types.get(key) is ua.VariantType.Double and not is_array(key)
        return (
            key.removeprefix("targets.") if is_number and not key.endswith((".sigma", ".sigma_now")) else None
        )

    async def write(
        self, key: str, value: object, status: Status, source: datetime | None, now: datetime
    ) -> None:
        """Set a value; a Bad one is null. Raises UaError if asyncua refuses it, and so keeps the old one."""
        kind = ua.VariantType.Null if status.is_bad else self._types[key]
        data = ua.DataValue(
            ua.Variant(None if status.is_bad else value, kind, is_array=is_array(key) or None),
            StatusCode=ua.StatusCode(status),
            SourceTimestamp=source,
            ServerTimestamp=now,
        )
        space = self._server.iserver.aspace
        written = await space.write_attribute_value(self.node_id(key), ua.AttributeIds.Value, data)
        written.check()

    async def add_method(self, name: str, meaning: str, call: Any) -> None:
        """Add a method of the unit without arguments."""
        unit = self._server.get_node(self.node_id("unit"))
        method = await unit.add_method(self.node_id(name), ua.QualifiedName(name, self._own), call, [], [])
        await method.write_attribute(
            ua.AttributeIds.Description, ua.DataValue(ua.Variant(ua.LocalizedText(meaning)))
        )

    async def _unit(self) -> None:
        start, di, objects = self._start, self._di, ua.NodeId(ua.ObjectIds.ObjectsFolder)
        own_type = self.node_id(TYPE)
        await self.add(ua.ObjectAttributes(), "unit", objects, start.serial, own_type, ua.ObjectIds.Organizes)
        for source, kind, target in (
            (ua.NodeId(DEVICE_SET, di), ua.ObjectIds.HasComponent, self.node_id("unit")),
            (self.node_id("unit"), ua.ObjectIds.HasInterface, ua.NodeId(15051, di)),
        ):
            await self._server.get_node(source).add_reference(target, kind, forward=True)
        for name, value in (
            ("Manufacturer", ua.LocalizedText("")),
            ("Model", ua.LocalizedText(start.product)),
            ("SerialNumber", start.serial),
            ("SoftwareRevision", start.version),
            ("HardwareRevision", ""),
            ("DeviceRevision", ""),
            ("DeviceManual", ""),
            ("RevisionCounter", ua.Variant(-1, ua.VariantType.Int32)),
        ):
            await self.add_property(self.node_id("unit"), self.node_id(name), name, value, namespace=di)
        for name, value in (
            ("Session", start.session),
            ("CalibrationCreated", str(start.calibration["created"] or "")),
            ("CalibrationChecksum", str(start.calibration["checksum"] or "")),
            ("CalibrationSimulated", bool(start.calibration["simulated"])),
        ):
            await self.add_property(self.node_id("unit"), self.node_id(name), name, value)
        health = ua.NodeId(DEVICE_HEALTH_ENUMERATION, di)
        await self._variable("health", "unit", "DeviceHealth", health, HEALTH_MEANING, namespace=di)

    async def _analog(self, quantity: Quantity, key: str, parent: str, limits: Range | None) -> None:
        """Add an AnalogItem with its sigmas."""
        kind = ua.ObjectIds.AnalogItemType if limits else ua.ObjectIds.AnalogUnitType
        name = quantity.key
        await self._variable(key, parent, name, ua.ObjectIds.Double, quantity.meaning, kind)
        node = self.node_id(key)
        unit = unit_of(quantity.unit)
        if limits:
            await self.add_property(node, self.node_id(f"{key}.EURange"), "EURange", ua.Range(*limits), 0)
        await self.add_property(node, self.node_id(f"{key}.EngineeringUnits"), "EngineeringUnits", unit, 0)
        await self.add_property(node, self.node_id(f"{key}.Definition"), "Definition", quantity.meaning, 0)
        if not quantity.has_sigma:
            return
        for part, called, meaning in (
            ("sigma", "Sigma", "combined standard uncertainty (1 sigma) of the value"),
            ("sigma_now", "SigmaNow", "the same as a statement about the truth when it was written"),
        )[: 2 if self._start.quantities.has_motion else 1]:
            place = f"{key}.{part}"
            await self._variable(
                place, key, called, ua.ObjectIds.Double, meaning, ua.ObjectIds.AnalogUnitType
            )
            units = self.node_id(f"{place}.EngineeringUnits")
            await self.add_property(self.node_id(place), units, "EngineeringUnits", unit, 0)

    async def _variable(  # noqa: PLR0913  what differs between the unit's variables
        self,
        key: str,
        parent: str,
        name: str,
        data_type: int | ua.NodeId,
        meaning: str,
        kind: int = ua.ObjectIds.BaseDataVariableType,
        namespace: int | None = None,
    ) -> None:
        attributes = ua.VariableAttributes()
        attributes.DataType = data_type if isinstance(data_type, ua.NodeId) else ua.NodeId(data_type)
        attributes.ValueRank = ua.ValueRank.OneDimension if is_array(key) else ua.ValueRank.Scalar
        attributes.Description = ua.LocalizedText(meaning)
        attributes.MinimumSamplingInterval = 50.0
        if data_type == ua.ObjectIds.Double:
            self._types[key] = ua.VariantType.Double
        else:
            self._types[key] = VARIANTS.get(data_type, ua.VariantType.Int32)
        can_be_asked = self._start.history is not None and self.quantity_of(self.node_id(key)) is not None
        if can_be_asked:
            attributes.AccessLevel = attributes.UserAccessLevel = (
                ua.AccessLevel.CurrentRead.mask | ua.AccessLevel.HistoryRead.mask
            )
            attributes.Historizing = True
        await self.add(attributes, key, parent, name, kind, namespace=namespace)
        await self.write(key, None, Status.BAD_WAITING_FOR_INITIAL_DATA, None, datetime.now().astimezone())
