"""Process that starts others for the loop, so that the loop never waits for a fork.

A fork of the control process, which has a hundred megabytes, holds the loop up for half a period, and on a busy machine
for much longer. The *spawner* (``python -m friction_hil.daemon.spawner``) is small, runs at ordinary priority, and is
started before the loop. `friction_hil.daemon.spawner.client.Spawner` asks it over a socket, without waiting.
"""

ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    # glibc raises this threshold with each large block that is freed; later blocks of that size then leave gaps in the
    # heap, which grows for hours
    "MALLOC_MMAP_THRESHOLD_": "131072",
}
