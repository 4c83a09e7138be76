"""Rigid-body dynamics of an arm from its URDF or MJCF: what the motion of its joints takes in torque.

`load` reads the file; an `Arm` computes inverse dynamics, gravity, the inertia matrix, and the regressor in which its
ten inertial parameters per link are linear. Friction is not in it.

A pendulum of 2 kg whose centre is 0.3 m below the joint, with 0.02 kg m^2 about it:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> import friction_hil as fh
>>> text = '''<robot name="pendulum"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.3"/>
... <mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
... <joint name="swing" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/></joint></robot>'''
>>> with TemporaryDirectory() as folder:
...     path = Path(folder) / "pendulum.urdf"
...     _ = path.write_text(text)
...     arm = fh.dynamics.load(path)
>>> arm.gravity([[0.0], [1.57079633]]).round(3).tolist()  # N m, in two positions
[[0.0], [5.886]]
>>> arm.inertia_matrix([0.0]).round(3).tolist()  # kg m^2
[[0.2]]
>>> arm.inverse_dynamics([0.0], [0.0], [1.0]).round(3).tolist()
[0.2]
"""

from friction_hil.dynamics.arm import Arm
from friction_hil.dynamics.loading import Payload, load

__all__ = ["Arm", "Payload", "load"]
