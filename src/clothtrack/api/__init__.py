"""What `import clothtrack` does, and so what the command line does: one function for each wish.

The command line makes a verb of such a function (`clothtrack.cli.signature`): its options are the
arguments, its help is the docstring. So the modules of verbs load no stage when they are imported.
"""
