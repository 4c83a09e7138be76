"""The machine `two_link_arm` with the same arm as a URDF beside it: as files, and as a loop over simulated drives."""

import copy
import functools
import operator
from pathlib import Path

import numpy as np
import yaml

from friction_hil.checked_yaml.text import dump
from friction_hil.config import load, self_contained
from friction_hil.config.simulation import coupled_servos
from friction_hil.daemon.arm import ArmTorques
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.safety import LoopState
from tests.servo_drives import ServoDrives, make_loop

MACHINE = Path(__file__).parents[1] / "config/machines/two_link_arm.yaml"
NONE = 'ixy="0" ixz="0" iyz="0"'
URDF = f"""<robot name="two_links">
<link name="base"/>
<link name="upper">
<inertial><origin xyz="0 0 -0.22"/><mass value="4.5"/><inertia ixx="0.08" iyy="0.08" izz="0.001" {NONE}/></inertial>
</link>
<link name="fore">
<inertial><origin xyz="0 0 -0.13"/><mass value="2.2"/><inertia ixx="0.03" iyy="0.03" izz="0.001" {NONE}/></inertial>
</link>
<link name="tool">
<inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" {NONE}/></inertial>
</link>
<joint name="joint1" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 -1 0"/></joint>
<joint name="joint2" type="continuous"><parent link="upper"/><child link="fore"/>
<origin xyz="0 0 -0.4"/><axis xyz="0 -1 0"/></joint>
<joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 -0.35"/></joint>
</robot>
"""
ARM = {
    "file": "arm.urdf",
    "joints": {"shoulder": "joint1", "elbow": "joint2"},
    "rotor_inertia": {"shoulder": 0.45, "elbow": 0.12},
}
INTEGRATION_HZ = 8000.0
NAMES = tuple(ARM["joints"])
DRIVE_INERTIA = {"shoulder": 1.45, "elbow": 0.31}  # what the simulated drives feed forward: at an elbow of 90 degrees


def gravity(shoulder, elbow):
    """Weight on both joints, N m, in closed form."""
    fore = 9.81 * (2.2 * 0.13 + 1.0 * 0.35) * np.sin(shoulder + elbow)
    return np.array([9.81 * (4.5 * 0.22 + 3.2 * 0.4) * np.sin(shoulder) + fore, fore])


@functools.cache
def _values():
    return yaml.safe_load(dump(self_contained(load(MACHINE))))


def values(arm=ARM, **changes):
    """The machine's file as plain values, without gravity in its models; ``axes__elbow__mode=...`` reaches into it."""
    data = copy.deepcopy(_values())
    for axis in data["axes"].values():
        del axis["model"]["mechanics"]["gravity"]
    if arm is not None:
        data["arm"] = arm
    for path, value in changes.items():
        *steps, last = path.split("__")
        functools.reduce(operator.getitem, steps, data)[last] = value
    return data


def write(folder, arm=ARM, urdf=URDF, **changes):
    """Write configuration and URDF into a folder; return the path of the configuration."""
    (folder / "arm.urdf").write_text(urdf)
    path = folder / "machine.yaml"
    path.write_text(dump(values(arm, **changes)))
    return path


def machine(folder, arm=ARM, **changes):
    """The configuration of the arm, loaded from its files."""
    return load(write(folder, arm, **changes))


class Arm:
    """A run of the loop over the simulated drives of a configuration, from a pose, in this process."""

    def __init__(self, configuration, pose=(0.8, 0.7), *, axis=AxisLoop, on_loop=None, drives=None, **settings):
        of_drives = {name: settings.pop(name) for name in ("disturb", "power_off_cycles") if name in settings}
        self.config, arm = configuration, configuration.arm
        self.drives = ServoDrives(configuration, **of_drives) if drives is None else drives
        servos = [each.simulation for each in configuration.axes.values()]
        servos = [each.model_copy(update={"integration_hz": INTEGRATION_HZ}) for each in servos]
        self.drives.servos = list(coupled_servos(configuration.simulation.mechanism, servos, pose).servos)
        for servo in self.drives.servos:
            servo.set_period(configuration.period_s)

        def made(name, *arguments):
            return axis(name, *arguments, is_of_arm=arm is not None and name in arm.joints)

        loop, self.sink, self.axes = make_loop(configuration, self.drives, axis=made, **settings)
        if arm is not None:
            loop._arm = ArmTorques(arm, self.axes)
        if on_loop is not None:
            on_loop(loop)
        self.result = loop.run()

    def columns(self, name):
        """A column of both joints, (n, 2)."""
        return np.stack([self.sink.column(axis, name) for axis in NAMES], axis=1)

    @property
    def states(self):
        return np.array(self.sink.column(NAMES[0], "state"))

    def error(self):
        """Following error of both joints while they run."""
        return (self.columns("position_demand") - self.columns("position"))[self.states == LoopState.RUNNING]

    def sent(self):
        """Torques as sent, (n, 2)."""
        return np.array([[torque for _, _, torque in sent] for sent in self.drives.sent]).T
