"""Check, measure and train on a GPU: `python benchmarks/gpu.py --out OUT`.

`--only` takes stages: `check`, `bandwidth`, `generations`, `worlds`, `train`. Every stage writes its CSV row by row, so
that an interrupted stage keeps its measurements. `--smoke --device warp-cpu` runs all stages in a few minutes without a
GPU; its numbers have no meaning.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from device_check import ALPHA, compare_samples, detectable_shift, sample

from shes.envs.named_environments import ENVIRONMENTS, find_environment
from shes.envs.tasks.task import TaskOptions
from shes.evolution.algorithm import evolve
from shes.evolution.strategies import EvolutionAlgorithm
from shes.runs.build import build_algorithm, build_backend
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config
from shes.runs.tables import csv_text
from shes.sim.simulator import CpuSimulator
from shes.sim.warp import WarpSimulator
from shes.sim.warp_device import WarpDevice
from shes.storage import write_atomically

INTEGRATORS = ("euler", "rk4")
_CHECK_LANES = 1000  # simulations side by side on the device in `check`


@dataclass(frozen=True, kw_only=True)
class Size:
    """Size of every stage."""

    episodes: int
    """Episodes of each sample of the check."""
    check_steps: int
    integrators: tuple[str, ...]
    worlds: tuple[int, ...]
    world_steps: int
    """Control steps of a measurement of the physics alone."""
    population: int
    """Policies of a whole generation, five episodes each."""
    horizon: int
    hidden: tuple[int, ...]
    repeats: int
    envs: tuple[str, ...]
    train: tuple[str, ...]
    """Environments to train on, one after another: the others start from the primitive of the first, Flagrun."""
    preset: str
    """Preset of the training."""
    copied: int
    """Numbers that are copied to measure the bandwidth of the memory."""


FULL = Size(
    episodes=1000,
    check_steps=500,
    integrators=INTEGRATORS,
    worlds=(1024, 2048, 4096, 8192, 16384, 32768, 65536, 131072),
    world_steps=100,
    population=1000,
    horizon=500,
    hidden=(256, 256, 256),
    repeats=3,
    envs=tuple(ENVIRONMENTS),
    train=("ant-flagrun", "ant-gather", "ant-push", "ant-maze"),
    preset="paper",
    copied=2**28,
)
SMOKE = Size(
    episodes=16,
    check_steps=5,
    integrators=INTEGRATORS,
    worlds=(2, 4),
    world_steps=2,
    population=4,
    horizon=5,
    hidden=(8,),
    repeats=1,
    envs=("point-gather", "ant-gather"),
    train=("point-flagrun", "point-gather"),
    preset="smoke",
    copied=2**16,
)


class Table:
    """A table that is printed and written to a file row by row."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: list[dict[str, Any]] = []

    def add(self, **row: Any) -> None:
        """Add a row."""
        self._rows.append(row)
        print({name: f"{value:.4g}" if isinstance(value, float) else value for name, value in row.items()}, flush=True)
        rows = [list(self._rows[0]), *(list(each.values()) for each in self._rows)]
        write_atomically(self.path, lambda file: file.write(csv_text(rows).encode()))


# Stage `check`.


def check(device: str, size: Size, out: Path) -> None:
    """Compare return distributions on the device with those on the CPU, which other processes sample meanwhile."""
    table = Table(out / "check.csv")
    simulator = partial(WarpSimulator, device=device)
    cases = [(env, spec) for env in size.envs for spec in ENVIRONMENTS[env].task.specs]
    sizes: dict[str, Any] = {"episodes": size.episodes, "horizon": size.check_steps}
    # Not a fork: a child must not inherit the GPU.
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        on_cpu: dict[tuple[str, str], Future[Any]] = {
            case: pool.submit(sample, case[0], CpuSimulator, spec=case[1], seed=0, **sizes) for case in cases
        }
        found: list[float] = []
        try:
            for env, spec in cases:
                start = perf_counter()
                on_device = sample(env, simulator, spec=spec, seed=1, lanes=_CHECK_LANES, **sizes)
                seconds = perf_counter() - start
                for comparison in compare_samples(env, spec, on_cpu[env, spec].result(), on_device):
                    found += [comparison.p_shift, comparison.p_distance]
                    table.add(**asdict(comparison), device_s=seconds)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # not hours of the CPU's samples
            raise
    tests, smallest = len(found), min(found)
    is_same = all(p > ALPHA / tests for p in found)  # not so for a p that is NaN
    verdict = "no difference found" if is_same else "DIFFERENT"
    print(f"{verdict}: smallest p {smallest:.2g} of {tests} tests, each at {ALPHA / tests:.2g}; a shift of ", end="")
    print(f"{detectable_shift(size.episodes, tests):.2f} standard deviations is found with a power of 0.9")


