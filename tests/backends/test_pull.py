"""A backend with remote workers defines and overrides public names only, which the documentation lists."""

import re
from pathlib import Path

import pytest

from shes.backends import mpi, process, processes, ray
from shes.backends.processes import ProcessesBackend
from shes.backends.pull import PullBackend
from shes.backends.remote_worker import RemoteWorker
from tests.backends.workers import Worker

SECTION = (
    Path("docs/extending.md").read_text().partition("### Remote workers")[2].partition("\nA backend that is part")[0]
)


def overridden(contract):
    """Return the names that the backends of the package define again, by class."""
    classes = [cls for module in (mpi, process, processes, ray) for cls in vars(module).values()]
    return {
        cls.__name__: {name for name in vars(cls).keys() & vars(contract).keys() if not re.match("__|_abc_", name)}
        for cls in classes
        if isinstance(cls, type) and issubclass(cls, contract) and cls is not contract
    }


@pytest.mark.parametrize(("contract", "count"), [(PullBackend, 3), (RemoteWorker, 4)])
def test_what_is_overridden_is_public_and_documented(contract, count):
    found = overridden(contract)
    assert len(found) == count
    names = set().union(*found.values()) | contract.__abstractmethods__
    assert {name for name in names if name.startswith("_") or not getattr(contract, name).__doc__} == set()
    assert names == set(re.findall(r"`(\w+)`?[(`]", SECTION)) & set(dir(contract))


def test_a_backend_may_look_around_between_messages():
    class Looking(ProcessesBackend):
        times = 0

        def look_around(self):
            self.times += 1

    with Looking(Worker, 1) as backend:
        assert list(backend.map([("where", 0.0)]))
        assert backend.times > 0
