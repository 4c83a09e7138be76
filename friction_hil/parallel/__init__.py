"""Many tasks at once: in processes or threads on all cores of this machine, or on the workers of a Dask cluster."""

from friction_hil.parallel.pool import processors, run_many
from friction_hil.parallel.threads import in_parallel

__all__ = ["in_parallel", "processors", "run_many"]
