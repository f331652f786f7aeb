"""HIRO: two levels of TD3 that learn from one stream of experience, with the off-policy correction.

A controller sets a goal in the robot's own coordinates every c steps, and a primitive pursues it. Agents act by NumPy
alone, so that a run can be evaluated and drawn without JAX.

N environments, O observed values, V values of the primitive's view, G coordinates of a goal, A controls.

Source: Nachum et al. 2018, Algorithm 1, section 3 and appendix C.1; its published code.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from shes.agents.agent import AgentBatch, AgentDesign, AgentInputs
from shes.agents.mlp import RectifiedMLP
from shes.agents.views import ColumnsView
from shes.algorithms.contract import Problem
from shes.baselines.collector import Collector, Step, as_float32
from shes.baselines.learner_settings import GoalSettings
from shes.baselines.levels import Level, Rows
from shes.baselines.td3 import TD3, check_problem
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError
from shes.settings import Settings
from shes.types import BoolArray, F32Array, F64Array, IntArray


class _HiroAgent(AgentBatch["HiroDesign"]):
    """HIRO's agents, in P lanes of R episodes each.

    The goal is stored as the coordinates that it leads to, s_t + g_t. Subtracting the current coordinates is the goal
    transition h(s, g, s') = s + g - s'.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        design, rows, xp = self.design, self.num_rows, self.xp
        self._limit = xp.asarray(design.half_range)
        self._target: F64Array = xp.zeros((rows, design.decision_size))
        self.goal = self._target[:, :2]
        self._inputs: F64Array = xp.zeros((rows, design.observation_sizes[-1]))
        self._view = design.primitive_view.on(xp)
        self.controller_inputs = self._seen = xp.zeros((rows, design.observation_sizes[0]))

    def act(self, inputs: AgentInputs) -> F32Array:
        design, size, observation = self.design, self.design.decision_size, inputs.observation
        coordinates = design.coordinates(observation, inputs.position)
        is_due = self.clock % design.controller_interval == 0
        if is_due.any():
            due = slice(None) if is_due.all() else np.flatnonzero(is_due)
            rows = self.rows(due)
            self._seen[rows] = observation[rows]
            output = self.levels[0].act(observation[rows], inputs.decision_noise, rows, due)
            self._target[rows] = coordinates[rows] + output * self._limit
        self.clock += 1
        self._inputs[:, :size] = self._target - coordinates
        self._view.write(observation, inputs.heading, self._inputs[:, size:])
        return self.levels[-1].act(self._inputs, inputs.control_noise)


@dataclass(frozen=True, kw_only=True)
class HiroDesign(AgentDesign):
    """Design of HIRO's agent.

    A goal is the change of the first of the robot's own coordinates. The primitive observes the goal, seen from the
    current state, and then its view. A rollout does not compute its intrinsic reward, which depends on all coordinates
    of a goal, and adds no exploration noise.
    """

    agent = _HiroAgent
    primitive_view: ColumnsView
    half_range: tuple[float, ...]
    """Largest goal in each coordinate [G], in metres and radians."""
    columns: tuple[int, ...] | None
    """Indices of the coordinates in the observation; None for the position of an environment that observes none."""

    def coordinates(self, observation: F64Array, position: F64Array) -> F64Array:
        """Return the coordinates [N, G] of robots with these observations [N, O] and positions [N, 2], a copy."""
        return position.copy() if self.columns is None else observation[:, list(self.columns)]

    def exported(self) -> dict[str, Any]:
        """Return how often a goal is set, and the coordinates that it concerns."""
        goals = {"columns": self.columns, "half_range": self.half_range, "view": self.primitive_view.indices}
        return {"controller_interval": self.controller_interval, "state_goals": goals}


class _HiroCollector(Collector):
    """Collects the transitions of a controller and its primitive.

    The first goal of an episode is the controller's. The primitive's transition at the end of an interval leads to the
    next goal. An interval that the time limit cuts short is left out.

    Deviation: in HIRO's code the goal of the first step of an episode is zero.
    """

    def __init__(self, batch: EpisodeBatch, design: HiroDesign, *arguments: Any) -> None:
        super().__init__(batch, design, *arguments)
        self._design, self._interval = design, design.controller_interval
        self._columns = list(design.primitive_view.indices or ())

        def zeros(*names: str) -> dict[str, F64Array]:
            shapes = self.actors[0].level.replay.shapes
            return {name: np.zeros((batch.num_episodes, *shapes[name])) for name in names}

        self._goal, self._coordinates, self._origin = (zeros("goal")["goal"] for _ in range(3))
        self._intrinsic_return, self._earned = (np.zeros(batch.num_episodes) for _ in range(2))
        # Of the interval that is running: observation and goal at its start, and its steps. Likewise `_origin`, the
        # coordinates at its start, and `_earned`, its reward.
        self._first, self._played = zeros("inputs", "goal"), zeros("moved", "view", "actions")

    def begin(self, rows: IntArray, seeds: Iterator[int], rng: np.random.Generator) -> None:
        super().begin(rows, seeds, rng)
        self._coordinates = self._design.coordinates(self.observation, self.batch.position)
        self._intrinsic_return[rows] = 0
        self._decide(rows, rng)

    def inputs(self) -> F64Array:
        """Return the current inputs of the primitive [N, G + V]: the goal, then its view."""
        return np.concatenate([self._goal, self.observation[:, self._columns]], axis=1)

    def step(self, rows: IntArray, rng: np.random.Generator) -> Step:
        """Advance the episodes in `rows` by one control step, and note it for the off-policy correction."""
        before, place = self._coordinates, (np.arange(len(self.steps)), self.steps % self._interval)
        step = super().step(rows, rng)
        self._coordinates = self._design.coordinates(self.observation, self.batch.position)
        self._played["moved"][place] = before - self._origin
        self._played["view"][place] = step.inputs[:, self._design.decision_size :]
        self._played["actions"][place] = step.control
        self._goal = before + self._goal - self._coordinates  # the goal transition h(s, g, s')
        return step

    def transitions(self, step: Step, rng: np.random.Generator) -> dict[str, Rows]:
        """Return the transitions of both levels, after setting new goals where due."""
        rows, reward = step.rows, -np.sqrt(np.vecdot(self._goal, self._goal))  # minus the distance left to the goal
        sound = rows[step.is_sound]
        self._intrinsic_return[sound] += reward[sound]
        self._earned[rows] += self.reward()[rows]
        is_over = self.steps[rows] % self._interval == 0
        self.goal_distances += (-reward[rows[is_over & step.is_sound]]).tolist()
        of_controller = self._intervals(step, is_over)
        self._decide(rows[is_over & ~step.ended], rng)
        # The primitive's rewards are negative: if a fall cut its return, it would learn to fall.
        of_primitive = self.rows(step, reward, np.ones(len(rows), dtype=bool))
        return {"controller": of_controller, "primitive": of_primitive}

    def returns(self) -> dict[str, F64Array]:
        return {"controller": self.batch.running_return, "primitive": self._intrinsic_return}

    def _decide(self, rows: IntArray, rng: np.random.Generator) -> None:
        if not len(rows):
            return
        self._goal[rows] = self.actors[0].act(self.observation, rng)[rows]
        self._first["inputs"][rows], self._first["goal"][rows] = self.observation[rows], self._goal[rows]
        self._origin[rows], self._earned[rows] = self._coordinates[rows], 0

    def _intervals(self, step: Step, is_over: BoolArray) -> Rows:
        """Return the controller's transitions: the intervals that have passed, or that a terminal state has ended."""
        is_kept = step.is_sound & (is_over | step.terminated)
        kept = step.rows[is_kept]
        num_steps = (self.steps[kept] - 1) % self._interval + 1
        rows = {
            **{name: values[kept] for name, values in self._first.items()},
            "reward": self._earned[kept],
            "goes_on": self.goes_on(step.terminated[is_kept]),
            "next_inputs": self.observation[kept],
            "change": self._coordinates[kept] - self._origin[kept],
            **{name: values[kept] for name, values in self._played.items()},
            "is_step": np.arange(self._interval) < num_steps[:, None],
        }
        return as_float32(rows)


class HIRO(TD3):
    """Trains controller and primitive by gradients. Source: Nachum et al. 2018."""

    level_names: ClassVar[tuple[str, ...]] = ("controller", "primitive")
    sections: ClassVar[Mapping[str, type[Settings]]] = {**TD3.sections, "goals": GoalSettings}
    collector: ClassVar[type[Collector]] = _HiroCollector
    design: HiroDesign

    def make_design(self, problem: Problem) -> HiroDesign:
        """Return the design of the agents; raise ConfigError if HIRO cannot learn in this problem.

        Deviation: the primitive sees the robot without x and y, and the time; in HIRO x and y are zero.
        """
        own, goals, task = problem.settings.learner, problem.settings.goals, check_problem(problem)
        if goals.controller_interval > problem.horizon:
            raise ConfigError(
                f"controller_interval is {goals.controller_interval}, but episodes have {problem.horizon} steps "
                "(horizon): the controller would never learn. Set --controller-interval lower, or --horizon higher."
            )
        task.check_position()
        half_range = (*(goals.goal_distance,) * 2, *(task.robot.goal_half_range if task.robot else ()))
        time = [i for i, name in enumerate(task.observation_names) if name == "time"]
        seen = [i for i in (*task.proprioception.tolist(), *time) if i not in task.position_columns]
        return HiroDesign(
            networks={
                "controller": RectifiedMLP(task.observation_size, own.hidden, len(half_range)),
                "primitive": RectifiedMLP(len(half_range) + len(seen), own.hidden, task.action_size),
            },
            controller_view=ColumnsView(),
            primitive_view=ColumnsView(seen),
            half_range=half_range,
            columns=tuple(task.proprioception[: len(half_range)].tolist()) if task.robot else None,
            control_limit=task.control_limit,
            controller_interval=goals.controller_interval,
            input_clip=own.input_clip,
        )

    def make_levels(self) -> tuple[Level, ...]:
        """Return the controller and the primitive."""
        design, size, interval = self.design, self.design.decision_size, self.design.controller_interval
        goals, primitive = self.problem.settings.goals, design.networks["primitive"]
        controller = self.make_level(
            "controller",
            design.half_range,
            goals.goal_noise,
            goal=(size,),
            change=(size,),
            moved=(interval, size),
            view=(interval, primitive.sizes[0] - size),
            actions=(interval, primitive.sizes[-1]),
            is_step=(interval,),
        )
        return replace(controller, update_interval=goals.controller_update_interval), *super().make_levels()
