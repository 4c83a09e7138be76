"""``python -m tools.benchmarks``, which ``tools/bench`` runs."""

import sys

from friction_hil.cli import exit_status
from tools.benchmarks.commands import command

sys.exit(exit_status(command, None, "tools/bench"))
