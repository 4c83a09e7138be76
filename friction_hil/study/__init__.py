"""Textbook experiments on the effects of friction, run with every model. No files, no pictures: numbers only.

>>> from friction_hil import study
>>> result = study.run(["coulomb", "lugre"])                    # doctest: +SKIP
>>> result.facts["lugre"]["presliding_um"]                      # doctest: +SKIP
"""

from friction_hil.study.run import Study, check_names, run
from friction_hil.study.subjects import StudySettings

__all__ = ["Study", "StudySettings", "check_names", "run"]
