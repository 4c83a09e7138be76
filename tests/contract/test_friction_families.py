"""Every friction model keeps the contract of its library."""

from typing import Any

import friction_hil as fh
from tests.contract.friction_families import FrictionFamilyContract


class TestCoulomb(FrictionFamilyContract):
    family = "coulomb"
    has_jump = True


class TestStribeck(FrictionFamilyContract):
    family = "stribeck"
    has_jump = True


class TestKarnopp(FrictionFamilyContract):
    family = "karnopp"
    has_jump = True
    cannot_move = frozenset({"stick_velocity"})


class TestPowerLaw(FrictionFamilyContract):
    family = "power_law"
    has_jump = True


class TestTable(FrictionFamilyContract):
    family = "table"
    has_jump = True
    least_compared = 0  # it has points, which test_models_gradient.py moves one by one


class TestArmstrong(FrictionFamilyContract):
    family = "armstrong"
    has_jump = True

    def settling(self) -> Any:
        """See the contract: without rising static friction, which depends on the rest before."""
        return self.example(static_rested=self.example().parameters["static_released"])


class TestDahl(FrictionFamilyContract):
    family = "dahl"


class TestLugre(FrictionFamilyContract):
    family = "lugre"


class TestElastoPlastic(FrictionFamilyContract):
    family = "elasto_plastic"


class TestGms(FrictionFamilyContract):
    family = "gms"


class TestBoucWen(FrictionFamilyContract):
    family = "bouc_wen"

    def differentiable(self) -> Any:
        """See the contract: an exponent of 1 is a bound."""
        return self.example(exponent=1.3)


def test_every_family_has_its_class() -> None:
    assert sorted(each.family for each in FrictionFamilyContract.__subclasses__()) == fh.models.names()
