"""A page and a picture of every environment, made from its task and its body."""

from __future__ import annotations

import inspect
import io
from math import isinf

import gymnasium
import numpy as np
from code_tables import first_paragraph
from markdown_table import table
from PIL import Image

from shes.drawing.renderer import CAMERAS
from shes.envs.gymnasium_ids import MAX_EPISODE_STEPS, gymnasium_id
from shes.envs.named_environments import ENVIRONMENTS
from shes.envs.tasks.task import Task, TaskOptions
from shes.settings import setting_fields


def picture(name: str) -> bytes:
    """Return the first state of an evaluation episode, from behind and from above, as PNG."""
    frames = []
    for camera in CAMERAS:
        env = gymnasium.make(
            gymnasium_id(name), render_mode="rgb_array", camera=camera, evaluation=True, width=360, height=360
        )
        env.reset(seed=0)
        frames.append(env.render())
        env.close()
    out = io.BytesIO()
    Image.fromarray(np.hstack(frames)).save(out, "PNG", optimize=True)
    return out.getvalue()


def environment_table() -> str:
    """Return the table of all environments."""
    tasks = {name: ENVIRONMENTS[name].make(1) for name in ENVIRONMENTS}
    rows = [
        (
            f"[{name}]({name}.md)",
            f"`{gymnasium_id(name)}`",
            task.observation_size,
            task.action_size,
            first_paragraph(type(task)),
        )
        for name, task in tasks.items()
    ]
    header = ["environment", "Gymnasium id", "observation", "action", "description"]
    return table(header, rows, numbers=["observation", "action"])


def environment_page(name: str) -> str:
    """Return the page of environment `name`."""
    task, gym_id = ENVIRONMENTS[name].make(1), gymnasium_id(name)
    return "\n\n".join(
        [
            f"# {name}",
            _docstring(type(task)),
            f"![The first state of an episode of {name}]({name}.png){{ width=720 }}",
            table(["Gymnasium id", f"`{gym_id}`"], _facts(task)),
            "## Action",
            f"{task.action_size} numbers in [-1, 1].",
            _actions(task),
            "## Observation",
            f"{task.observation_size} numbers. {_docstring(type(task.body))}",
            _observations(task),
            *_hiro(name, task),
            "## Arguments",
            f"Arguments of `gymnasium.make({gym_id!r}, ...)`, besides Gymnasium's own:",
            _arguments(task),
            "For rendering also `width` and `height` in pixels (480), and `camera`: `follow` (the default) or `top`.",
        ]
    )


def _facts(task: Task) -> list[tuple[str, str]]:
    """Return what sums up a task: reward, ending, score, time, code."""
    description = type(task).description
    code = [f"[`{cls.__qualname__}`][{cls.__module__}.{cls.__qualname__}]" for cls in (type(task), type(task.body))]
    return [
        ("Reward per step", description.reward),
        ("Terminates", description.ends),
        ("Time limit", f"{MAX_EPISODE_STEPS} control steps in Gymnasium (`truncated`), `--horizon` in training"),
        ("Score", description.score),
        ("Success", description.success),
        ("Control step", f"{task.step_s:g} s, {task.body.frame_skip} physics steps"),
        ("Code", ", ".join(code)),
    ]


def _actions(task: Task) -> str:
    limit, unit = task.control_limit, task.body.control_unit
    rows = [(i, control, f"{-limit:g}", f"{limit:g}", unit) for i, control in enumerate(task.body.controls)]
    return table(["index", "control", "at -1", "at 1", "unit"], rows, numbers=["index", "at -1", "at 1"])


def _observations(task: Task) -> str:
    rows = [
        (i, f"`{each.name}`", each.meaning, each.unit, _bound(each.low), _bound(each.high))
        for i, each in enumerate(task.observation_spec)
    ]
    return table(["index", "name", "meaning", "unit", "low", "high"], rows, numbers=["index", "low", "high"])


def _bound(value: float) -> str:
    return ("-∞" if value < 0 else "∞") if isinf(value) else f"{value:g}"


def _hiro(name: str, task: Task) -> list[str]:
    """Return the section on the `hiro` variant, if the task has one."""
    if "hiro" not in task.specs:
        return []
    other = ENVIRONMENTS[name].make(1, TaskOptions(spec="hiro"))
    hidden = [f"`{each.name}`" for i, each in enumerate(other.observation_spec) if i not in other.primitive_view]
    gym_id, integrator = gymnasium_id(name, "hiro"), other.options.integrator
    intro = f"`{gym_id}`, `--spec hiro`: {other.observation_size} numbers, integrator `{integrator}`."
    for_controller = f" Only the controller sees {', '.join(hidden)}." if hidden else ""
    return ['## Observation with `spec="hiro"`', intro + for_controller, _observations(other)]


def _arguments(task: Task) -> str:
    fields = [*setting_fields(task.Options).values(), *setting_fields(task.body.Options).values()]
    return table(
        ["argument", "default", "meaning"], [(f"`{each.name}`", f"`{each.default!r}`", each.text) for each in fields]
    )


def _docstring(cls: type) -> str:
    """Return the docstring of `cls`, each paragraph on one line."""
    paragraphs = inspect.cleandoc(cls.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
