"""Table I of the paper compared with the settings of scale `paper`. Source: SHES paper, Table I."""

from __future__ import annotations

from typing import Any, NamedTuple

from shes.runs.config import TrainConfig
from shes.runs.tables import Row
from shes.studies.paper_scales import SCALES
from shes.training.make_config import make_config


class Parameter(NamedTuple):
    """A row of Table I."""

    words: str
    shes: Any
    """Its value for SHES and SHES-TL."""
    hiro: Any
    """Its value for HIRO; None if it has none."""
    name: str = ""
    """Setting of SHES; empty for a parameter of the experiment."""
    hiro_name: str = ""
    """Setting of HIRO, if it is not `name`."""


TABLE_1 = (
    Parameter("controller interval", 25, 10, "controller_interval"),
    Parameter("controller distance", 4, 10, "goal_distance"),
    Parameter("learning rate", 0.01, 0.001, "learning_rate", "actor_learning_rate"),
    Parameter("sigma", 0.02, None, "sigma"),
    Parameter("episodes per policy", 5, None, "episodes_per_policy"),
    Parameter("policies per generation", 1000, None, "population_size"),
    Parameter("time horizon", 500, 500, "horizon"),
    Parameter("runs", 10, 10),
    Parameter("generations", 3000, 3000, "generations", "none"),
    Parameter("hours", 10, 10),
    Parameter("CPU cores", "48, 240, 600", "24 + V100 GPU"),
)
"""HIRO has no generations: here its runs have 10 million environment steps, as the paper's text says."""


def settings_beside(env: str = "ant-gather") -> list[Row]:
    """Return a row for each of `TABLE_1` with the value in the paper and in scale `paper` on `env`, None if unset."""
    scale = SCALES["paper"]
    ours = make_config(env, scale.preset, scale.settings)
    hiro = make_config(env, scale.hiro_preset, {"algorithm": "hiro", **scale.hiro})
    experiment = {
        "runs": (scale.seeds["ant"],) * 2,
        "hours": (_hours(ours), _hours(hiro)),
        "CPU cores": (", ".join(map(str, scale.num_workers)), None),
    }
    rows: list[Row] = []
    for words, of_shes, of_hiro, name, hiro_name in TABLE_1:
        values = ours.values.get(name), hiro.values.get(hiro_name or name)
        here = values if name else experiment[words]
        rows.append({"parameter": words, "shes": of_shes, "shes_here": here[0], "hiro": of_hiro, "hiro_here": here[1]})
    return rows


def _hours(config: TrainConfig) -> float | None:
    return None if config.run.minutes is None else config.run.minutes / 60
