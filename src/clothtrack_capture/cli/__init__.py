"""The verbs of capture; the command line finds them by entry points."""
