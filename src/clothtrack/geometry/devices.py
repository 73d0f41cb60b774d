"""Available compute devices, and verbosity of Warp."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp

from clothtrack.errors import InvalidConfigError


def quiet_warp() -> None:
    """Keep Warp from printing its banner on standard output, where results go; keep errors.

    This is for programs and worker processes; importing clothtrack does not change Warp's settings.
    It also hides the message that Warp's library prints at every start without a CUDA driver,
    because a machine without one is not an error.
    """
    wp.config.log_level = wp.LOG_ERROR
    if not _has_cuda_driver():
        with _standard_error_closed():
            wp.init()


def device_names() -> list[str]:
    """Return the devices of this machine; a GPU has its name: "cuda:0 (NVIDIA H100)"."""
    return [
        f"{device.alias} ({device.name})" if device.is_cuda else device.alias
        for device in wp.get_devices()
    ]


def require_device(name: str) -> None:
    """Reject a device that this machine does not have."""
    known = [device.alias for device in wp.get_devices()]
    if name not in known:
        raise InvalidConfigError(
            f"device is {name!r}, but this machine has {', '.join(known)}; choose one of these"
        )


def _has_cuda_driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


@contextmanager
def _standard_error_closed() -> Iterator[None]:
    """Discard the output of a library to the process's standard error."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
