"""Identification: friction, inertia, offset and gravity of an axis from recordings of its motion and torque. Pure.

The inverse equation of motion, torque = inertia a + offset + gravity(q) + friction, is fitted with both sides passed
through the same filters. Linear parameters are projected out, the others are found by a search with exact gradients,
and dynamic models are simulated through the whole record. Candidates are compared by their error on held-out data.

Sources: M. Gautier, Ph. Poignet, Control Engineering Practice 9(12), 2001 (inverse dynamics, filters, decimation);
A. Janot, M. Gautier, M. Brunot, Workshop on Nonlinear System Identification Benchmarks, 2019.
"""

from friction_hil.identification.fits import Curves, Fit
from friction_hil.identification.identify import Identification, identify, plausible_fits
from friction_hil.identification.settings import FitStep, IdentificationSettings

__all__ = ["Curves", "Fit", "FitStep", "Identification", "IdentificationSettings", "identify", "plausible_fits"]
