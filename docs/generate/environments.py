"""The environments: an overview, and a page with a picture of each, from what the code says of itself."""

from __future__ import annotations

import inspect
import io
from math import isinf

import gymnasium
import numpy as np
from PIL import Image

from generate.source import find, link
from generate.tables import table
from shes.drawing.renderer import CAMERAS
from shes.envs.gymnasium_ids import MAX_EPISODE_STEPS, gymnasium_id
from shes.envs.registry import ENVIRONMENTS, make_task
from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.task import FRAME_SKIP, Task
from shes.envs.worlds import TIMESTEP_S
from shes.settings import setting_fields


def page_uri(name: str) -> str:
    """Return the page of environment `name`."""
    return f"environments/{name}.md"


def picture_uri(name: str) -> str:
    """Return the picture of environment `name`."""
    return f"environments/{name}.png"


def picture(name: str) -> bytes:
    """Return the first moment of an episode of evaluation, from behind and from above, as PNG."""
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


def overview(page: str) -> str:
    """Return the table of all environments."""
    del page
    tasks = {name: make_task(name, 1) for name in ENVIRONMENTS}
    rows = [
        (
            f"[{name}]({name}.md)",
            f"`{gymnasium_id(name)}`",
            task.observation_size,
            task.action_size,
            _text(type(task)).split("\n\n")[0],
        )
        for name, task in tasks.items()
    ]
    header = ["environment", "Gymnasium", "observation", "action", "what it is"]
    return table(header, rows, numbers=["observation", "action"])


def environment_page(name: str) -> str:
    """Return the page of environment `name`."""
    task = make_task(name, 1)
    gym = f"`{gymnasium_id(name)}`"
    return "\n\n".join(
        [
            f"# {name}",
            _text(type(task)),
            f"![The first moment of an episode of {name}]({name}.png){{ width=720 }}",
            table(["Gymnasium", gym], _facts(task, page_uri(name))),
            "## Action",
            f"{task.action_size} numbers in [-1, 1].",
            _actions(task),
            "## Observation",
            f"{task.observation_size} numbers. {_text(type(task.body))}",
            _observations(task),
            *_hiro(name, task),
            "## Arguments",
            f"What `gymnasium.make({gym[1:-1]!r}, ...)` takes, beside Gymnasium's own arguments:",
            _arguments(task),
            "And for its pictures `width` and `height` in pixels (480), and `camera`: `follow` (the default) or `top`.",
        ]
    )


def _facts(task: Task, page: str) -> list[tuple[str, str]]:
    """Return what is to be known of a task at one glance."""
    description = type(task).description
    return [
        ("Reward of a step", description.reward),
        ("Ends", description.ends),
        ("Time limit", f"{MAX_EPISODE_STEPS} control steps in Gymnasium (`truncated`), `--horizon` in training"),
        ("Score", description.score),
        ("Success", description.success),
        ("Control step", f"{FRAME_SKIP * TIMESTEP_S:g} s, {FRAME_SKIP} physics steps"),
        ("Code", f"{_code(type(task), page)}, {_code(type(task.body), page)}"),
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


def _hiro(name: str, task: Task) -> list[str]:
    """Return the section on the second specification, if the task has it."""
    if "hiro" not in task.specs:
        return []
    other = make_task(name, 1, TaskOptions(spec="hiro"))
    hidden = [f"`{each.name}`" for i, each in enumerate(other.observation_spec) if i not in other.primitive_view]
    for_controller = f" For the controller alone: {', '.join(hidden)}." if hidden else ""
    gym, size, integrator = gymnasium_id(name, "hiro"), other.observation_size, other.options.integrator
    intro = f"`{gym}`, `--spec hiro`: {size} numbers, integrator `{integrator}`."
    return [
        '## Observation with `spec="hiro"`',
        f"{intro}{for_controller}",
        _observations(other),
    ]


def _arguments(task: Task) -> str:
    settings = [*setting_fields(task.Options).values(), *setting_fields(task.body.Options).values()]
    rows = [(f"`{each.name}`", f"`{each.default!r}`", each.text) for each in settings]
    return table(["argument", "default", "meaning"], rows)


def _bound(value: float) -> str:
    return ("-∞" if value < 0 else "∞") if isinf(value) else f"{value:g}"


def _text(cls: type) -> str:
    """Return the docstring of `cls`, a line for each paragraph."""
    paragraphs = inspect.cleandoc(cls.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _code(cls: type, page: str) -> str:
    path, line, _ = find(f"{cls.__module__}.{cls.__qualname__}")
    return link(path, line, page)
