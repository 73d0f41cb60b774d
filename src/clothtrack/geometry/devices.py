"""Which devices there are to compute on, and how much Warp says about them."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp

from clothtrack.errors import InvalidConfigError


def quiet_warp() -> None:
    """Keep Warp from greeting on standard output, where results go; errors are still told.

    For programs and worker processes; importing clothtrack does not touch Warp's settings. A
    machine without a CUDA driver is no error either: Warp's library says so on every start.
    """
    wp.config.log_level = wp.LOG_ERROR
    if not _has_cuda_driver():
        with _standard_error_closed():
            wp.init()


def device_names() -> list[str]:
    """Return the devices of this machine, a GPU with its name: "cuda:0 (NVIDIA H100)"."""
    return [
        f"{device.alias} ({device.name})" if device.is_cuda else device.alias
        for device in wp.get_devices()
    ]


def require_device(name: str) -> None:
    """Refuse a device that this machine does not have.

    Raises:
        InvalidConfigError: naming the devices that it has.
    """
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
    """Discard what a library writes to the process's standard error."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
