"""The settings of the paper's experiments: the method as published and with the learning changes, and the scales."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from experiments.design import SMOKE
from shes.runs.make_config import make_config

TASKS = ("gather", "maze", "push")
PUBLISHED, PIECES = "published", "pieces"
STEPS: Mapping[str, tuple[str, ...]] = {
    "point": ("views", "branches", "ties"),
    "ant": ("views", "symmetry", "branches", "gait", "goals", "equivariant"),
}
"""Forms between the two, by body: each has the changes of those before it."""
STEPS_TASK = "gather"

REFERENCES = {
    "ant-gather": {"SHES (paper)": 3.74, "HIRO 2018": 3.02, "SNN4HRL": 1.92, "VIME": 1.42, "FuN, cosine": 0.85},
    "ant-maze": {"HIRO 2018": 0.99, "FuN, cosine": 0.16, "SNN4HRL, VIME": 0.0},
    "ant-push": {"HIRO 2018": 0.92, "FuN, transition PG": 0.56, "SNN4HRL, VIME": 0.02},
}
"""Published scores, with their source: Nachum et al. 2018, Table 1 (of FuN the variant that is best on the task); SHES
paper, 1.24 times HIRO's."""

_BRANCHES = {"primitive_estimate": "interval", "intervals": 2}
_VIEWS = {"primitive_view": "egocentric", "goal_encoding": "angle_metres"}
_PLAIN = {"output_weights": "zero", "weight_decay": 0.0}
# Few policies, since either form learns more from many updates than from exact ones in so few steps.
_POINT: dict[str, Any] = {"controller_interval": 10, "population_size": 40, "sigma": 0.1, "learning_rate": 0.04}
_POINT_BRANCHES = {"primitive_population_size": 400, "primitive_sigma": 0.1, "primitive_learning_rate": 0.03}
# Over preset `paper`: its size, and the task's own spread of first states, in which every method is tested.
_SMALL: dict[str, Any] = {
    "episodes_per_policy": 1,
    "statistics_fraction": 1.0,  # a hundredth of so few episodes would be none
    "noise_table_size": 25_000_000,
    "reset_noise": 0.1,
}
_FORMS: dict[tuple[str, str], dict[str, Any]] = {
    ("point", PUBLISHED): {**_SMALL, **_POINT, "hidden": (32,)},
    ("point", PIECES): {**_POINT, **_VIEWS, **_BRANCHES, **_PLAIN, **_POINT_BRANCHES, "minimum_goal_distance": False},
    ("ant", PUBLISHED): {**_SMALL, "hidden": (64, 64), "population_size": 40, "sigma": 0.02, "learning_rate": 0.01},
    ("ant", PIECES): {},
}
"""Settings over the preset, by body and form: as published over preset `paper`, with the changes over `laptop`, which
has them for the ant."""
_NO_SEARCH = {
    "explore": "none",
    "fitness_shaping": "centred_rank",
    "symmetry": "none",
    "controller_view": "observation",
    "controller_output": "vector",
}
"""Settings of the point's Maze and Push without what preset `laptop` has there besides."""
_CONSTANT = {"fitness_shaping": "centred_rank", "learning_rate": 0.05, "learning_rate_end": None, "practice": 0}
"""Settings of the ant's Maze and Push without what the preset has there besides."""
_POINT_ALONE = {**_POINT, **_VIEWS, **_BRANCHES, **_PLAIN, "population_size": 400, "learning_rate": 0.03}
"""With the changes, for the point's primitive that is trained alone."""
_PIECES = (
    *("primitive_view", "symmetry", "goal_encoding", "clock_frequency", "primitive_estimate", "intervals"),
    *("fall_price", "output_weights", "weight_decay", "controller_view", "controller_output"),
    *("controller_network", "explore", "explore_horizon", "target"),
    *("controller_interval", "minimum_goal_distance", "primitive_population_size", "primitive_sigma"),
    *("primitive_learning_rate", "max_tilt"),
)
"""Settings that are learning changes; the others of a preset say how large networks and population are."""
_OF_BRANCHES_ALONE = ("population_size", "sigma", "learning_rate")
"""Settings of branched pairs where no controller is trained with them."""
_STEP_NAMES = {
    "views": ("primitive_view", "goal_encoding"),
    "symmetry": ("symmetry",),
    "branches": (
        *("primitive_estimate", "intervals", "primitive_population_size", "primitive_sigma"),
        "primitive_learning_rate",
    ),
    "ties": ("output_weights", "weight_decay"),
    "gait": ("clock_frequency", "fall_price", "output_weights", "weight_decay"),
    "goals": ("controller_interval", "controller_output", "minimum_goal_distance"),
    "equivariant": ("controller_view", "controller_network", "hidden", "primitive_hidden"),
}
"""Settings of the form with the changes that each step adds to the form as published."""
OF_PRIMITIVE = ("symmetry", "goal_encoding", "clock_frequency", "intervals", "fall_price")
"""Settings, besides `primitive_...`, that come with a transferred primitive or have no effect on a frozen one."""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """The size of the experiments."""

    preset: str
    seeds: Mapping[str, int]
    """Number of seeds by body."""
    settings: Mapping[str, Any]
    episodes: int
    env_steps: Mapping[str, int] = field(default_factory=dict)
    """Environment steps of training, by environment; without, the preset's generations."""
    transfer_env_steps: Mapping[str, int] = field(default_factory=dict)
    """The same on a transferred primitive, where they are others."""
    hiro_env_steps: Mapping[str, int] = field(default_factory=dict)
    """Environment steps of HIRO; its steps take much longer, because each comes with updates."""
    evaluations: Mapping[str, int] = field(default_factory=dict)
    """Number of evaluations in a run of SHES, about, by body; without, the evaluation interval of `settings`."""
    has_fixed_target: bool = False
    """Whether every method trains Maze on its own target, as preset `laptop` does for the ant."""
    branched_population: int | None = None
    """Size of a population of branched pairs that is trained with controllers, if it is not the form's."""
    hiro: Mapping[str, Any] = field(default_factory=dict)
    """Settings of HIRO over `hiro_preset`."""
    hiro_preset: str = "laptop"
    timed_seeds: Mapping[str, int] | None = None
    """Number of seeds by body of the runs with several numbers of workers; without, `seeds`."""
    timed_env_steps: Mapping[str, int] = field(default_factory=dict)
    """Environment steps of those runs, where they are fewer: each has the machine to itself."""
    num_workers: tuple[int, ...] = (1, 2)
    """Numbers of workers that are compared."""

    def training(self, task: str) -> dict[str, Any]:
        """Return the settings of training's task that every method has."""
        target = make_config(f"ant-{task}", "laptop").values.get("target") if self.has_fixed_target else None
        return {} if target is None else {"target": target}

    def form(self, body: str, task: str, form: str) -> dict[str, Any]:
        """Return the settings of a form over its preset: of two levels, or of a primitive alone for Flagrun."""
        if form in _STEP_NAMES:
            steps = STEPS[body][: 1 + STEPS[body].index(form)]
            changed = {**self._laptop(body, task), **self.form(body, task, PIECES)}
            names = [name for step in steps for name in _STEP_NAMES[step] if name in changed]
            return {**self.form(body, task, PUBLISHED), **{name: changed[name] for name in names}}
        is_alone = (body, task, form) == ("point", "flagrun", PIECES)
        settings = dict(_POINT_ALONE if is_alone else _FORMS[body, form])
        if form == PIECES and task in ("maze", "push"):
            settings |= _NO_SEARCH if body == "point" else {**_CONSTANT, "primitive_learning_rate": 0.015}
        if self.preset == "paper" and form == PUBLISHED:
            settings = {}
        elif self.preset != "laptop" and (body, form) == ("ant", PIECES):
            laptop = self._laptop(body, task)
            names = (*_PIECES, *_OF_BRANCHES_ALONE) if task == "flagrun" else _PIECES
            settings = {name: value for name in names if (value := {**laptop, **settings}.get(name)) is not None}
            if settings.get("controller_network") == "equivariant":  # its layers are sized by sector
                networks = make_config(f"{body}-{task}", self.preset).values
                settings |= {"hidden": laptop["hidden"], "primitive_hidden": networks["hidden"]}
        if self.branched_population is not None and "primitive_population_size" in settings:
            settings["primitive_population_size"] = self.branched_population
        return settings

    def preset_of(self, form: str) -> str:
        """Return the preset that the settings of a form are over."""
        return "paper" if self.preset == "laptop" and form != PIECES else self.preset

    def _laptop(self, body: str, task: str) -> dict[str, Any]:
        """Return the values of preset `laptop`, which for the ant has the changes."""
        return dict(make_config(f"{body}-{task}", "laptop").values)


