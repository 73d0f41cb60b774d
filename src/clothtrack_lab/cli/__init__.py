"""The verbs of the lab; the command line finds them by entry points."""
