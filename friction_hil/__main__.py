"""``python -m friction_hil``: the command line of the interpreter in use."""

import sys

from friction_hil.cli import main

sys.exit(main())
