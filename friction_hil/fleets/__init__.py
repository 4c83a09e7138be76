"""One work on the recordings of a whole fleet: identified, judged, verified or converted, and one table of it all."""

from friction_hil.fleets.run import Fleet, fleet

__all__ = ["Fleet", "fleet"]
