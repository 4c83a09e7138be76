"""The work of ``identify``, ``replay``, ``train`` and ``tune`` as functions, which the commands call too.

`friction_hil` has them as ``fh.identify``, ``fh.compare``, ``fh.verify``, ``fh.train`` and ``fh.tune``. Nothing here
prints, and nothing is written but by ``save`` and ``tune``.
"""
