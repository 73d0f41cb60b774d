"""The command line: one verb per stage, in the order of the method."""

from clothtrack.cli.command_line import VERBS, main

__all__ = ["VERBS", "main"]
