"""A user's own environment, reward and encoding train on worker processes wherever they are written.

The same script runs with its classes in itself, and in a module of the working directory.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.e2e import own_classes, runs

pytestmark = pytest.mark.extras  # the fast tests have three minutes

CLASSES = Path(own_classes.__file__).read_text(encoding="utf-8")
WORK = """
import json
import shes
register()
settings = json.loads(SETTINGS)
run = shes.train("puck-corner", primitive_reward="nearness", goal_encoding="own-vector", **settings)
shes.resume(run.path, generations=settings["generations"] + 1)
agent = shes.load(run.path)
action = agent.act([0.1, 0.2, 0.0, 0.0, 1.0, -1.0])
print(json.dumps({**shes.evaluate(run.path, episodes=3).summary(), "action": action.tolist()}))
"""


def work(folder, **settings):
    """Return the script's text that trains into `folder`."""
    settings = {**runs.TINY, "generations": 2, "num_workers": 2, "out": str(folder), **settings}
    return WORK.replace("SETTINGS", repr(json.dumps(settings)))


def run_python(*words, text=None, cwd):
    """Run Python without the path that pytest was given; return what the script said at its end."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        input=text, capture_output=True, text=True, cwd=cwd, env=environment, timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The run in one process, and what was said of it."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "own.py").write_text(CLASSES + work(folder / "run", backend="serial"))
    return folder / "run", run_python("own.py", cwd=folder)


@pytest.mark.parametrize("is_module", [False, True])
def test_own_classes_train_on_two_workers_like_in_one_process(reference, tmp_path, is_module):
    path, said = reference
    assert said["primitive_return_mean"] < -20  # `progress` is never far below 0
    script = work(tmp_path / "run", backend="processes")
    if is_module:  # as in a notebook or at a Python prompt
        (tmp_path / "own_module.py").write_text(CLASSES)
        assert run_python("-", text="from own_module import register\n" + script, cwd=tmp_path) == said
    else:
        (tmp_path / "own.py").write_text(CLASSES + script)
        assert run_python("own.py", cwd=tmp_path) == said
    assert runs.differences(path, tmp_path / "run") == []
