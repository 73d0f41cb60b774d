"""The public functions of `clothtrack`, which the command line offers as verbs.

The command line makes a verb of such a function (`clothtrack.cli.signature`): the arguments become
options and the docstring becomes the help. The modules therefore load no stage on import.
"""
