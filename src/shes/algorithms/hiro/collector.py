"""The collector: plays episodes in lockstep with exploration noise, and yields their transitions.

Experience is collected in the process that learns, because the policies change between control steps. All randomness
comes from one generator, so that a generation depends on its seed alone.

N environments, O observed values, V values of the primitive's view, G coordinates of a goal, A controls, c steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from shes.algorithms.hiro.agent import HiroDesign
from shes.algorithms.hiro.goal_space import goal_transition, primitive_reward
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
class _Step:
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

    def _step(self, rows: IntArray, rng: np.random.Generator) -> _Step:
        """Advance the episodes in `rows` by one control step."""
        batch, before, control = self._batch, self._observation, self.control(rng)
        batch.step(rows, control)
        self._steps[rows] += 1
        self.observe()
        is_sound = ~batch.diverged[rows]
        has_ended = batch.terminated[rows] & is_sound
        terminated = has_ended & ~batch.truncated[rows]
        ended = has_ended | ~is_sound | (self._steps[rows] >= self._horizon)
        return _Step(
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

    def transitions(self, step: _Step, rng: np.random.Generator) -> dict[str, Rows]:
        """Return the transitions that `step` has completed, by level. New goals are drawn from `rng`."""
        goes_on = self.goes_on(step.terminated)
        return {"policy": self.rows(step, step.observation, self.reward(), goes_on, self._observation)}

    def rows(
        self, step: _Step, inputs: F64Array, reward: F64Array, goes_on: BoolArray, next_inputs: F64Array
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
        return _as_float32(rows)

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


class HiroCollector(Collector):
    """Collects the transitions of a controller and its primitive.

    The first goal of an episode is the controller's. The primitive's transition at the end of an interval leads to the
    next goal. An interval that the time limit cuts short is left out.

    Deviation: in HIRO's code the goal of the first step of an episode is zero.
    """

    def __init__(
        self,
        batch: EpisodeBatch,
        actors: Mapping[str, Actor],
        horizon: int,
        design: HiroDesign,
        *,
        bootstraps: bool,
        reward_scale: float = 1.0,
    ) -> None:
        """See `Collector`; `actors` are those of `controller` and `primitive`."""
        super().__init__(batch, actors, horizon, bootstraps=bootstraps, reward_scale=reward_scale)
        n, c, size = batch.num_episodes, design.controller_interval, design.goals.size
        self._space, self._interval = design.goals, c
        self._columns = list(design.primitive_view.indices or ())
        self._goal, self._coordinates = np.zeros((n, size)), np.zeros((n, size))
        self._intrinsic_return = np.zeros(n)
        # Of the interval that is running: observation, coordinates and goal at its start, reward, and its steps.
        self._first = {"inputs": np.zeros((n, batch.observation_size)), "goal": np.zeros((n, size))}
        self._origin, self._earned = np.zeros((n, size)), np.zeros(n)
        self._played = {
            "moved": np.zeros((n, c, size)),
            "view": np.zeros((n, c, len(self._columns))),
            "actions": np.zeros((n, c, batch.action_size)),
        }

    def begin(self, rows: IntArray, seeds: Iterator[int], rng: np.random.Generator) -> None:
        """Start new episodes in `rows`, with goals."""
        super().begin(rows, seeds, rng)
        self._intrinsic_return[rows] = 0
        self._decide(rows, rng)

    def observe(self) -> None:
        """Copy the current observations and coordinates."""
        super().observe()
        self._coordinates = self._space.coordinates(self._observation, self._batch.position)

    def control(self, rng: np.random.Generator) -> F64Array:
        """Return the controls of a step [N, A], and note the step for the off-policy correction."""
        self._before, self._inputs_before = self._coordinates, self._inputs()
        control = self._actors["primitive"].act(self._inputs_before, rng)
        every, step = np.arange(len(control)), self._steps % self._interval
        self._played["moved"][every, step] = self._coordinates - self._origin
        self._played["view"][every, step] = self._observation[:, self._columns]
        self._played["actions"][every, step] = control
        return control

    def transitions(self, step: _Step, rng: np.random.Generator) -> dict[str, Rows]:
        """Return the transitions of both levels, after setting new goals where due."""
        rows = step.rows
        self._goal = goal_transition(self._goal, self._before, self._coordinates)
        reward = primitive_reward(self._goal)
        sound = rows[step.is_sound]
        self._intrinsic_return[sound] += reward[sound]
        self._earned[rows] += self.reward()[rows]
        is_over = self._steps[rows] % self._interval == 0
        self.summary.goal_distances += (-reward[rows[is_over & step.is_sound]]).tolist()
        of_controller = self._intervals(step, is_over)
        self._decide(rows[is_over & ~step.ended], rng)
        # Its rewards are negative: if a fall cut its return, it would learn to fall.
        goes_on = np.ones(len(step.terminated), dtype=bool)
        of_primitive = self.rows(step, self._inputs_before, reward, goes_on, self._inputs())
        return {"controller": of_controller, "primitive": of_primitive}

    def returns(self) -> dict[str, F64Array]:
        """Return the undiscounted returns of the episodes so far [N], by level."""
        return {"controller": self._batch.running_return, "primitive": self._intrinsic_return}

    def _inputs(self) -> F64Array:
        """Return the current inputs of the primitive [N, G + V]: the goal, then its view."""
        return np.concatenate([self._goal, self._observation[:, self._columns]], axis=1)

    def _decide(self, rows: IntArray, rng: np.random.Generator) -> None:
        """Let the controllers of episodes `rows` set new goals."""
        if not len(rows):
            return
        self._goal[rows] = self._actors["controller"].act(self._observation, rng)[rows]
        self._first["inputs"][rows], self._first["goal"][rows] = self._observation[rows], self._goal[rows]
        self._origin[rows], self._earned[rows] = self._coordinates[rows], 0

    def _intervals(self, step: _Step, is_over: BoolArray) -> dict[str, F32Array]:
        """Return the controller's transitions: the intervals that have passed, or that a terminal state has ended."""
        is_kept = step.is_sound & (is_over | step.terminated)
        kept = step.rows[is_kept]
        num_steps = (self._steps[kept] - 1) % self._interval + 1
        rows = {
            **{name: values[kept] for name, values in self._first.items()},
            "reward": self._earned[kept],
            "goes_on": self.goes_on(step.terminated[is_kept]),
            "next_inputs": self._observation[kept],
            "change": self._coordinates[kept] - self._origin[kept],
            **{name: values[kept] for name, values in self._played.items()},
            "is_step": np.arange(self._interval) < num_steps[:, None],
        }
        return _as_float32(rows)


def _as_float32(rows: Mapping[str, F64Array | BoolArray]) -> dict[str, F32Array]:
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
