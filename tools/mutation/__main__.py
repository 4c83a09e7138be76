"""``python -m tools.mutation``, which ``tools/mutants`` runs."""

import sys

from friction_hil.cli import exit_status
from tools.mutation.command import command

sys.exit(exit_status(command, None, "tools/mutants"))
