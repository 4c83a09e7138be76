"""Loading of an arm from a file."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.dynamics import bodies, inertial
from friction_hil.dynamics.arm import Arm
from friction_hil.dynamics.bodies import Stated
from friction_hil.dynamics.newton_euler import PARAMETERS
from friction_hil.errors import UsageError, choices
from friction_hil.numerics.jit import Array

_MOST_BYTES = 50_000_000


@dataclass(frozen=True, slots=True)
class Payload:
    """What an arm carries in addition to what its file states.

    Attributes
    ----------
    mass : float
        Mass, kg.
    center : tuple of float
        Centre of mass in the frame of the link, m.
    inertia : tuple of float
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre of mass in the axes of the link, kg m^2.
    link : str, optional
        Link or body of the file that carries it, e.g. ``tool0``; by default the one that the last joint moves.
    """

    mass: float
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    link: str | None = None


def load(
    path: str | PathLike[str],
    joints: Sequence[str] | None = None,
    *,
    signs: Iterable[float] | None = None,
    locked: Mapping[str, float] | None = None,
    gear: Mapping[str, float] | None = None,
    rotor_inertia: Mapping[str, float] | None = None,
    payload: Payload | None = None,
    gravity: ArrayLike | None = None,
) -> Arm:
    """Load an arm from a URDF or an MJCF file.

    Fixed joints are merged, and so are joints that are left out of ``joints``: they are locked. Limits, friction,
    damping and contacts of the file are not read.

    Parameters
    ----------
    path : str or os.PathLike
        File whose root element is ``<robot>`` (URDF) or ``<mujoco>`` (MJCF).
    joints : sequence of str, optional
        Joints that move, in the order of the arrays; by default all of the file, in its order.
    signs : iterable of float, optional
        1 or -1 for each of ``joints``: -1 where position and torque of the drive count against the file's joint.
    locked : mapping, optional
        Position of joints that are left out, rad or m; by default the one at which the file draws them (0 in URDF).
    gear : mapping, optional
        Turns of the motor for one of the joint, or rad per m of a prismatic one, by joint; by default 1.
    rotor_inertia : mapping, optional
        Inertia of the motor's rotor by joint, kg m^2, on the motor's side of the gear. It replaces the file's
        ``armature``.
    payload : Payload, optional
        What the arm carries.
    gravity : array_like, optional
        Acceleration of gravity in the frame of the base, shape (3,), m/s^2; by default that of the file, or
        (0, 0, -9.81) in a URDF.

    Returns
    -------
    Arm
        Its dynamics.

    Raises
    ------
    ConfigurationError
        The file has a mistake, or something that cannot be computed; the message names file, line and element.
    UsageError
        An argument does not go with the file, or the file cannot be read.
    """
    stated = _read(Path(path))
    names = bodies.choose(stated, joints)
    if payload is not None:
        stated = _with_payload(stated, names, payload)
    with np.errstate(over="ignore", invalid="ignore"):
        links = bodies.reduce(stated, names, bodies.positions(stated, names, locked or {}))
    if not all(np.isfinite(links[field]).all() for field in ("origin", "parameters", "armature")):
        raise UsageError(f"{stated.path}: its lengths, masses or inertias are too large for a number")
    for index, sign in enumerate(_signs(signs, len(names))):
        links["sign"][links["order"] == index] = sign
    for name, ratio in (gear or {}).items():
        _check(name, names, "gear", ratio, may_be_zero=False)
    for name in gear or {}:
        if name not in (rotor_inertia or {}):
            raise UsageError(f"gear: {name!r} needs a rotor_inertia, else its ratio changes nothing")
    for name, inertia in (rotor_inertia or {}).items():
        _check(name, names, "rotor_inertia", inertia, may_be_zero=True)
        links["armature"][links["order"] == names.index(name)] = (gear or {}).get(name, 1.0) ** 2 * inertia
    direction = stated.gravity if gravity is None else np.array(gravity, float)
    if direction.shape != (3,) or not np.isfinite(direction).all():
        raise UsageError(f"gravity must be three finite numbers, m/s^2, not {gravity!r}")
    return Arm(names, direction, links, stated.path)


def _read(path: Path) -> Stated:
    from friction_hil.dynamics import mjcf, urdf  # imported here: each command loads this module, few read an arm
    from friction_hil.dynamics.xml_input import parse_with_lines

    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from None
    if len(content) > _MOST_BYTES:
        raise UsageError(f"{path} is larger than {_MOST_BYTES // 1_000_000} MB: it is no URDF or MJCF of an arm")
    root, lines = parse_with_lines(content, str(path), "robot", "mujoco")
    return urdf.read(root, lines, str(path)) if root.tag == "robot" else mjcf.read(root, lines, str(path))


def _signs(signs: Iterable[float] | None, count: int) -> list[float]:
    found = [1.0] * count if signs is None else [float(each) for each in signs]
    if len(found) != count or any(each not in (1.0, -1.0) for each in found):
        raise UsageError(f"signs must be {count} numbers, each 1 or -1, not {found}")
    return found


def _check(name: str, names: Sequence[str], key: str, value: float, *, may_be_zero: bool) -> None:
    if name not in names:
        raise UsageError(f"{key}: {name!r} is no joint that moves; {choices(name, names)}")
    if not np.isfinite(value) or value < 0.0 or (value == 0.0 and not may_be_zero):
        raise UsageError(
            f"{key}: {name!r} must be finite and {'not negative' if may_be_zero else 'positive'}, not {value}"
        )


def _with_payload(stated: Stated, names: Sequence[str], payload: Payload) -> Stated:
    there = {body.name: body for body in stated.bodies}
    last = next(body.name for body in stated.bodies if any(joint.name == names[-1] for joint in body.joints))
    link = payload.link if payload.link is not None else last
    if link not in there:
        raise UsageError(f"payload: {stated.path} has no link {link!r}; {choices(link, there)}")
    center, six = np.array(payload.center, float), np.array(payload.inertia, float)
    if center.shape != (3,) or six.shape != (6,) or not np.isfinite([payload.mass, *center, *six]).all():
        raise UsageError("payload: mass, center (3 numbers) and inertia (6 numbers) must be finite")
    inertia = inertial.inertia_of(six)
    if text := inertial.mistake(payload.mass, inertia):
        raise UsageError(f"payload: {text}")
    more: Array = inertial.parameters_of(payload.mass, center, inertia)
    assert more.shape == (PARAMETERS,)
    changed = tuple(
        replace(body, parameters=body.parameters + more) if body.name == link else body for body in stated.bodies
    )
    return replace(stated, bodies=changed)
