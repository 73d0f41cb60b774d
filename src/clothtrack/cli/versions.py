"""The installed versions, for bug reports."""

from clothtrack.cli.terminal import say_result

PACKAGES = (
    "warp-lang", "numpy", "scipy", "opencv-python-headless", "zarr", "mujoco-core", "tyro", "torch",
)  # fmt: skip
"""Distributions that results depend on; those of an extra are listed if installed."""


def versions(*, json: bool) -> int:
    """Print the version, commit, devices, machine and packages; no package is imported."""
    from clothtrack.files.provenance import made_with
    from clothtrack.geometry.devices import device_names, quiet_warp

    quiet_warp()
    made, devices = made_with(PACKAGES), device_names()
    commit = f" (commit {made['commit']})" if made["commit"] else ""
    installed = made["packages"]
    assert isinstance(installed, dict)
    lines = [
        f"clothtrack {made['clothtrack']}{commit}",
        f"devices   {', '.join(devices)}",
        f"machine   {made['machine']}, Python {made['python']}",
        f"packages  {', '.join(f'{name} {version}' for name, version in installed.items())}",
    ]
    say_result("\n".join(lines), {**made, "devices": devices}, json=json)
    return 0
