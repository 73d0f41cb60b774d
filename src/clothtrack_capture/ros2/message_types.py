"""ROS 2's message types as DDS knows them, made from the definitions of `rosbags`.

DDS gets the names and layouts; the bytes themselves are written and read by `rosbags`, which gives
arrays instead of lists of numbers. Only messages that are wanted are decoded.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as idl

from clothtrack_capture.importing.messages import message_store

_BASES = {
    "bool": bool,
    "byte": idl.byte,
    "char": idl.uint8,
    "float32": idl.float32,
    "float64": idl.float64,
    "int8": idl.int8,
    "int16": idl.int16,
    "int32": idl.int32,
    "int64": idl.int64,
    "string": str,
    "uint8": idl.uint8,
    "uint16": idl.uint16,
    "uint32": idl.uint32,
    "uint64": idl.uint64,
}


# Annotations do not name classes of this kind: beartype refuses how they describe themselves.
class CdrMessage(IdlStruct):
    """A message as it travels: CDR behind a head of four bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(
        self, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None
    ) -> bytes:
        """Return the bytes as they are; ROS 2 has one representation, whatever is asked for."""
        del buffer, endianness, use_version_2
        return self.data

    @classmethod
    def deserialize(
        cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None
    ) -> Any:
        """Keep the bytes; `importing.messages.decode` makes fields of them."""
        del has_header, use_version_2
        return cls(data)

    # ROS's messages have no keys: what tells that a publisher has left holds nothing.
    deserialize_key = deserialize


def dds_name(kind: str) -> str:
    """Return the DDS name of a type: `pkg::msg::dds_::Name_` for "pkg/msg/Name"."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def ros_name(dds: str) -> str:
    """Return the ROS name of a DDS type; the DDS name where ROS has not made it."""
    return dds.removesuffix("_").replace("::dds_::", "::").replace("::", "/")


@cache
def dds_type(kind: str) -> type:
    """Return the DDS type of messages such as "sensor_msgs/msg/Image"; samples hold their bytes."""
    name, fields = kind.rpartition("/")[2], fields_of(kind)
    return make_idl_struct(name, dds_name(kind), fields, dataclassify=False, bases=(CdrMessage,))


@cache
def idl_struct(kind: str) -> type:
    """Return a message type with its fields, to be a field of another."""
    return make_idl_struct(kind.rpartition("/")[2], dds_name(kind), fields_of(kind))


def fields_of(kind: str) -> dict[str, Any]:
    """Return IDL types of the fields of a message type, in their order."""
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
