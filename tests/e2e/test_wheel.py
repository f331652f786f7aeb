"""The package as users get it: what is in the wheel, and that it works in an environment with nothing else."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from shes.runs.shipped import shipped_names

ROOT = Path(__file__).parents[2]

pytestmark = [pytest.mark.extras, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel built from this checkout."""
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = out.glob("shes-*-py3-none-any.whl")
    return found


def test_the_wheel_holds_the_package_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    source = ROOT / "src"
    package = {
        str(path.relative_to(source))
        for path in (source / "shes").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in names if ".dist-info/" not in name} == package
    assert "shes/py.typed" in package
    assert any(name.endswith("licenses/LICENSE") for name in names)
    agents = {name for name in package if name.startswith("shes/shipped/")}
    page = {"shes/viewing/report_page.html"}
    assert page <= package
    assert all(name.endswith((".py", "py.typed")) for name in package - agents - page)
    assert all(name.endswith((".csv", ".json", ".npz")) for name in agents)
    assert wheel.stat().st_size < 3_000_000


def find_python(version):
    """Return an interpreter of this version, from PATH or pyenv, that can make environments; None without one."""
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    for candidate in (f"python{version}", *sorted(root.glob(f"versions/{version}*/bin/python"))):
        command = [str(candidate), "-c", "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2])"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError:
            continue
        if (done.returncode, done.stdout.strip()) == (0, version):
            return candidate
    return None


OLDEST = ["gymnasium==1.1.0", "numpy==2.2.0"]
WRAPPED = """
import gymnasium, shes
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector
gymnasium.register_envs(shes)
env = gymnasium.make('shes:shes/AntGather-v0', render_mode='rgb_array', max_episode_steps=3)
assert gymnasium.make(env.spec).spec == env.spec
make = {'num_envs': 2, 'max_episode_steps': 3, 'render_mode': 'rgb_array'}
envs = [(gymnasium.wrappers, env)]
envs += [(vector, gymnasium.make_vec('shes/PointGather-v0', autoreset_mode=mode, **make)) for mode in AutoresetMode]
for i, (kind, env) in enumerate(envs):
    if hasattr(kind, 'RecordVideo'):  # Gymnasium 1.1 has none for vectors
        env = kind.RecordVideo(env, f'videos{i}')
    env = kind.NormalizeReward(kind.RecordEpisodeStatistics(env))
    env.reset(seed=0)
    info = [env.step(env.action_space.sample()) for _ in range(3)][-1][4]
    assert (info['episode']['l'] == 3).all() if i else info['episode']['l'] == 3
    env.close()
"""


@pytest.mark.parametrize(("version", "packages"), [("3.11", OLDEST), *((f"3.{minor}", []) for minor in (11, 12, 13))])
def test_an_empty_environment_can_train_evaluate_render_and_play(wheel, tmp_path, version, packages):
    found = find_python(version)
    if found is None:
        pytest.skip(f"there is no Python {version} here")
    home = tmp_path / "home"
    home.mkdir()
    environment = tmp_path / "environment"
    subprocess.run([str(found), "-m", "venv", str(environment)], check=True)
    python = environment / "bin" / "python"
    # A registry that the machine is configured for is not part of an empty HOME: pip's own settings stay.
    variables = {name: value for name, value in os.environ.items() if name.startswith("PIP_") or name == "MUJOCO_GL"}
    variables |= {"HOME": str(home), "PATH": os.environ["PATH"]}

    def run(*words):
        done = subprocess.run(
            [str(word) for word in words], env=variables, cwd=home, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        return done.stdout

    pinned = packages or ["-c", ROOT / "constraints.txt"]
    run(python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *pinned, wheel, "moviepy")
    shes = environment / "bin" / "shes"
    run(shes, "train", "point-gather", "--preset", "smoke", "--generations", "2", "--workers", "2", "--out", "run")
    assert json.loads(run(shes, "evaluate", "run", "--episodes", "3", "--json"))["episodes"] == 3
    assert set(json.loads(run(shes, "list", "--json"))["agents"]) == set(shipped_names())
    run(shes, "render", "run", "--out", "walk.mp4", "--steps", "3", "--size", "96")
    assert (home / "walk.mp4").stat().st_size > 1000
    run(shes, "plot", "run")
    run(shes, "plot", "ant-gather", "--out", "shipped.png")
    code = "import shes; print(shes.evaluate('ant-maze', episodes=1, num_workers=1).steps)"
    assert run(python, "-c", code) == "[500.]\n"
    made = {path.name for path in home.iterdir() if not path.name.startswith(".")}
    assert made == {"run", "walk.mp4", "curves.png", "shipped.png"}
    run(python, "-W", "ignore", "-c", WRAPPED)
    assert list((home / "videos0").glob("*.mp4"))
