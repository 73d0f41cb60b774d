"""Devices that PyTorch cannot work on are refused before anything is begun."""

import pytest
import torch

from clothtrack.errors import InvalidConfigError
from clothtrack.reconstruction.training.processes import require_torch_device


@pytest.mark.parametrize("device", ["tpu", "cuda:x", "cudafast"])
def test_a_device_that_cannot_be_is_refused(device):
    with pytest.raises(InvalidConfigError, match="use cpu, cuda or cuda:0"):
        require_torch_device(device)


def test_a_graphics_card_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    require_torch_device("cuda")
    require_torch_device("cuda:1")
    with pytest.raises(InvalidConfigError, match="sees 2 GPUs"):
        require_torch_device("cuda:2")
