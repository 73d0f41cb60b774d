"""A domain of each test's own on the loopback interface, and messages of ROS 2."""

import importlib.util
import os
import sys
import uuid
from pathlib import Path

import pytest

if "import_makers" not in sys.modules:
    _path = Path(__file__).parents[1] / "importing" / "makers.py"
    _spec = importlib.util.spec_from_file_location("import_makers", _path)
    sys.modules["import_makers"] = importlib.util.module_from_spec(_spec)
    _spec.loader.exec_module(sys.modules["import_makers"])

LOOPBACK = """<CycloneDDS><Domain Id="any">
<General>
  <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
  <AllowMulticast>false</AllowMulticast>
</General>
<Discovery>
  <Tag>{tag}</Tag>
  <ParticipantIndex>auto</ParticipantIndex>
  <Peers><Peer address="127.0.0.1"/></Peers>
</Discovery>
</Domain></CycloneDDS>"""


@pytest.fixture
def loopback(monkeypatch):
    """Nobody else is in this domain, and nothing leaves this machine."""
    pytest.importorskip("cyclonedds", reason="the extra [ros2] brings it")
    # A domain of a process is set up once: the configuration is that of its first participant.
    domain = str(100 + os.getpid() % 100)
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK.format(tag=uuid.uuid4().hex))
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
