"""``python -m tools.benchmarks``, which ``tools/bench`` runs."""

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the program itself; numpy reads it when it is imported

from friction_hil.cli import exit_status
from tools.benchmarks.commands import command

sys.exit(exit_status(command, None, "tools/bench"))
