"""``friction-hil doctor``: checks of this machine, of a configuration, and of the connection to its drives."""
