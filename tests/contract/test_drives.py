"""The drivers of this project and their simulated drives keep the contract of the drive port."""

import itertools
from abc import abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.contract import rig as rigs
from tests.contract.drives import DrivesContract, ServiceContract, SilentServiceContract, SimulatedDrivesContract
from tests.contract.rig import COUNTS, RATED_TORQUE, InstalledRig
from tests.peers.serial_processes import free_tcp_port

_numbers = itertools.count()


class _Both(DrivesContract, SimulatedDrivesContract):
    """A driver and its counterpart keep both contracts."""

    @abstractmethod
    def make(self, folder: Path, patch: pytest.MonkeyPatch) -> InstalledRig:
        """Make a rig whose line or bus is its own."""

    @pytest.fixture
    def rig(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[InstalledRig]:
        yield from self._made(tmp_path, monkeypatch)

    @pytest.fixture
    def another_rig(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[InstalledRig]:
        yield from self._made(tmp_path, monkeypatch)

    def _made(self, folder: Path, patch: pytest.MonkeyPatch) -> Iterator[InstalledRig]:
        made = self.make(folder / str(next(_numbers)), patch)
        try:
            yield made
        finally:
            made.close()


class TestCanopen(SilentServiceContract, _Both):
    def make(self, folder: Path, patch: pytest.MonkeyPatch) -> InstalledRig:
        return rigs.CanRig(folder)


class TestModbusRtu(_Both):
    grammar = staticmethod(rigs.modbus_rtu)

    def make(self, folder: Path, patch: pytest.MonkeyPatch) -> InstalledRig:
        keys = {"counts_per_unit": COUNTS, "rated_torque": RATED_TORQUE, **self.described()}
        axes = {"x": {"unit": 3, **keys}, "y": {"unit": 4, **keys}}
        return rigs.SerialRig("modbus", self.port(folder), axes, self.grammar, patch)

    def described(self) -> dict[str, Any]:
        return {"description": "generic_cia402"}

    def port(self, folder: Path) -> str:
        folder.mkdir()
        return str(folder / "line")


class TestModbusRtuWithoutFunction23(TestModbusRtu):
    def described(self) -> dict[str, Any]:
        return {"description": "kinco_fd5p", "torque_constant": 0.1}


class TestModbusTcp(ServiceContract, TestModbusRtu):
    grammar = staticmethod(rigs.modbus_tcp)

    def port(self, folder: Path) -> str:
        return f"tcp://127.0.0.1:{free_tcp_port()}"


class TestOdrive(SilentServiceContract, _Both):
    def make(self, folder: Path, patch: pytest.MonkeyPatch) -> InstalledRig:
        folder.mkdir()
        keys = {"description": "odrive", "torque_constant": 0.1}
        axes = {"x": {"axis": 0, **keys}, "y": {"axis": 1, **keys}}
        return rigs.SerialRig("ascii", str(folder / "line"), axes, rigs.odrive, patch)


class TestDynamixel(ServiceContract, _Both):
    def make(self, folder: Path, patch: pytest.MonkeyPatch) -> InstalledRig:
        folder.mkdir()
        keys = {"description": "xl330", "torque_constant": 0.2}
        axes = {"x": {"id": 1, **keys}, "y": {"id": 2, **keys}}
        return rigs.SerialRig("dynamixel", str(folder / "line"), axes, rigs.dynamixel, patch)
