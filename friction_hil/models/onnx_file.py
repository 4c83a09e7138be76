"""Export of a trained network to ONNX, for drives and controllers: one sample, in double precision.

Inputs are ``velocity``, ``dt`` and the other inputs of the network, each of shape (1,), SI, and ``state``, initially
zero. Outputs are ``torque`` (1,) and ``next_state``, which is the ``state`` of the next sample. The steps of a gated
network within a sample are an ONNX Loop.
"""

from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.friction import FrictionModel, Network, network
from friction_hil.numerics.jit import Array

_OPSET, _IR_VERSION = 17, 8  # old versions, which the runtimes of controllers support


def write(model: FrictionModel, path: Path) -> None:
    """Write the step of a network, without base model and modifiers, as an ONNX file.

    Raises `UsageError`: the package onnx is not installed, or the model is not a network, or has a base model or
    modifiers; `FrictionHilError`: the file cannot be written.
    """
    try:
        import onnx  # imported here: an optional dependency
    except ImportError:
        raise UsageError("ONNX needs another package: pip install 'friction-hil[onnx]'") from None
    if model.network is None or model.network.is_residual or model.modifiers:
        raise UsageError("only a network that stands alone, without base model and modifiers, can be written as ONNX")
    graph = _make_graph(model.network, _Graph(onnx))
    proto = onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid("", _OPSET)], producer_name="friction_hil"
    )
    proto.ir_version = _IR_VERSION
    onnx.checker.check_model(proto)
    try:
        path.write_bytes(proto.SerializeToString())
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


class _Graph:
    """Operations of a graph; the results are named by consecutive numbers.

    ``onnx``: the package. ``outer``: graph that contains this one as the body of a loop; its constants are shared.
    """

    def __init__(self, onnx: Any, outer: "_Graph | None" = None) -> None:
        self.onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = [] if outer is None else outer.constants
        self._prefix = "r" if outer is None else "s"

    def number(self, values: Any, kind: Any = np.float64) -> str:
        """Add a constant; return its name."""
        name = f"c{len(self.constants)}"
        self.constants.append(self.onnx.numpy_helper.from_array(np.atleast_1d(np.asarray(values, dtype=kind)), name))
        return name

    def do(self, operation: str, *inputs: str, name: str | None = None, **attributes: Any) -> str:
        """Add an operation; return the name of its result."""
        result = f"{self._prefix}{len(self.nodes)}" if name is None else name
        self.nodes.append(self.onnx.helper.make_node(operation, list(inputs), [result], **attributes))
        return result

    def value(self, name: str, size: int) -> Any:
        """Describe an input or output, a vector of ``size`` doubles."""
        return self.onnx.helper.make_tensor_value_info(name, self.onnx.TensorProto.DOUBLE, [size])

    def limited(self, x: str, bound: float) -> str:
        """Limit ``x`` to +-``bound``."""
        return self.do("Max", self.do("Min", x, self.number(bound)), self.number(-bound))

    def affine(self, x: str, factor: Any, offset: Any = 0.0) -> str:
        """Compute factor x + offset."""
        return self.do("Add", self.do("Mul", x, self.number(factor)), self.number(offset))

    def product(self, x: str, matrix: Array) -> str:
        """Multiply a vector (n,) by a matrix (n, m); the result is (m,)."""
        return self.do("MatMul", x, self.number(matrix))

    def part(self, x: str, begin: int, end: int) -> str:
        """Extract the elements of a vector from ``begin`` to before ``end``."""
        return self.do("Slice", x, self.number([begin], np.int64), self.number([end], np.int64))

    def asinh(self, x: str) -> str:
        """Compute the inverse hyperbolic sine, which runtimes offer in single precision only."""
        size = self.do("Abs", x)
        root = self.do("Sqrt", self.affine(self.do("Mul", x, x), 1.0, 1.0))
        return self.do("Mul", self.do("Sign", x), self.do("Log", self.do("Add", size, root)))


class _Weights:
    """Reader of the weights of a network, in the order of `friction_hil.friction.network`."""

    def __init__(self, weights: Array) -> None:
        self._weights, self._index = weights, 0

    def take(self, *shape: int) -> Array:
        """Return the next weights as an array of this shape."""
        count = int(np.prod(shape))
        self._index += count
        return self._weights[self._index - count : self._index].reshape(shape)


