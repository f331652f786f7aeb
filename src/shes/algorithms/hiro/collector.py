"""The collector: plays episodes in lockstep with exploration noise, and yields their transitions.

Experience is collected in the process that learns, because the policies change between control steps. All randomness
comes from one generator, so that a generation depends on its seed alone.

N environments, O observed values, A controls.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from shes.algorithms.hiro.levels import Level
from shes.algorithms.hiro.replay import Rows
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import DivergenceError
from shes.es.level import LevelParameters
from shes.es.statistics import normalise
from shes.types import BoolArray, F32Array, F64Array, IntArray


class Actor:
    """A level's actor, which explores."""

    def __init__(self, level: Level, clip: float) -> None:
        """Prepare `level`, whose normalised inputs are clipped to plus and minus `clip`."""
        self._policy, self._clip = level.actor, clip
        self.limit = np.array(level.hyperparameters.half_range)
        self._std = np.array(level.exploration_std)
        self.is_random = False
        """Whether outputs are uniform in their range."""

    def use(self, parameters: LevelParameters) -> None:
        """Act by these parameters from now on."""
        self._layers = self._policy.layers(parameters.theta[None])
        self._normalisation = parameters.mean, parameters.inverse_std

    def act(self, inputs: F64Array, rng: np.random.Generator) -> F64Array:
        """Return the outputs with exploration noise [N, A], in units of the environment, for inputs [N, O]."""
        shape = (len(inputs), len(self.limit))
        if self.is_random:
            return rng.uniform(-self.limit, self.limit, shape)
        scaled = normalise(inputs, *self._normalisation, self._clip)
        output = self._policy.forward(self._layers, scaled[None])[0] * self.limit
        return np.clip(output + self._std * rng.standard_normal(shape), -self.limit, self.limit)


