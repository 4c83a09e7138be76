"""Many tasks at once: on all cores of this machine, or on the workers of a Dask cluster."""

from friction_hil.parallel.pool import processors, run_here, run_many

__all__ = ["processors", "run_here", "run_many"]