# Stages `bandwidth`, `generations` and `worlds`.


def synchronize(device: WarpDevice) -> None:
    """Wait until all issued work is done."""
    if device.xp is not np:
        device.xp.cuda.get_current_stream().synchronize()


def free_bytes(device: WarpDevice) -> int | None:
    """Return the free memory of the GPU in bytes; None on the CPU."""
    if device.xp is np:
        return None
    device.release_memory()
    synchronize(device)  # Warp's pool releases unused memory at a synchronisation
    return int(device.xp.cuda.runtime.memGetInfo()[0])


def physics_alone(device: str, size: Size, out: Path) -> None:
    """Measure the physics alone, with random controls, for every number of worlds."""
    table = Table(out / "worlds.csv")
    for integrator, worlds in itertools.product(size.integrators, size.worlds):
        options = TaskOptions(integrator=integrator)
        task: Any = find_environment("ant-gather").make(worlds, options, partial(WarpSimulator, device=device))
        opened = WarpDevice(device)
        ids = np.arange(worlds)
        task.reset(ids, ids.tolist())
        controls = np.random.default_rng(0).uniform(-30, 30, (worlds, task.action_size)).astype(np.float32)
        task.sim.ctrl[:] = task.xp.asarray(controls)
        task.sim.step(ids, task.body.frame_skip)  # compiles, captures
        synchronize(opened)
        start = perf_counter()
        for _ in range(size.world_steps):
            task.sim.step(ids, task.body.frame_skip)
        synchronize(opened)
        seconds = (perf_counter() - start) / size.world_steps
        task.check_buffers()
        table.add(
            integrator=integrator,
            worlds=worlds,
            step_ms=1e3 * seconds,
            env_steps_per_s=worlds / seconds,
            free_bytes=free_bytes(opened),
        )
        del task


