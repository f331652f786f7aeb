"""Every environment with every specification of its task: what the contracts of tasks run over."""

from typing import NamedTuple

import gymnasium
import pytest

from shes.envs.gymnasium_ids import gymnasium_id
from shes.envs.named_environments import ENVIRONMENTS
from tests.envs.episodes import make_task


class Variant(NamedTuple):
    """An environment's name and a specification of its task."""

    name: str
    spec: str

    @property
    def id(self):
        """Its Gymnasium id."""
        return gymnasium_id(self.name, self.spec)

    def make_task(self, num_episodes, **options):
        """Return `num_episodes` episodes of it."""
        return make_task(self.name, num_episodes, spec=self.spec, **options)

    def make_env(self, **options):
        """Return Gymnasium's single environment."""
        return gymnasium.make(self.id, **options)

    def make_vector(self, num_envs, **options):
        """Return Gymnasium's vector environment."""
        return gymnasium.make_vec(self.id, num_envs=num_envs, **options)


VARIANTS = [Variant(name, spec) for name, environment in ENVIRONMENTS.items() for spec in environment.task.specs]


def _mark(variant):
    """Return the parameter of a test: most hiro variants share all but numbers with what runs anyway."""
    is_slow = variant.spec == "hiro" and variant.name not in ("point-gather", "point-push")
    is_long = variant.spec == "shes" and variant.name in ("ant-maze", "ant-fall", "ant-flagrun")
    marks = [pytest.mark.slow] if is_slow else [pytest.mark.extras] if is_long else []
    return pytest.param(variant, id="-".join(variant), marks=marks)


over_variants = pytest.mark.parametrize("variant", [_mark(variant) for variant in VARIANTS])
