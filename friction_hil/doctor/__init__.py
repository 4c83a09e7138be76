"""``friction-hil doctor``: checks of this machine, and of the connection to the drives."""