@dataclass
class Collected:
    """Steps, returns and times of the episodes of a generation."""

    num_steps: int = 0
    episodes: list[Mapping[str, float]] = field(default_factory=list)
    """Return of each level, score, success, steps and flags of every finished episode, by column name."""
    goal_distances: list[float] = field(default_factory=list)
    """Distance left to the goal at the end of each interval."""
    physics_s: float = 0.0
    """Seconds in the simulation."""
    rollout_s: float = 0.0
    """Seconds in all of the collection, the simulation included."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """A control step of the running episodes."""

    rows: IntArray
    """Their rows among the N environments [running]."""
    observation: F64Array
    """Observations before the step [N, O]."""
    control: F64Array
    """Controls [N, A]."""
    is_sound: BoolArray
    """Whether the simulation has not diverged [running]."""
    terminated: BoolArray
    """Whether the episode is in a terminal state now [running]."""
    ended: BoolArray
    """Whether it has ended, for whatever reason [running]."""


class Collector:
    """Collects the transitions of a flat policy."""

    def __init__(
        self,
        batch: EpisodeBatch,
        actors: Mapping[str, Actor],
        horizon: int,
        *,
        bootstraps: bool,
        reward_scale: float = 1.0,
    ) -> None:
        """Play in `batch` with `actors`, by level. The environment's reward is multiplied by `reward_scale`.

        With `bootstraps`, values are bootstrapped from terminal states, too.
        """
        self._batch, self._actors, self._horizon = batch, actors, horizon
        self._bootstraps, self._reward_scale = bootstraps, reward_scale
        self._steps: IntArray = np.zeros(batch.num_episodes, np.int64)
        self._observation: F64Array = np.zeros((batch.num_episodes, batch.observation_size))
        self.summary = Collected()

    def run(self, num_steps: int, seeds: Iterator[int], rng: np.random.Generator) -> Iterator[dict[str, Rows]]:
        """Yield the new transitions of each level after every control step.

        Episodes begin until `num_steps` have been made; the generation ends when the last of them has ended.

        Raises:
            DivergenceError: A reward or an observation is too large for single precision.
        """
        batch, self.summary = self._batch, Collected()
        running = np.arange(batch.num_episodes)
        start, physics_s = perf_counter(), batch.physics_s
        self.begin(running, seeds, rng)
        while len(running):
            step = self._step(running, rng)
            transitions = self.transitions(step, rng)
            self._finish(running[step.ended])
            self.summary.num_steps += len(running)
            self.summary.rollout_s += perf_counter() - start
            yield transitions
            start = perf_counter()
            again = running[step.ended] if self.summary.num_steps < num_steps else running[:0]
            running = np.union1d(running[~step.ended], again)
            if len(again):
                self.begin(again, seeds, rng)
        self.summary.physics_s = batch.physics_s - physics_s

    def _step(self, rows: IntArray, rng: np.random.Generator) -> Step:
        """Advance the episodes in `rows` by one control step."""
        batch, before, control = self._batch, self._observation, self.control(rng)
        batch.step(rows, control)
        self._steps[rows] += 1
        self.observe()
        is_sound = ~batch.diverged[rows]
        has_ended = batch.terminated[rows] & is_sound
        terminated = has_ended & ~batch.truncated[rows]
        ended = has_ended | ~is_sound | (self._steps[rows] >= self._horizon)
        return Step(
            rows=rows, observation=before, control=control, is_sound=is_sound, terminated=terminated, ended=ended
        )

    def _finish(self, rows: IntArray) -> None:
        """Record the outcomes of the episodes in `rows`."""
        batch = self._batch
        for row in rows.tolist():
            has_diverged = bool(batch.diverged[row])
            returns = {f"{name}_return": float(values[row]) for name, values in self.returns().items()}
            self.summary.episodes.append(
                {
                    **returns,
                    "score": float(batch.score[row]),
                    "success": float(batch.success[row]),
                    "steps": float(self._steps[row]),
                    "terminated": float(batch.terminated[row] and not (batch.truncated[row] or has_diverged)),
                    "diverged": float(has_diverged),
                }
            )

    def begin(self, rows: IntArray, seeds: Iterator[int], rng: np.random.Generator) -> None:
        """Start new episodes in `rows`."""
        self._batch.reset(rows, [next(seeds) for _ in rows])
        self._steps[rows] = 0
        self.observe()

    def observe(self) -> None:
        """Copy the current observations."""
        self._observation = self._batch.observe().copy()

    def control(self, rng: np.random.Generator) -> F64Array:
        """Return the controls of a step [N, A]."""
        return self._actors["policy"].act(self._observation, rng)

    def transitions(self, step: Step, rng: np.random.Generator) -> dict[str, Rows]:
        """Return the transitions that `step` has completed, by level. New goals are drawn from `rng`."""
        goes_on = self.goes_on(step.terminated)
        return {"policy": self.rows(step, step.observation, self.reward(), goes_on, self._observation)}

    def rows(
        self, step: Step, inputs: F64Array, reward: F64Array, goes_on: BoolArray, next_inputs: F64Array
    ) -> dict[str, F32Array]:
        """Return the transitions of the acting level as float32, without those of diverged simulations."""
        kept = step.rows[step.is_sound]
        rows = {
            "inputs": inputs[kept],
            "action": step.control[kept],
            "reward": reward[kept],
            "goes_on": goes_on[step.is_sound],
            "next_inputs": next_inputs[kept],
        }
        return as_float32(rows)

    def reward(self) -> F64Array:
        """Return the environment's scaled reward of the last step [N]."""
        with _no_overflow():
            return self._batch.reward * self._reward_scale

    def goes_on(self, terminated: BoolArray) -> BoolArray:
        """Return for each transition whether its next state has a value: the return is not cut there [n]."""
        return ~terminated | self._bootstraps

    def returns(self) -> dict[str, F64Array]:
        """Return the undiscounted returns of the episodes so far [N], by level."""
        return {"policy": self._batch.running_return}


def as_float32(rows: Mapping[str, F64Array | BoolArray]) -> dict[str, F32Array]:
    """Return transitions as float32; raise DivergenceError if that cannot hold a value."""
    with _no_overflow():
        return {name: values.astype(np.float32) for name, values in rows.items()}


@contextmanager
def _no_overflow() -> Iterator[None]:
    """Raise DivergenceError if a number becomes too large."""
    try:
        with np.errstate(over="raise"):
            yield
    except FloatingPointError as error:
        raise DivergenceError(
            "a reward or an observation is larger than 3.4e38, the most that single precision holds. Everything up to "
            "the last checkpoint is kept. Lower --reward-scale, or bound what the environment returns."
        ) from error
