"""The command line: one verb per stage, in the order of the method."""

from clothtrack.cli.command_line import main

__all__ = ["main"]
