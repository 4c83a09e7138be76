"""Networks exported to ONNX give the same torque in onnxruntime as in this library."""

import subprocess
import sys

import numpy as np
import pytest
import yaml

import friction_hil as fh
from tests.networks import STRUCTURES, alone, beside, model_file, random_network

onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")

from friction_hil.models import onnx_file  # noqa: E402 - after it is known that there is an onnx


def run(path, velocity, dt, **inputs):
    """Torque of every sample, the state fed back."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    shapes = {each.name: each.shape for each in session.get_inputs()}
    fixed = {name: np.array([value]) for name, value in {"dt": dt, **inputs}.items() if name in shapes}
    state, torque = np.zeros(shapes.get("state", [0])), []
    for v in velocity:
        fed = {"state": state} if "state" in shapes else {}
        one, *after = session.run(None, {"velocity": np.array([v]), **fixed, **fed})
        state = after[0] if after else state
        torque.append(one[0])
    return np.array(torque)


@pytest.mark.deep
@pytest.mark.parametrize("name", list(STRUCTURES))
@pytest.mark.parametrize(("size", "periods"), [(0.3, 1.0), (3.0, 1.0), (1.0, 0.3), (1.0, 2.6), (1.0, 40.0)])
def test_onnxruntime_gives_our_torque(name, size, periods, tmp_path):
    if "narx" in name and periods != 1.0:
        pytest.skip("a narx runs at one period")
    model, path = alone(random_network(name, seed=3, size=size)), tmp_path / "net.onnx"
    onnx_file.write(model, path)
    velocity = 0.05 * np.cumsum(np.random.default_rng(0).standard_normal(400))
    velocity[100:150] = 0.0
    velocity[200] = 50.0
    inputs = {"position": 0.4, "load_torque": -0.1, "temperature": 70.0}
    dt = periods * model.network.period_s
    wanted = model.simulate(velocity, dt, **inputs)
    assert np.abs(run(path, velocity, dt, **inputs) - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_what_is_no_network_alone_is_refused(tmp_path):
    for model in (beside(random_network(is_residual=True)), fh.models.create("coulomb", coulomb=0.1)):
        with pytest.raises(fh.errors.UsageError, match="alone"):
            onnx_file.write(model, tmp_path / "net.onnx")


def test_convert_writes_it(tmp_path):
    net, target = tmp_path / "net.yaml", tmp_path / "net.onnx"
    net.write_text(yaml.safe_dump(model_file(random_network())))
    command = [sys.executable, "-m", "friction_hil", "convert", str(net), str(target)]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    wanted = alone(random_network()).simulate([0.1, 0.2, -0.1], 2e-3)
    np.testing.assert_allclose(run(target, [0.1, 0.2, -0.1], 2e-3), wanted, rtol=1e-6)
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 2
    assert "--force" in again.stderr