def generations(device: str, size: Size, out: Path) -> None:
    """Measure whole generations and their parts; a tiny one shows the cost of the kernel launches alone."""
    table = Table(out / "generations.csv")
    whole = "generation", size.population, 5
    sizes = [("launches alone", 1, 1, False), (*whole, False), (*whole, True)]
    kinds = itertools.product(("ant-gather",), size.integrators, sizes)
    for env, integrator, (what, population, episodes, is_deterministic) in kinds:
        settings = {
            "population_size": 4 * max(1, population // 4),
            "episodes_per_policy": episodes,
            "horizon": size.horizon,
            "hidden": size.hidden,
            "integrator": integrator,
            "device": device,
            "deterministic": is_deterministic,
        }
        config = make_config(env, "paper", settings)
        found = list(itertools.islice(_timed(config), size.repeats + 1))[1:]  # the first one compiles
        names = [name for name in found[0] if found[0][name] is not None]
        row = {name: statistics.median(each[name] for each in found) for name in names}
        what_ran = {"env": env, "integrator": integrator, "deterministic": is_deterministic}
        table.add(what=what, **what_ran, policies=config.evolution.population_size, episodes=episodes, **row)


def _timed(config: TrainConfig) -> Iterator[dict[str, Any]]:
    """Yield the seconds of every generation, by part."""
    learner = build_algorithm(config)
    assert isinstance(learner, EvolutionAlgorithm)
    opened = WarpDevice(config.workers.device)
    with build_backend(config, learner.plan()) as backend:
        for report in evolve(
            learner.start(config.run.seed), learner.hyperparameters, learner.table.on(opened.xp), backend
        ):
            (episodes,) = report.populations  # the preset of the paper has no intervals
            physics_s, policy_s, task_s = episodes.results.seconds.tolist()
            steps = int(episodes.results.steps.sum())
            yield {
                "env_steps": steps,
                "generation_s": report.rollout_s + report.update_s,
                "physics_s": physics_s,
                "policy_s": policy_s,
                "task_s": task_s,
                "rest_s": report.rollout_s - physics_s - policy_s - task_s,
                "update_s": report.update_s,
                "env_steps_per_s": steps / (report.rollout_s + report.update_s),
                "policy_and_task_share": (policy_s + task_s) / (report.rollout_s + report.update_s),
                "weights_mb": 4e-6 * sum(learner.design.dims) * config.evolution.population_size,
                "free_bytes": free_bytes(opened),
            }


def bandwidth(device: str, size: Size, out: Path) -> None:
    """Measure the memory bandwidth of the GPU, read and written, and the time of a call of CuPy."""
    opened = WarpDevice(device)
    xp = opened.xp
    a, b = xp.zeros(size.copied, np.float32), xp.zeros(size.copied, np.float32)
    times = [_seconds(opened, partial(np.copyto, a, b)) for _ in range(5)]
    one = xp.zeros(1, np.float32)
    launches = [_seconds(opened, lambda: [np.add(one, one, out=one) for _ in range(1000)]) for _ in range(5)]
    Table(out / "limits.csv").add(
        copied_bytes=a.nbytes,
        copy_gb_per_s=2e-9 * a.nbytes / statistics.median(times),
        call_us=1e3 * statistics.median(launches),
    )


def _seconds(opened: WarpDevice, work: Callable[[], Any]) -> float:
    work()
    synchronize(opened)
    start = perf_counter()
    work()
    synchronize(opened)
    return perf_counter() - start


# Stage `train`.


def train(device: str, size: Size, out: Path, minutes: float) -> None:
    """Train Flagrun, then the tasks with its primitive, for an equal part of `minutes` each; resume existing runs."""
    primitive = out / size.train[0]
    for env in size.train:
        folder = out / env
        limits = ["--device", device, "--minutes", f"{minutes / len(size.train):.3f}", "--generations", "100000"]
        if (folder / "config.json").is_file():
            command = ["resume", str(folder), *limits]
        else:
            transfer = [] if folder == primitive else ["--primitive", str(primitive)]
            command = ["train", env, "--preset", size.preset, *transfer, "--out", str(folder), *limits]
        print("shes", *command, flush=True)
        subprocess.run([sys.executable, "-m", "shes", *command], check=True)


def describe(device: str) -> dict[str, Any]:
    """Return the GPU, the driver and the versions."""
    opened = WarpDevice(device)
    return {"device": device, "array_module": opened.xp.__name__, **opened.facts}


def main() -> None:
    """Run the selected stages."""
    stages = {"check": check, "bandwidth": bandwidth, "generations": generations, "worlds": physics_alone}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for CSV files and runs")
    parser.add_argument("--device", default="cuda", help="cuda, or warp-cpu to try this script")
    parser.add_argument("--only", nargs="+", choices=[*stages, "train"], default=[*stages, "train"])
    parser.add_argument("--minutes", type=float, default=10.0, help="minutes of training")
    parser.add_argument("--integrators", nargs="+", choices=INTEGRATORS, help="of the speeds; default: all")
    parser.add_argument("--worlds", nargs="+", type=int, help="numbers of simulations of stage worlds")
    parser.add_argument("--envs", nargs="+", choices=FULL.envs, help="environments of stage check; default: all")
    parser.add_argument("--smoke", action="store_true", help="smallest possible size of every stage")
    asked = parser.parse_args()
    chosen = {name: tuple(getattr(asked, name) or ()) for name in ("integrators", "worlds", "envs")}
    size = replace(SMOKE if asked.smoke else FULL, **{name: values for name, values in chosen.items() if values})
    asked.out.mkdir(parents=True, exist_ok=True)
    facts = describe(asked.device)
    print(json.dumps(facts, indent=1))
    (asked.out / "machine.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    for stage in asked.only:
        print(f"\n{stage}", flush=True)
        if stage == "train":
            train(asked.device, size, asked.out, asked.minutes)
        else:
            stages[stage](asked.device, size, asked.out)


if __name__ == "__main__":
    main()
