"""Identification: friction, inertia, offset and gravity of an axis from recordings of its motion and torque. Pure.

The equation is the inverse one, torque = inertia a + offset + gravity(q) + friction, both sides through the same
filters. What is linear is solved for, the rest is searched for with exact gradients, dynamic models simulated
through the whole record; candidates are judged by what they predict of data that were held out.

Sources: M. Gautier, Ph. Poignet, Control Engineering Practice 9(12), 2001 (inverse dynamics, filters, decimation);
A. Janot, M. Gautier, M. Brunot, Workshop on Nonlinear System Identification Benchmarks, 2019.
"""

from friction_hil.identification.fits import Curves, Fit
from friction_hil.identification.identify import Identification, Settings, identify

__all__ = ["Curves", "Fit", "Identification", "Settings", "identify"]
