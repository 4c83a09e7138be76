"""The demonstration: a circle without and with compensation and after learning, by real processes on a virtual bus."""
