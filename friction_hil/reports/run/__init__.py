"""Pictures and interactive pages of one recorded run."""