def _make_graph(trained: Network, g: _Graph) -> Any:
    structure, p = trained.structure, trained.values
    weights = _Weights(trained.weights)
    fed, is_gated = structure.states, structure.kind == "gated"
    remembered = network.MEMORIES if is_gated else network.VELOCITY_FEATURES * structure.lags
    inputs = ["velocity", "dt"]
    features, others = _inputs(g, p, trained, inputs)
    if is_gated:
        total = _steps(g, p, trained, weights, features, others)
    else:
        past = [g.part("state", fed, fed + remembered)] if remembered else []
        x, y = g.do("Concat", *features, *past, *others, axis=0), g.part("state", 0, fed) if fed else ""
        last = _layers(g, weights, trained, x, y)
        total = g.limited(_output(g, weights, trained, x, last, y), trained.bound)
        states = [total, *([g.part(y, 0, fed - 1)] if fed > 1 else [])] if fed else []
        states += [g.part(x, 0, remembered)] if remembered else []
        if states:
            g.do("Concat", *states, axis=0, name="next_state")
    g.do("Mul", g.limited(total, trained.bound), g.number(trained.torque_scale), name="torque")
    outputs, given = [g.value("torque", 1)], [g.value(name, 1) for name in inputs]
    if fed + remembered:
        given.append(g.value("state", fed + remembered))
        outputs.append(g.value("next_state", fed + remembered))
    return g.onnx.helper.make_graph(g.nodes, "friction", given, outputs, initializer=g.constants)


def _steps(g: _Graph, p: Array, trained: Network, weights: _Weights, features: list[str], others: list[str]) -> str:
    """Compute the torque of a gated network over its scale, before it is limited, by a loop over the steps."""
    helper, types = g.onnx.helper, g.onnx.TensorProto
    steps = g.affine("dt", 1.0 / trained.period_s, 0.5)
    steps = g.do("Floor", g.do("Max", g.do("Min", steps, g.number(float(network.MOST_STEPS))), g.number(1.0)))
    distance = g.do("Div", g.do("Mul", "velocity", "dt"), steps)
    tempo = g.do("Div", g.number(trained.period_s), "dt")
    body = _Graph(g.onnx, outer=g)
    carried = {"state": trained.structure.states + network.MEMORIES, "damping": 1, "torque": 1}
    state = body.do("Identity", "state_before")
    states, damping, rest = _gated(body, p, trained, weights, features, others, state, distance, tempo)
    body.do("Identity", "goes_on", name="goes_on_after")
    body.do("Concat", *states, axis=0, name="state_after")
    body.do("Add", "damping_before", damping, name="damping_after")
    body.do("Identity", rest, name="torque_after")
    flag = [helper.make_tensor_value_info(name, types.BOOL, []) for name in ("goes_on", "goes_on_after")]
    number = helper.make_tensor_value_info("step", types.INT64, [])
    inside = helper.make_graph(
        body.nodes,
        "step",
        [number, flag[0], *(g.value(f"{name}_before", size) for name, size in carried.items())],
        [flag[1], *(g.value(f"{name}_after", size) for name, size in carried.items())],
    )
    starts = ["state", g.number(0.0), g.number(0.0)]
    results = ["next_state", "damping", "rest"]
    count = g.do("Cast", steps, to=types.INT64)
    g.nodes.append(helper.make_node("Loop", [count, "", *starts], results, body=inside))
    return g.do("Add", "rest", "damping")


def _memories(g: _Graph, trained: Network, past: str, distance: str) -> tuple[str, str]:
    """Compute the stop and the distance since the start of motion or the last reversal, after the step."""
    before, travel = g.part(past, 0, 1), g.part(past, 1, 2)
    stop = g.limited(g.do("Add", before, g.affine(distance, 1.0 / trained.stroke)), 1.0)
    same = g.do("Max", g.do("Mul", g.do("Sign", distance), g.do("Sign", travel)), g.number([0.0]))
    kept = g.do("Add", g.do("Mul", same, travel), g.affine(distance, 1.0 / (network.TURN_FRACTION * trained.stroke)))
    return stop, g.limited(g.do("Mul", kept, g.do("Abs", g.do("Sign", distance))), 1.0)


