"""`python -m clothtrack.cli`: the same as `clothtrack`, with this interpreter."""

import sys

from clothtrack.cli.command_line import main

if __name__ == "__main__":
    sys.exit(main())
