"""The collector: plays episodes in lockstep with exploration noise, and yields their transitions.

Experience is collected in the process that learns, because the policies change between control steps. All randomness
comes from one generator, so that a generation depends on its seed alone.

N environments, O inputs of the acting level, A controls.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from shes.agents.agent import AgentDesign
from shes.agents.mlp import normalise
from shes.baselines.learner_settings import LearnerSettings
from shes.baselines.levels import Level, Network, Rows
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import DivergenceError
from shes.es.statistics import ObservationStatistics
from shes.types import BoolArray, F32Array, F64Array, IntArray


class Actor:
    """A level's actor, which explores."""

    is_random: bool = False
    """Whether outputs are uniform in their range."""

    def __init__(self, level: Level) -> None:
        self.level, self._limit = level, np.array(level.half_range)

    def use(self, network: Network, statistics: ObservationStatistics) -> None:
        """Act by `network` from now on, with inputs normalised by `statistics`."""
        self._network, self._normalisation = network, (statistics.mean, 1 / statistics.std)

    def act(self, inputs: F64Array, rng: np.random.Generator) -> F64Array:
        """Return the outputs with exploration noise [N, A], in units of the environment, for inputs [N, O]."""
        level, shape = self.level, (len(inputs), len(self._limit))
        if self.is_random:
            return rng.uniform(-self._limit, self._limit, shape)
        scaled = normalise(inputs, *self._normalisation, level.settings.input_clip)
        output = level.actor.forward(self._network, scaled) * self._limit
        return np.clip(output + level.exploration_std * rng.standard_normal(shape), -self._limit, self._limit)


@dataclass(frozen=True, kw_only=True)
class Step:
    """A control step of the running episodes."""

    rows: IntArray
    """Their rows among the N environments [running]."""
    inputs: F64Array
    """Inputs of the acting level before the step [N, O]."""
    control: F64Array
    is_sound: BoolArray
    """Whether the simulation has not diverged [running]."""
    terminated: BoolArray
    ended: BoolArray
    """Whether the episode has ended, for whatever reason [running]."""


class Collector:
    """Collects the transitions of a flat policy."""

    def __init__(
        self, batch: EpisodeBatch, design: AgentDesign, actors: Sequence[Actor], horizon: int, settings: LearnerSettings
    ) -> None:
        """Play episodes of at most `horizon` steps in `batch` with agents of `design`; the acting one comes last."""
        self.batch, self.actors, self._horizon, self._settings = batch, actors, horizon, settings
        self.steps: IntArray = np.zeros(batch.num_episodes, np.int64)
        """Control steps of each episode so far [N]."""
        self.observation: F64Array = np.zeros((batch.num_episodes, batch.observation_size))
        # Of a generation:
        self.num_steps, self.rollout_s, self.physics_s = 0, 0.0, 0.0
        """Control steps, and seconds in all of the collection and in the simulation."""
        self.episodes: list[Mapping[str, float]] = []
        """Return of each level, score, success, steps and flags of every finished episode, by name."""
        self.goal_distances: list[float] = []
        """Distance left to the goal at the end of each interval."""

    def run(self, num_steps: int, seeds: Iterator[int], rng: np.random.Generator) -> Iterator[dict[str, Rows]]:
        """Yield the new transitions of each level after every control step.

        Episodes begin until `num_steps` have been made; the generation ends when the last of them has ended.
        """
        self.num_steps, self.rollout_s, self.episodes, self.goal_distances = 0, 0.0, [], []
        running, start, physics_s = np.arange(self.batch.num_episodes), perf_counter(), self.batch.physics_s
        self.begin(running, seeds, rng)
        while len(running):
            step = self.step(running, rng)
            transitions = self.transitions(step, rng)
            self._record(running[step.ended])
            self.num_steps += len(running)
            self.rollout_s += perf_counter() - start
            yield transitions
            start = perf_counter()
            again = running[step.ended] if self.num_steps < num_steps else running[:0]
            running = np.union1d(running[~step.ended], again)
            if len(again):
                self.begin(again, seeds, rng)
        self.physics_s = self.batch.physics_s - physics_s

    def begin(self, rows: IntArray, seeds: Iterator[int], rng: np.random.Generator) -> None:
        """Start new episodes in `rows`."""
        self.batch.reset(rows, [next(seeds) for _ in rows])
        self.steps[rows] = 0
        self.observation = self.batch.observe().copy()

    def step(self, rows: IntArray, rng: np.random.Generator) -> Step:
        """Advance the episodes in `rows` by one control step."""
        batch, inputs = self.batch, self.inputs()
        control = self.actors[-1].act(inputs, rng)
        batch.step(rows, control)
        self.steps[rows] += 1
        self.observation = batch.observe().copy()
        is_sound = ~batch.diverged[rows]
        has_ended = batch.terminated[rows] & is_sound
        return Step(
            rows=rows,
            inputs=inputs,
            control=control,
            is_sound=is_sound,
            terminated=has_ended & ~batch.truncated[rows],
            ended=has_ended | ~is_sound | (self.steps[rows] >= self._horizon),
        )

    def inputs(self) -> F64Array:
        """Return the current inputs of the acting level [N, O]."""
        return self.observation

    def transitions(self, step: Step, rng: np.random.Generator) -> dict[str, Rows]:
        """Return the transitions that `step` has completed, by level. New goals are drawn from `rng`."""
        return {"policy": self.rows(step, self.reward(), self.goes_on(step.terminated))}

    def rows(self, step: Step, reward: F64Array, goes_on: BoolArray) -> Rows:
        """Return the transitions of the acting level, without those of diverged simulations."""
        kept = step.rows[step.is_sound]
        of_rows = {"inputs": step.inputs, "action": step.control, "reward": reward, "next_inputs": self.inputs()}
        rows = {name: values[kept] for name, values in of_rows.items()}
        return as_float32({**rows, "goes_on": goes_on[step.is_sound]})

    def reward(self) -> F64Array:
        """Return the environment's scaled reward of the last step [N]."""
        with np.errstate(over="ignore"):  # `as_float32` looks for infinity
            return self.batch.reward * self._settings.reward_scale

    def goes_on(self, terminated: BoolArray) -> BoolArray:
        """Return for each transition whether its next state has a value: the return is not cut there [n]."""
        return ~terminated | self._settings.bootstrap_terminal

    def returns(self) -> dict[str, F64Array]:
        """Return the undiscounted returns of the episodes so far [N], by level."""
        return {"policy": self.batch.running_return}

    def _record(self, rows: IntArray) -> None:
        if not len(rows):
            return
        batch = self.batch
        outcomes = {
            **{f"{name}_return": values for name, values in self.returns().items()},
            "score": batch.score,
            "success": batch.success,
            "steps": self.steps,
            "terminated": batch.terminated & ~batch.truncated & ~batch.diverged,
            "diverged": batch.diverged,
        }
        self.episodes += [{name: float(each[row]) for name, each in outcomes.items()} for row in rows.tolist()]


def as_float32(rows: Mapping[str, F64Array | BoolArray]) -> dict[str, F32Array]:
    """Return transitions as float32; raise DivergenceError if that cannot hold a value."""
    with np.errstate(over="ignore"):
        found = {name: values.astype(np.float32) for name, values in rows.items()}
    if not all(np.isfinite(values).all() for values in found.values()):
        raise DivergenceError(
            "a reward or an observation is NaN, or larger than 3.4e38, the most that single precision holds. "
            "Everything up to the last checkpoint is kept. Lower --reward-scale, or bound what the environment returns."
        )
    return found