def _inputs(g: _Graph, p: Array, trained: Network, names: list[str]) -> tuple[list[str], list[str]]:
    """Compute the velocity features and the other inputs of x; append the names of further graph inputs."""
    structure, limit = trained.structure, trained.speed_limit
    v = g.limited("velocity", limit)
    features = [g.affine(v, 1.0 / limit)]
    for index in range(2):
        factor = float(p[network.FEATURE_FACTORS + index])
        features.append(g.affine(g.asinh(g.affine(v, 1.0 / trained.speeds[index])), factor))
    features.append(g.do("Tanh", g.affine(v, 1.0 / trained.speeds[2])))
    others: list[str] = []
    has = (structure.has_position, structure.has_load, structure.has_temperature)
    for index, name in enumerate(("position", "load_torque", "temperature")):
        if has[index]:
            names.append(name)
            middle, half = p[network.MIDDLES + index], p[network.HALF_RANGES + index]
            others.append(g.limited(g.affine(name, 1.0 / half, -middle / half), 1.0))
    if structure.orders and not structure.has_position:
        names.append("position")
    for order in structure.orders:
        angle = g.affine("position", order)
        others += [g.do("Sin", g.affine(angle, 1.0, 0.5 * np.pi)), g.do("Sin", angle)]
    return features, others


def _layers(g: _Graph, weights: _Weights, trained: Network, x: str, y: str) -> str:
    """Compute the outputs of the last tanh layer."""
    structure = trained.structure
    width, fed = structure.hidden[0], structure.states
    sums = g.do("Add", g.number(weights.take(width)), g.product(x, weights.take(structure.inputs, width)))
    if fed:
        sums = g.do("Add", sums, g.product(y, weights.take(fed, width)))
    last = g.do("Tanh", sums)
    if len(structure.hidden) == 2:
        bias = g.number(weights.take(structure.hidden[1]))
        last = g.do("Tanh", g.do("Add", bias, g.product(last, weights.take(*structure.hidden))))
    return last


def _output(g: _Graph, weights: _Weights, trained: Network, x: str, last: str, y: str = "") -> str:
    """Compute an output from the last layer and the linear path, which includes ``y`` if it is given."""
    structure = trained.structure
    total = g.do("Add", g.number(weights.take(1)), g.product(last, weights.take(structure.hidden[-1], 1)))
    total = g.do("Add", total, g.product(x, weights.take(structure.inputs, 1)))
    return g.do("Add", total, g.product(y, weights.take(structure.states, 1))) if y else total


def _gated(
    g: _Graph,
    p: Array,
    trained: Network,
    weights: _Weights,
    features: list[str],
    others: list[str],
    state: str,
    distance: str,
    tempo: str,
) -> tuple[list[str], str, str]:
    """Compute the state after a step, the damping, and the rest of the torque, both over the torque scale."""
    fed, count = trained.structure.states, network.VELOCITY_FEATURES
    y = g.part(state, 0, fed)
    stop, travel = _memories(g, trained, g.part(state, fed, fed + network.MEMORIES), distance)
    x = g.do("Concat", *features, stop, *others, axis=0)
    last = _layers(g, weights, trained, x, y)
    each = [g.limited(_output(g, weights, trained, x, last), trained.bound) for _ in range(fed)]
    aims = g.do("Concat", *each, axis=0)
    damping = _output(g, weights, trained, x, last)
    direct = g.do("Add", g.number(weights.take(1)), g.product(x, weights.take(trained.structure.inputs, 1)))
    gates = weights.take(fed, network.GATES, network.GATE_WEIGHTS)
    speeds = g.part(x, 0, count)
    directed = g.do("Mul", stop, g.part(x, count - 1, count))
    gate_features = g.do("Concat", g.do("Mul", speeds, speeds), directed, g.do("Abs", travel), axis=0)

    def gate(number: int, half: float, middle: float) -> str:
        sums = g.do("Add", g.number(gates[:, number, 0]), g.product(gate_features, gates[:, number, 1:].T))
        return g.do("Exp", g.affine(g.do("Tanh", sums), half, middle))

    moved = g.do("Mul", gate(0, p[network.RATE_HALF], p[network.RATE_MIDDLE]), g.do("Abs", distance))
    per_knee = g.affine(gate(1, -network.KNEE_HALF, -network.KNEE_MIDDLE), 1.0 / trained.bound)
    away = g.do("Sub", aims, y)
    knees = g.do("Mul", g.do("Abs", away), per_knee)
    straight = g.do("Min", g.do("Max", g.affine(knees, 1.0, -1.0), g.number(0.0)), moved)
    begun = g.do("Div", straight, g.do("Max", knees, g.number(1.0)))
    left = g.do("Mul", g.affine(begun, -1.0, 1.0), g.do("Exp", g.do("Sub", straight, moved)))
    after = g.do("Add", y, g.do("Mul", g.affine(left, -1.0, 1.0), away))
    ones = np.ones((fed, 1))
    if fed > 1:
        ones[-1] = 0.0
    damping = g.do("Mul", damping, g.do("Mul", tempo, g.product(g.do("Sub", after, y), ones)))
    return [after, stop, travel], damping, g.do("Add", direct, g.product(after, ones))
