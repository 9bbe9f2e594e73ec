"""The address space: the unit as a device of OPC 10000-100, its quantities as AnalogItems of OPC 10000-8.

Namespace 2 is the unit's, the same for all units; 3 is that of OPC 10000-100. asyncua has no nodes of the
latter: the required ones are created here, with the numbers that OPC 10000-100 assigns.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from datetime import datetime
from typing import Any

from asyncua import ua
from asyncua.server import Server

from altd.publish.opcua.quality import Status
from altd.publish.opcua.start import Range, Start
from altd.records import Quantity

UNIT_NAMESPACE = "urn:altd:unit"
DI_NAMESPACE = "http://opcfoundation.org/UA/DI/"
MODEL = "Active Laser Target"

UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
UNITS = {
    "mm": (UNECE, int.from_bytes(b"MMT"), "millimetre"),
    "°": (UNECE, int.from_bytes(b"DD"), "degree"),
    "mm/m": (UNIT_NAMESPACE, -1, "millimetre per metre"),
    "mm/d": (UNIT_NAMESPACE, -1, "millimetre per day"),
    "": (UNECE, int.from_bytes(b"C62"), "one"),
}
"""Namespace, number and name of each unit of a quantity (OPC 10000-8, 5.6.4.4). UNECE lacks mm/m and mm/d."""

HEALTH = ("NORMAL", "FAILURE", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED")
"""``DeviceHealthEnumeration``; the numbers are those of ``altd.reasons.Signal``."""

_DI_TYPES = (
    (1001, "TopologyElementType", ua.NodeId(ua.ObjectIds.BaseObjectType)),
    (15063, "ComponentType", 1001),
    (1002, "DeviceType", 15063),
    (15051, "IDeviceHealthType", ua.NodeId(ua.ObjectIds.BaseInterfaceType)),
)
_DEVICE_SET, _DEVICE_HEALTH_ENUMERATION, _ENUM_STRINGS = 5001, 6244, 6450

VARIABLES: Mapping[str, tuple[str, int, str]] = {
    "valid": ("Valid", ua.ObjectIds.Boolean, "whether the numbers may be used; as on every interface"),
    "sequence": (
        "Sequence",
        ua.ObjectIds.UInt32,
        "number of the newest exposure; 0xFFFFFFFE is followed by 0",
    ),
    "frames": ("Frames", ua.ObjectIds.UInt32, "exposures that were averaged"),
    "age_ms": ("AgeMs", ua.ObjectIds.Int32, "ms since the middle of the exposures, when it was written"),
    "status": ("Reasons", ua.ObjectIds.String, "the codes of reasons and warnings"),
    "causes": ("Causes", ua.ObjectIds.String, "codes of the unit's faults, the worst first"),
}
"""BrowseName, type and meaning of the nodes that are not quantities, by key."""

OF_PLACE: Mapping[str, tuple[str, int, str]] = {
    "valid": ("Valid", ua.ObjectIds.Boolean, "whether the spot on the target was measured"),
    "status": (
        "Reasons",
        ua.ObjectIds.String,
        "the codes of reasons and warnings, without the target's name",
    ),
}
"""BrowseName, type and meaning of the corresponding nodes of each target of a row, by key."""

_ARRAYS = {"status", "causes"}
_TYPES = {
    ua.ObjectIds.Boolean: ua.VariantType.Boolean,
    ua.ObjectIds.UInt32: ua.VariantType.UInt32,
    ua.ObjectIds.Int32: ua.VariantType.Int32,
    ua.ObjectIds.String: ua.VariantType.String,
}


class UnitNodes:
    """The nodes of a unit; ``write`` sets their values."""

    def __init__(self, server: Server, start: Start) -> None:
        self._server = server
        self._start = start
        self._own = self._di = 0
        self._types: dict[str, ua.VariantType] = {}

    async def build(self) -> None:
        """Create all nodes; every value waits for initial data."""
        self._own = await self._server.register_namespace(UNIT_NAMESPACE)
        self._di = await self._server.register_namespace(DI_NAMESPACE)
        await self._device_model()
        await self._unit()
        quantities = self._start.quantities
        for quantity in quantities.of_unit:
            if not quantity.place:
                await self._analog(quantity, quantity.key, "unit", self._start.ranges.get(quantity.key))
        for target, ranges in self._start.targets.items():
            place = f"targets.{target}"
            await self._add(ua.ObjectAttributes(), place, "unit", target, ua.ObjectIds.BaseObjectType)
            for quantity in quantities.of_target:
                await self._analog(quantity, f"{place}.{quantity.key}", place, ranges.get(quantity.key))
            for quantity in quantities.of_unit:
                if quantity.place == target:
                    await self._analog(quantity, quantity.key, place, None)
            for key, (name, kind, meaning) in OF_PLACE.items() if quantities.has_places else ():
                await self._variable(f"{place}.{key}", place, name, kind, meaning)
        for key, (name, kind, meaning) in VARIABLES.items():
            await self._variable(key, "unit", name, kind, meaning)

    @property
    def keys(self) -> Set[str]:
        """Keys of the nodes that ``write`` accepts."""
        return self._types.keys()

    def node_id(self, key: str) -> ua.NodeId:
        """The identifier of a node of the unit."""
        return ua.NodeId(key, self._own)

    def quantity_of(self, node: ua.NodeId) -> str | None:
        """Key of a quantity in the history, ``TARGET.KEY`` for a target's; None: the node is none."""
        key = str(node.Identifier) if node.NamespaceIndex == self._own else ""
        is_number = self._types.get(key) is ua.VariantType.Double
        return (
            key.removeprefix("targets.") if is_number and not key.endswith((".sigma", ".sigma_now")) else None
        )

    async def write(
        self, key: str, value: object, status: Status, source: datetime | None, now: datetime
    ) -> None:
        """Set a value; a Bad one is null. Raises UaError if asyncua refuses it, and so keeps the old one."""
        kind = ua.VariantType.Null if status.is_bad else self._types[key]
        data = ua.DataValue(
            ua.Variant(None if status.is_bad else value, kind, is_array=_is_array(key) or None),
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

    async def _device_model(self) -> None:
        """Create the types of OPC 10000-100 that the unit refers to."""
        for number, name, above in _DI_TYPES:
            attributes = ua.ObjectTypeAttributes()
            attributes.IsAbstract = True
            parent = ua.NodeId(above, self._di) if isinstance(above, int) else above
            node = ua.NodeId(number, self._di)
            await self._add(attributes, node, parent, name, None, ua.ObjectIds.HasSubtype)
        enumeration = ua.NodeId(_DEVICE_HEALTH_ENUMERATION, self._di)
        above = ua.NodeId(ua.ObjectIds.Enumeration)
        await self._add(
            ua.DataTypeAttributes(),
            enumeration,
            above,
            "DeviceHealthEnumeration",
            None,
            ua.ObjectIds.HasSubtype,
        )
        texts = [ua.LocalizedText(name) for name in HEALTH]
        await self._property(
            enumeration, ua.NodeId(_ENUM_STRINGS, self._di), "EnumStrings", texts, namespace=0
        )
        device_set, objects = ua.NodeId(_DEVICE_SET, self._di), ua.NodeId(ua.ObjectIds.ObjectsFolder)
        kind, organizes = ua.ObjectIds.BaseObjectType, ua.ObjectIds.Organizes
        await self._add(ua.ObjectAttributes(), device_set, objects, "DeviceSet", kind, organizes)

    async def _unit(self) -> None:
        start, di, objects = self._start, self._di, ua.NodeId(ua.ObjectIds.ObjectsFolder)
        own_type = ua.NodeId("ActiveLaserTargetType", self._own)
        above = ua.NodeId(1002, di)
        await self._add(
            ua.ObjectTypeAttributes(), own_type, above, own_type.Identifier, None, ua.ObjectIds.HasSubtype
        )
        await self._add(
            ua.ObjectAttributes(), "unit", objects, start.serial, own_type, ua.ObjectIds.Organizes
        )
        for source, kind, target in (
            (ua.NodeId(_DEVICE_SET, di), ua.ObjectIds.HasComponent, self.node_id("unit")),
            (self.node_id("unit"), ua.ObjectIds.HasInterface, ua.NodeId(15051, di)),
        ):
            await self._server.get_node(source).add_reference(target, kind, forward=True)
        for name, value in (
            ("Manufacturer", ua.LocalizedText("")),
            ("Model", ua.LocalizedText(MODEL)),
            ("SerialNumber", start.serial),
            ("SoftwareRevision", start.version),
            ("HardwareRevision", ""),
            ("DeviceRevision", ""),
            ("DeviceManual", ""),
            ("RevisionCounter", ua.Variant(-1, ua.VariantType.Int32)),
        ):
            await self._property(self.node_id("unit"), self.node_id(name), name, value, namespace=di)
        for name, value in (
            ("Session", start.session),
            ("CalibrationCreated", str(start.calibration["created"] or "")),
            ("CalibrationChecksum", str(start.calibration["checksum"] or "")),
            ("CalibrationSimulated", bool(start.calibration["simulated"])),
        ):
            await self._property(self.node_id("unit"), self.node_id(name), name, value)
        health = ua.NodeId(_DEVICE_HEALTH_ENUMERATION, di)
        meaning = "the unit's state in the signals of NAMUR NE 107"
        await self._variable("health", "unit", "DeviceHealth", health, meaning, namespace=di)

    async def _analog(self, quantity: Quantity, key: str, parent: str, limits: Range | None) -> None:
        """Add an AnalogItem with its sigmas."""
        kind = ua.ObjectIds.AnalogItemType if limits else ua.ObjectIds.AnalogUnitType
        name = quantity.key
        await self._variable(key, parent, name, ua.ObjectIds.Double, quantity.meaning, kind)
        node = self.node_id(key)
        unit = _unit_of(quantity.unit)
        if limits:
            await self._property(node, self.node_id(f"{key}.EURange"), "EURange", ua.Range(*limits), 0)
        await self._property(node, self.node_id(f"{key}.EngineeringUnits"), "EngineeringUnits", unit, 0)
        await self._property(node, self.node_id(f"{key}.Definition"), "Definition", quantity.meaning, 0)
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
            await self._property(self.node_id(place), units, "EngineeringUnits", unit, 0)

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
        attributes.ValueRank = ua.ValueRank.OneDimension if _is_array(key) else ua.ValueRank.Scalar
        attributes.Description = ua.LocalizedText(meaning)
        attributes.MinimumSamplingInterval = 50.0
        if data_type == ua.ObjectIds.Double:
            self._types[key] = ua.VariantType.Double
        else:
            self._types[key] = _TYPES.get(data_type, ua.VariantType.Int32)
        can_be_asked = self._start.history is not None and self.quantity_of(self.node_id(key)) is not None
        if can_be_asked:
            attributes.AccessLevel = attributes.UserAccessLevel = (
                ua.AccessLevel.CurrentRead.mask | ua.AccessLevel.HistoryRead.mask
            )
            attributes.Historizing = True
        await self._add(attributes, key, parent, name, kind, namespace=namespace)
        await self.write(key, None, Status.BAD_WAITING_FOR_INITIAL_DATA, None, datetime.now().astimezone())

    async def _property(
        self, parent: ua.NodeId, node: ua.NodeId, name: str, value: Any, namespace: int | None = None
    ) -> None:
        attributes = ua.VariableAttributes()
        attributes.Value = value if isinstance(value, ua.Variant) else ua.Variant(value)
        attributes.DataType = (
            ua.NodeId(getattr(ua.ObjectIds, type(value).__name__))
            if isinstance(value, ua.Range | ua.EUInformation)
            else ua.NodeId(attributes.Value.VariantType.value)
        )
        attributes.ValueRank = ua.ValueRank.OneDimension if isinstance(value, list) else ua.ValueRank.Scalar
        property_type, has_property = ua.ObjectIds.PropertyType, ua.ObjectIds.HasProperty
        await self._add(attributes, node, parent, name, property_type, has_property, namespace)

    async def _add(  # noqa: PLR0913  the fields of an AddNodesItem
        self,
        attributes: Any,
        node: str | ua.NodeId,
        parent: str | ua.NodeId,
        name: str,
        kind: int | ua.NodeId | None,
        reference: int = ua.ObjectIds.HasComponent,
        namespace: int | None = None,
    ) -> None:
        item = ua.AddNodesItem()
        item.RequestedNewNodeId = node if isinstance(node, ua.NodeId) else self.node_id(node)
        item.ParentNodeId = parent if isinstance(parent, ua.NodeId) else self.node_id(parent)
        item.ReferenceTypeId = ua.NodeId(reference)
        item.NodeClass = _CLASSES[type(attributes)]
        if kind is not None:
            item.TypeDefinition = kind if isinstance(kind, ua.NodeId) else ua.NodeId(kind)
        space = item.RequestedNewNodeId.NamespaceIndex if namespace is None else namespace
        item.BrowseName = ua.QualifiedName(name, space)
        attributes.DisplayName = ua.LocalizedText(name)
        item.NodeAttributes = attributes
        (result,) = await self._server.iserver.isession.add_nodes([item])
        result.StatusCode.check()


_CLASSES = {
    ua.ObjectAttributes: ua.NodeClass.Object,
    ua.VariableAttributes: ua.NodeClass.Variable,
    ua.ObjectTypeAttributes: ua.NodeClass.ObjectType,
    ua.DataTypeAttributes: ua.NodeClass.DataType,
}


def _is_array(key: str) -> bool:
    return key.rpartition(".")[2] in _ARRAYS


def _unit_of(symbol: str) -> ua.EUInformation:
    namespace, number, name = UNITS.get(symbol, (UNIT_NAMESPACE, -1, symbol))
    return ua.EUInformation(namespace, number, ua.LocalizedText(symbol), ua.LocalizedText(name))
