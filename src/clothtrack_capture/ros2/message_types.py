"""ROS 2 message types for DDS, made from the definitions of `rosbags`.

DDS gets the names and layouts. The bytes are written and read by `rosbags`, which returns arrays
instead of lists of numbers. Only the needed messages are decoded.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as idl

from clothtrack_capture.importing.messages import message_store

_BASES = {"bool": bool, "string": str, "char": idl.uint8} | {
    name: getattr(idl, name)
    for name in ("byte", *(f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)),
                 "float32", "float64")
}  # fmt: skip


# Annotations do not use classes of this kind, because beartype rejects their self-description.
class CdrMessage(IdlStruct):
    """A serialized message: CDR after a header of four bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(
        self, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None
    ) -> bytes:
        """Return the bytes unchanged; ROS 2 has only one representation."""
        del buffer, endianness, use_version_2
        return self.data

    @classmethod
    def deserialize(
        cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None
    ) -> Any:
        """Store the bytes; `importing.messages.decode` decodes their fields."""
        del has_header, use_version_2
        return cls(data)

    # ROS messages have no keys, so the sample that reports a publisher's end is empty.
    deserialize_key = deserialize


def dds_name(kind: str) -> str:
    """Return the DDS name of a type: `pkg::msg::dds_::Name_` for "pkg/msg/Name"."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def ros_name(dds: str) -> str:
    """Return the ROS name of a DDS type; the DDS name if it is not a ROS type."""
    return dds.removesuffix("_").replace("::dds_::", "::").replace("::", "/")


@cache
def dds_type(kind: str) -> type:
    """Return the DDS type of a message type such as "sensor_msgs/msg/Image"; samples hold bytes."""
    name, fields = kind.rpartition("/")[2], fields_of(kind)
    return make_idl_struct(name, dds_name(kind), fields, dataclassify=False, bases=(CdrMessage,))


@cache
def idl_struct(kind: str) -> type:
    """Return a message type with its fields, for use as a field of another type."""
    return make_idl_struct(kind.rpartition("/")[2], dds_name(kind), fields_of(kind))


def fields_of(kind: str) -> dict[str, Any]:
    """Return the IDL types of a message type's fields, in order."""
    return {name: _idl_type(tree) for name, tree in message_store(cdr=True).fielddefs[kind][1]}


def _idl_type(tree: Any) -> Any:
    node, content = tree
    if node.name == "NAME":
        return idl_struct(content)
    if node.name == "BASE":
        return _BASES[content[0]]
    element, length = content
    return (
        idl.array[_idl_type(element), length]
        if node.name == "ARRAY"
        else idl.sequence[_idl_type(element)]
    )
