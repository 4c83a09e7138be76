"""The demonstration: a circle without and with compensation, by real processes on a virtual bus."""
