"""``python -m tools.campaigns``, which ``tools/campaign`` runs."""

import sys

from friction_hil.cli import exit_status
from tools.campaigns.command import command

sys.exit(exit_status(command, None, "tools/campaign"))
