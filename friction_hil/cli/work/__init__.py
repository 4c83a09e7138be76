"""The work of the commands, one module each; imported when a command runs, not for its help."""
