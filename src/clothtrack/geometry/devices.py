"""Which devices there are to compute on, and how much Warp says about them."""

import warp as wp

from clothtrack.errors import InvalidConfigError


def quiet_warp() -> None:
    """Keep Warp from greeting on standard output, where results go; errors are still told.

    For programs and worker processes; importing clothtrack does not touch Warp's settings.
    """
    wp.config.log_level = wp.LOG_ERROR


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
