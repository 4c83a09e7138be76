"""Errors of networks beside a physical model on data that neither was fitted to."""

from collections.abc import Sequence

import numpy as np

from friction_hil.friction import Network, NetworkStructure, network
from friction_hil.friction.network_model import INPUTS
from friction_hil.identification.data import Data, Mask
from friction_hil.identification.prediction_errors import PredictionError, prediction_error
from friction_hil.numerics.jit import Array
from friction_hil.training import averaged, checks, held_out
from friction_hil.training import thresholds as th
from friction_hil.training.contenders import Contender
from friction_hil.training.held_out import Physical
from friction_hil.training.layout import Samples
from friction_hil.training.visited import least_speed, visited


class Judge:
    """Errors of networks beside one physical model on held-out data."""

    def __init__(self, data: Data, check: Data | None, physical: Physical, seed: int) -> None:
        self._data, self._check, self._physical, self._seed = data, check, physical, seed
        top = float(np.max(np.abs(data.motion("velocity"))))
        self._slowest = min(least_speed(data.records), th.LARGEST_LEAST * top)
        self.samples = self._samples_of(data, physical.left(data))
        self._kinds = held_out.kinds(data, check)
        self._parts = next(iter(held_out.kinds(data, None).values()))
        self._left: dict[tuple[str, int], Array] = {}

    def varies(self, name: str) -> bool:
        """Return True if an input was recorded and is not constant."""
        if name == "load_torque" and any(record.load_torque is None for record in self._data.records):
            return False
        values = {"position": self.samples.position, "load_torque": self.samples.load_torque}.get(
            name, self.samples.temperature
        )
        return bool(np.isfinite(values).all() and np.ptp(values) > 0.0)

    def contender(self, label: str, inputs: tuple[str, ...] | None) -> Contender:
        """Judge the physical model with a network of these inputs, or alone if None."""
        errors, slow = {}, 0.0
        for number, (kind, masks) in enumerate(self._kinds.items()):
            data = self._data if self._check is None else self._check
            predicted = np.empty(len(data))
            if kind == held_out.OTHERS:
                left = self._physical.left(self._data)
                after = self._physical_on_others(left, inputs)
                predicted[:] = data.torque - after
            else:
                for index, mask in enumerate(masks):
                    after = self._without(kind, index, mask, masks, inputs)
                    predicted[mask] = (data.torque - after)[mask]
            errors[kind] = prediction_error(data.torque, predicted, masks)
            if number == 0:
                slow = self._slow_error(data, data.torque - predicted)
        return Contender(label, inputs, errors, slow)

    def network(self, inputs: tuple[str, ...], left: Array | None = None) -> Array:
        """Return the parameter array of the network trained on all data."""
        samples = self.samples if left is None else self.samples.with_torque(left)
        return self._as_residual(averaged.fit(_structure(inputs), samples, self._parts, seed=self._seed))

    def error_on_all(self, p: Array | None) -> PredictionError:
        """Return the error on all data of the physical model, with a network if ``p`` is given."""
        left = self.samples.torque if p is None else self.samples.torque - output(p, self.samples)
        return prediction_error(self._data.torque, self._data.torque - left)

    def _without(
        self, kind: str, index: int, mask: Mask, masks: Sequence[Mask], inputs: tuple[str, ...] | None
    ) -> Array:
        """Return what is left of the torque by models that were not fitted to the rows of a mask."""
        rows = held_out.beside(mask)
        if (kind, index) not in self._left:
            self._left[kind, index] = self._physical.left(self._data, rows)
        left = self._left[kind, index]
        if inputs is None:
            return left
        samples = self.samples.with_torque(left)
        samples = samples.weighted(np.where(rows, samples.weight, 0.0))
        parts = [each for each in masks if each is not mask]
        p = self._as_residual(averaged.fit(_structure(inputs), samples, parts, seed=self._seed))
        return left - output(p, samples)

    def _physical_on_others(self, left: Array, inputs: tuple[str, ...] | None) -> Array:
        assert self._check is not None
        others = self._physical.left(self._check)
        if inputs is None:
            return others
        return others - output(self.network(inputs, left), self._samples_of(self._check, others))

    def _as_residual(self, p: Array) -> Array:
        p[network.IS_RESIDUAL] = 1.0
        p[network.LEAST_SPEED] = min(self._slowest, th.LARGEST_LEAST * p[network.SPEED_LIMIT])
        return p

    def _samples_of(self, data: Data, left: Array) -> Samples:
        record = data.records[0]
        has_load = all(each.load_torque is not None for each in data.records)
        has_temperature = all(each.temperature is not None for each in data.records)
        starts = np.zeros(len(data))
        starts[[part.start for part in data.parts]] = 1.0
        velocity = data.motion("velocity")
        return Samples(
            record.dt * record.decimation,
            velocity,
            left,
            position=data.motion("position"),
            load_torque=data.motion("load_torque") if has_load else np.zeros(0),
            temperature=data.motion("temperature") if has_temperature else np.zeros(0),
            starts=starts,
            weight=visited(velocity, self._slowest) ** 2,
        )

    def _slow_error(self, data: Data, left: Array) -> float:
        speed = np.abs(data.motion("velocity"))
        moving = speed > 0.5 * self._slowest
        if not np.any(moving):
            return 0.0
        return float(np.mean(left[moving & (speed <= np.quantile(speed[moving], th.SLOW_ROWS))] ** 2))


def _structure(inputs: tuple[str, ...]) -> NetworkStructure:
    has_position, has_load, has_temperature = (name in inputs for name in INPUTS)
    return NetworkStructure("static", (th.MEAN_UNITS,), 0, 0, has_position, has_load, has_temperature)


def output(p: Array, samples: Samples) -> Array:
    """Return the torque of a static network over samples, (n,)."""
    return checks.simulate(
        Network.of_values(p, 1.0, is_residual=True).structure,
        p,
        samples.velocity,
        samples.dt,
        position=samples.position,
        load_torque=samples.load_torque,
        temperature=samples.temperature,
    )
