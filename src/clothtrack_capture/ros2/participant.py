"""DDS as used by ROS 2: discovery of topics, and readers and writers with ROS's QoS."""

import os
import threading
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import (
    DDSException,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration

from clothtrack.errors import InvalidConfigError
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.ros2.message_types import CdrMessage, dds_type, ros_name

PICTURES_KEPT = 5
SAMPLES_KEPT = 512
_PREFIX = "rt"  # prefix of ROS topic names in DDS
_MOST_ENDPOINTS = 10_000
_BLOCKED_AT_MOST = duration(milliseconds=5)
# Cyclone DDS takes Fast DDS's descriptions of ROS types for damaged, and then no messages arrive.
# ROS types are identified by name, so the type descriptions of these vendors (RTI, eProsima,
# Eclipse) are ignored.
_CONFIGURATION = (
    "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>1.1,1.15,1.16"
    "</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"
)
_CONFIGURING = threading.Lock()
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any


class Closing(AbstractContextManager):
    """What is closed at the end of its block."""

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Leave the domain."""


@dataclass(frozen=True)
class Publication:
    """The publication of a topic.

    Attributes:
        latched: whether every publisher sends its last messages to late subscribers.
    """

    kind: str
    reliable: bool
    latched: bool


class Reader:
    """A reader of a topic's messages."""

    def __init__(self, topic: Topic, reader: DataReader, condition: ReadCondition) -> None:
        self.topic, self.condition, self._reader = topic, condition, reader

    def take(self) -> list[tuple[bytes, int]]:
        """Return bytes and send time [ns] of the messages since the last call, oldest first."""
        samples = self._reader.take(N=SAMPLES_KEPT)
        return [
            (sample.data, sample.sample_info.source_timestamp)
            for sample in samples
            if isinstance(sample, CdrMessage)
        ]


class Writer:
    """A publisher of a topic's messages."""

    def __init__(self, writer: DataWriter, kind: str) -> None:
        self._writer, self._type = writer, dds_type(kind)

    def write(self, data: bytes) -> bool:
        """Send a message; return false if a reader is too slow to take it."""
        try:
            self._writer.write(self._type(data))
        except DDSException as error:
            if error.code == DDSException.DDS_RETCODE_TIMEOUT:
                return False
            raise
        return True


class Participant:
    """A participant in a DDS domain, until it is closed."""

    def __init__(self, domain_id: int | None) -> None:
        """Join a domain."""
        number = _domain_of_environment() if domain_id is None else domain_id
        try:
            with _configured():
                self._participant = DomainParticipant(number)
        except DDSException as error:
            raise InvalidConfigError(
                f"DDS refuses domain {number}; a domain is 0 to 232, and CYCLONEDDS_URI, where it "
                "is set, names an interface of this machine"
            ) from error
        self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._waiting = WaitSet(self._participant)
        self._entities: list[Any] = [self._participant, self._publications]

    def publications(self) -> dict[str, Publication]:
        """Return every ROS topic that is published now."""
        found: dict[str, list[Any]] = {}
        for endpoint in self._publications.read(N=_MOST_ENDPOINTS):
            alive = endpoint.sample_info.instance_state == InstanceState.Alive
            if alive and endpoint.topic_name.startswith(f"{_PREFIX}/"):
                found.setdefault(endpoint.topic_name.removeprefix(_PREFIX), []).append(endpoint)
        return {name: _publication(endpoints) for name, endpoints in found.items()}

    def picture_reader(self, topic: Topic) -> Reader:
        """Read a topic as sensor data (newest only, best effort); `wait` ends when one arrives."""
        reader = self._reader(
            topic, Policy.Reliability.BestEffort, Policy.History.KeepLast(PICTURES_KEPT)
        )
        self._waiting.attach(reader.condition)
        return reader

    def sample_reader(self, topic: Topic, *, reliable: bool, latched: bool) -> Reader:
        """Read a topic of small messages, with the reliability it is published with."""
        return self._reader(
            topic,
            Policy.Reliability.Reliable(0) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(SAMPLES_KEPT),
        )

    def writer(self, topic: Topic) -> Writer:
        """Publish a topic reliably, newest message only, without latching."""
        qos = _qos(
            Policy.Reliability.Reliable(_BLOCKED_AT_MOST),
            Policy.Durability.Volatile,
            Policy.History.KeepLast(1),
        )
        entity = DdsTopic(self._participant, _PREFIX + topic.name, dds_type(topic.kind))
        writer = DataWriter(self._participant, entity, qos=qos)
        self._entities += [entity, writer]
        return Writer(writer, topic.kind)

    def wait(self, timeout_s: float) -> None:
        """Wait until a picture has arrived or the time is over."""
        self._waiting.wait(duration(seconds=timeout_s))

    def close(self) -> None:
        """Leave the domain; readers and writers become unusable."""
        for entity in (self._waiting, *reversed(self._entities)):
            # Delete it now, not when its last reference is gone.
            entity.__del__()
        self._entities.clear()

    def _reader(self, topic: Topic, *policies: Any) -> Reader:
        qos = _qos(*policies)
        entity = DdsTopic(self._participant, _PREFIX + topic.name, dds_type(topic.kind))
        reader = DataReader(self._participant, entity, qos=qos)
        condition = ReadCondition(reader, _ANY)
        self._entities += [entity, reader, condition]
        return Reader(topic, reader, condition)


def _qos(*policies: Any) -> Qos:
    # ROS 2 writes and reads only this representation.
    return Qos(*policies, Policy.DataRepresentation(use_cdrv0_representation=True))


def _publication(endpoints: Sequence[Any]) -> Publication:
    return Publication(
        ros_name(endpoints[0].type_name),
        all(isinstance(one.qos[Policy.Reliability], Policy.Reliability.Reliable)
            for one in endpoints),
        all(one.qos[Policy.Durability] not in (None, Policy.Durability.Volatile)
            for one in endpoints),
    )  # fmt: skip


@contextmanager
def _configured() -> Iterator[None]:
    """Make a domain created inside read our configuration, then that of the environment."""
    with _CONFIGURING:
        given = os.environ.get("CYCLONEDDS_URI")
        os.environ["CYCLONEDDS_URI"] = f"{_CONFIGURATION},{given}" if given else _CONFIGURATION
        try:
            yield
        finally:
            if given is None:
                del os.environ["CYCLONEDDS_URI"]
            else:
                os.environ["CYCLONEDDS_URI"] = given


def _domain_of_environment() -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    try:
        return int(text)
    except ValueError as error:
        raise InvalidConfigError(
            f"ROS_DOMAIN_ID is {text!r}; it is a whole number, 0 to 232"
        ) from error
