"""The types of the unit: those of OPC 10000-100 that it refers to, and its own.

asyncua has no nodes of OPC 10000-100: the required ones are created here, with the numbers that it assigns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from asyncua import ua
from asyncua.server import Server

from altd.publish.opcua.start import Start
from altd.records import Quantity

UNIT_NAMESPACE = "urn:altd:unit"
DI_NAMESPACE = "http://opcfoundation.org/UA/DI/"
TYPE = "ActiveLaserTargetType"

UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
UNITS = {
    "mm": (UNECE, int.from_bytes(b"MMT"), "millimetre"),
    "°": (UNECE, int.from_bytes(b"DD"), "degree"),
    "mm/m": (UNIT_NAMESPACE, -1, "millimetre per metre"),
    "mm/d": (UNIT_NAMESPACE, -1, "millimetre per day"),
    "": (UNECE, int.from_bytes(b"C62"), "one"),
}
"""Namespace, number and name of each unit of a quantity (OPC 10000-8, 5.6.4.4). UNECE lacks mm/m and mm/d."""

HEALTH_MEANING = "the unit's state in the signals of NAMUR NE 107"
HEALTH = ("NORMAL", "FAILURE", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED")
"""``DeviceHealthEnumeration``; the numbers are those of ``altd.reasons.Signal``."""

_DI_TYPES = (
    (1001, "TopologyElementType", ua.NodeId(ua.ObjectIds.BaseObjectType)),
    (15063, "ComponentType", 1001),
    (1002, "DeviceType", 15063),
    (15051, "IDeviceHealthType", ua.NodeId(ua.ObjectIds.BaseInterfaceType)),
)
DEVICE_SET, DEVICE_HEALTH_ENUMERATION, _ENUM_STRINGS = 5001, 6244, 6450

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

OF_JOINT = {
    "covariance": (
        "Covariance",
        "covariance of {}, row by row, in the products of their units; NaN: not known",
    ),
    "covariance_now": ("CovarianceNow", "the same as a statement about the truth when it was written"),
}
"""BrowseName and meaning of the joint uncertainty of a beam, by key."""

_ARRAYS = {"status", "causes", *OF_JOINT}
VARIANTS = {
    ua.ObjectIds.Boolean: ua.VariantType.Boolean,
    ua.ObjectIds.UInt32: ua.VariantType.UInt32,
    ua.ObjectIds.Int32: ua.VariantType.Int32,
    ua.ObjectIds.String: ua.VariantType.String,
}


class TypeNodes:
    """Namespaces and types, and what creates nodes."""

    def __init__(self, server: Server, start: Start) -> None:
        self._server = server
        self._start = start
        self._own = self._di = 0

    async def build_types(self) -> None:
        """Create namespaces and types."""
        self._own = await self._server.register_namespace(UNIT_NAMESPACE)
        self._di = await self._server.register_namespace(DI_NAMESPACE)
        await self._device_types()
        await self._own_type()

    def node_id(self, key: str) -> ua.NodeId:
        """The identifier of a node of the unit."""
        return ua.NodeId(key, self._own)

    async def _device_types(self) -> None:
        """Create the types of OPC 10000-100 that the unit refers to."""
        for number, name, above in _DI_TYPES:
            attributes = ua.ObjectTypeAttributes()
            attributes.IsAbstract = True
            parent = ua.NodeId(above, self._di) if isinstance(above, int) else above
            node = ua.NodeId(number, self._di)
            await self.add(attributes, node, parent, name, None, ua.ObjectIds.HasSubtype)
        enumeration = ua.NodeId(DEVICE_HEALTH_ENUMERATION, self._di)
        above = ua.NodeId(ua.ObjectIds.Enumeration)
        await self.add(
            ua.DataTypeAttributes(),
            enumeration,
            above,
            "DeviceHealthEnumeration",
            None,
            ua.ObjectIds.HasSubtype,
        )
        texts = [ua.LocalizedText(name) for name in HEALTH]
        await self.add_property(
            enumeration, ua.NodeId(_ENUM_STRINGS, self._di), "EnumStrings", texts, namespace=0
        )
        device_set, objects = ua.NodeId(DEVICE_SET, self._di), ua.NodeId(ua.ObjectIds.ObjectsFolder)
        kind, organizes = ua.ObjectIds.BaseObjectType, ua.ObjectIds.Organizes
        await self.add(ua.ObjectAttributes(), device_set, objects, "DeviceSet", kind, organizes)

    async def _own_type(self) -> None:
        """Create the unit's type: mandatory what all units have, optional the quantities of beams and plates.

        It is the same on all units.
        """
        own, has_subtype = self.node_id(TYPE), ua.ObjectIds.HasSubtype
        await self.add(ua.ObjectTypeAttributes(), own, ua.NodeId(1002, self._di), TYPE, None, has_subtype)
        for key, (name, kind, meaning) in VARIABLES.items():
            await self._declare(key, name, ua.NodeId(kind), meaning)
        health = ua.NodeId(DEVICE_HEALTH_ENUMERATION, self._di)
        await self._declare("health", "DeviceHealth", health, HEALTH_MEANING, namespace=self._di)
        for quantity in self._start.declared:
            double = ua.NodeId(ua.ObjectIds.Double)
            place = await self._declare(quantity.key, quantity.key, double, quantity.meaning, quantity)
            units = self.node_id(f"{place.Identifier}.EngineeringUnits")
            await self.add_property(place, units, "EngineeringUnits", unit_of(quantity.unit), 0)
            await self._rule(units, ua.ObjectIds.ModellingRule_Mandatory)
        for name in ("Session", "CalibrationCreated", "CalibrationChecksum", "CalibrationSimulated"):
            place, value = self.node_id(f"{TYPE}.{name}"), False if name.endswith("Simulated") else ""
            await self.add_property(own, place, name, value)
            await self._rule(place, ua.ObjectIds.ModellingRule_Mandatory)

    async def _declare(
        self,
        key: str,
        name: str,
        data_type: ua.NodeId,
        meaning: str,
        quantity: Quantity | None = None,
        namespace: int | None = None,
    ) -> ua.NodeId:
        """Add a member of the unit's type; that of a ``quantity`` is optional."""
        attributes = ua.VariableAttributes()
        attributes.DataType, attributes.Description = data_type, ua.LocalizedText(meaning)
        attributes.ValueRank = ua.ValueRank.OneDimension if is_array(key) else ua.ValueRank.Scalar
        place, rules = self.node_id(f"{TYPE}.{key}"), ua.ObjectIds
        kind = rules.BaseDataVariableType if quantity is None else rules.AnalogUnitType
        await self.add(attributes, place, self.node_id(TYPE), name, kind, namespace=namespace)
        rule = rules.ModellingRule_Mandatory if quantity is None else rules.ModellingRule_Optional
        await self._rule(place, rule)
        return place

    async def _rule(self, node: ua.NodeId, rule: int) -> None:
        reference = ua.ObjectIds.HasModellingRule
        await self._server.get_node(node).add_reference(ua.NodeId(rule), reference, bidirectional=False)

    async def add_property(
        self, parent: ua.NodeId, node: ua.NodeId, name: str, value: Any, namespace: int | None = None
    ) -> None:
        """Add a property with its value."""
        attributes = ua.VariableAttributes()
        attributes.Value = value if isinstance(value, ua.Variant) else ua.Variant(value)
        attributes.DataType = (
            ua.NodeId(getattr(ua.ObjectIds, type(value).__name__))
            if isinstance(value, ua.Range | ua.EUInformation)
            else ua.NodeId(attributes.Value.VariantType.value)
        )
        attributes.ValueRank = ua.ValueRank.OneDimension if isinstance(value, list) else ua.ValueRank.Scalar
        property_type, has_property = ua.ObjectIds.PropertyType, ua.ObjectIds.HasProperty
        await self.add(attributes, node, parent, name, property_type, has_property, namespace)

    async def add(  # noqa: PLR0913  the fields of an AddNodesItem
        self,
        attributes: Any,
        node: str | ua.NodeId,
        parent: str | ua.NodeId,
        name: str,
        kind: int | ua.NodeId | None,
        reference: int = ua.ObjectIds.HasComponent,
        namespace: int | None = None,
    ) -> None:
        """Add a node; raises UaError if asyncua refuses it."""
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


def is_array(key: str) -> bool:
    """Whether the node of this key has several values."""
    return key.rpartition(".")[2] in _ARRAYS


def unit_of(symbol: str) -> ua.EUInformation:
    """Return a unit of measurement by its symbol."""
    namespace, number, name = UNITS.get(symbol, (UNIT_NAMESPACE, -1, symbol))
    return ua.EUInformation(namespace, number, ua.LocalizedText(symbol), ua.LocalizedText(name))