SCALES: dict[str, Scale] = {
    # Table I: 3000 generations, at most ten hours, ten runs.
    "paper": Scale(
        preset="paper",
        seeds={"ant": 10},
        settings={"minutes": 600.0},
        episodes=200,
        hiro={"minutes": 600.0},
        hiro_preset="hiro-table1",
        num_workers=(48, 240, 600),
    ),
    "laptop": Scale(
        preset="laptop",
        seeds={"point": 10, "ant": 5},
        settings={"horizon": 500, "evaluation_horizon": 500, "evaluation_episodes": 20, "evaluation_interval": 5},
        episodes=100,
        env_steps={
            **{f"point-{task}": 3_000_000 for task in TASKS},
            "point-flagrun": 500_000,
            "ant-gather": 6_000_000,
            "ant-maze": 20_000_000,
            "ant-push": 10_000_000,
            "ant-flagrun": 1_000_000,
        },
        transfer_env_steps={"ant-maze": 2_000_000, "ant-push": 2_000_000},
        evaluations={"ant": 20},
        has_fixed_target=True,
        hiro={"horizon": 500, "evaluation_horizon": 500, "evaluation_episodes": 20, "evaluation_interval": 4},
        hiro_env_steps={
            **{f"{body}-{task}": 300_000 for body in ("point", "ant") for task in TASKS},
            "ant-maze": 600_000,
            "ant-push": 600_000,
        },
        timed_env_steps={
            **{f"point-{task}": 600_000 for task in TASKS},
            "ant-gather": 1_200_000,
            "ant-maze": 800_000,
            "ant-push": 800_000,
        },
    ),
    "smoke": Scale(
        preset="smoke",
        seeds={"point": 2, "ant": 1},
        settings=SMOKE,
        episodes=4,
        env_steps={f"{body}-{task}": 1_000 for body in ("point", "ant") for task in (*TASKS, "flagrun")},
        branched_population=8,
        hiro={
            "horizon": 50,
            "evaluation_horizon": 50,
            "evaluation_episodes": 2,
            "warmup_steps": 200,
            "generation_steps": 100,
        },
        hiro_env_steps={f"{body}-{task}": 400 for body in ("point", "ant") for task in TASKS},
        hiro_preset="smoke",
        timed_seeds={"point": 1},
    ),
}
