"""The speed-up by more cores: measured here, projected to clusters, and validated. Source: SHES paper, Figure 6.

A projection replays a measured generation in simulated time (`shes.bench.simulation`). It is validated against the
generations measured here, and against hundreds of workers that sleep for the measured times (`shes.bench.sleepers`).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import harmonic_mean
from time import perf_counter
from typing import Any

from shes.algorithms.roll_out import roll_out_tasks
from shes.bench.evolution import EvolutionAlgorithm, GenerationReport, evolution_strategy, evolve, generation_work
from shes.bench.generation_cost import Stage, measure_stages
from shes.bench.measure import bench_update
from shes.bench.simulation import GenerationTimes, Network
from shes.bench.sleepers import Sleeper, SleepersBackend
from shes.bench.speedup_figure import draw_speedup
from shes.cores import core_numbers, on_one_core
from shes.errors import ConfigError
from shes.es.level import TrainState
from shes.runs.build import build_backend
from shes.runs.config import TrainConfig
from shes.runs.sections import RunSettings, sections_of, settings_in
from shes.runs.tables import csv_text
from shes.storage import write_atomically
from shes.training.make_config import make_config

CORES = (1, 2, 24, 48, 96, 120, 240, 360, 480, 600, 1000)
"""Numbers of cores of a projection; the paper's are 48, 240 and 600."""
SLEEPERS = (200, 600)
"""Numbers of sleeping workers."""
_HERE = Network(latency_s=1e-4, bytes_per_s=2e9, cores_per_node=0)
"""The connections of processes on one machine."""
_ASLEEP = replace(_HERE, cores_per_node=24)
"""The connections of sleeping workers."""

_MEASURED = ("alone", "measured")
"""Kinds of rows with measured generations: one worker that stays on a core, and workers on any cores."""

Row = dict[str, Any]


def bench_speedup(
    make: Callable[[str], TrainConfig],
    out: Path,
    *,
    network: Network,
    cores: Sequence[int] = CORES,
    sleepers: Sequence[int] = SLEEPERS,
    seconds: float = 0.0,
) -> dict[str, Any]:
    """Measure, project and validate; write `speedup.csv` and its figure, and return the most important numbers.

    Args:
        make: Returns the settings for the algorithm `shes` or `es`; `num_workers` is the largest number measured.
        out: Folder for the results.
        network: The connections of the cluster.
        cores: Numbers of cores to project to.
        sleepers: Numbers of sleeping workers.
        seconds: Minimum duration of the measurement of each number of workers.

    Raises:
        ConfigError: The environment sets the goals, so that there is no controller, or the run does not fit.
    """
    rows: list[Row] = []
    facts: dict[str, Any] = {}
    for name in ("shes", "es"):
        config = make(name)
        found = measure_speedup(config, network=network, cores=cores, sleepers=sleepers, seconds=seconds)
        rows += [{"env": config.run.env, "algorithm": name, **row} for row in found]
        facts |= {f"{name}_{key}": value for key, value in _facts(found).items()}
    out.mkdir(parents=True, exist_ok=True)
    write_rows(out / "speedup.csv", rows)
    draw_speedup(read_rows(out / "speedup.csv"), out / "speedup.png")
    return facts


def measure_speedup(
    config: TrainConfig,
    *,
    network: Network,
    cores: Sequence[int] = CORES,
    sleepers: Sequence[int] = SLEEPERS,
    seconds: float = 0.0,
) -> list[Row]:
    """Return measured and projected times of a generation and their speed-ups. See `bench_speedup`."""
    if config.workers.device != "cpu":
        raise ConfigError(f"bench speedup measures the CPU, got device {config.workers.device!r}. Omit --device.")
    algorithm = evolution_strategy(config)
    state = algorithm.start(config.run.seed)
    count = config.workers.count
    alone = [_measure(config, algorithm, state, 1, seconds, core) for core in core_numbers()[:count]]
    measured = {1: alone[0]} | {n: _measure(config, algorithm, state, n, seconds) for n in range(2, count + 1)}
    # The first updates of a process are slower than those of a long run: pages of the noise table have to be mapped.
    update_s = bench_update(config)["total_ms"] / 1000
    stages = measure_stages(algorithm, state, measured[max(measured)], update_s)
    return _rows(stages, alone, measured, network, cores, sleepers)


def settings_of(env: str, algorithm: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of `settings` that `algorithm` has on `env`."""
    own = settings_in(sections_of(RunSettings.of({"env": env, "algorithm": algorithm})).values())
    return {name: value for name, value in settings.items() if name in own}


def speedup_of(
    env: str, settings: Mapping[str, Any], out: Path, latency_us: float, gigabits_per_s: float, seconds: float
) -> dict[str, Any]:
    """Return `bench_speedup` of a task, with `settings` by name. S-ES takes those that it has.

    Raises:
        ConfigError: A setting is wrong.
    """

    def make(algorithm: str) -> TrainConfig:
        kept = dict(settings) if algorithm == "shes" else settings_of(env, algorithm, settings)
        return make_config(env, kept.pop("preset", "laptop"), {**kept, "algorithm": algorithm})

    network = Network(latency_s=latency_us / 1e6, bytes_per_s=gigabits_per_s * 1e9 / 8)
    return bench_speedup(make, out, network=network, seconds=seconds)


def _measure(
    config: TrainConfig,
    algorithm: EvolutionAlgorithm,
    state: TrainState,
    num_workers: int,
    seconds: float,
    core: int | None = None,
) -> GenerationReport:
    """Return a generation of median duration on `num_workers` workers, which stay on `core` if it is given."""
    config, reports = config.having(num_workers=num_workers), list[GenerationReport]()
    with ExitStack() as stack:
        with nullcontext() if core is None else on_one_core(core):
            backend = stack.enter_context(build_backend(config, algorithm.plan()))
        pool = stack.enter_context(ThreadPoolExecutor(min(num_workers, 8)))
        work = generation_work(state, algorithm.hyperparameters, algorithm.table.size)
        singles = [task.part(0, 1) for task in work.tasks[:num_workers]]
        roll_out_tasks(singles, work.generation, backend)  # until all workers have started
        start = perf_counter()
        while not reports or perf_counter() - start < seconds:
            reports.append(next(evolve(state, algorithm.hyperparameters, algorithm.table, backend, pool)))
    ordered = sorted(reports, key=lambda report: report.rollout_s + report.update_s)
    return ordered[len(ordered) // 2]


def _rows(
    stages: Sequence[Stage],
    alone: Sequence[GenerationReport],
    measured: Mapping[int, GenerationReport],
    network: Network,
    cores: Sequence[int],
    sleepers: Sequence[int],
) -> list[Row]:
    """Return the rows of an algorithm.

    Speed-ups of measured generations are relative to those `alone` on each core, at the mean of the cores' speeds; of
    others, to the one projected for one core.
    """

    def projected(num_workers: int, connections: Network) -> GenerationTimes:
        first, *others = (stage.simulate(num_workers, connections) for stage in stages)
        return sum(others, start=first)

    own = _at_mean_speed([_times(report) for report in alone])
    times = [
        *(("alone", 1, _times(report)) for report in alone),
        *(("measured", n, own if n == 1 else _times(report)) for n, report in measured.items()),
        *(("projected here", n, projected(n, _HERE)) for n in measured),
        *(("projected", n, projected(n, network)) for n in cores),
        *(("asleep", n, _asleep(n, stages)) for n in sleepers),
        *(("projected asleep", n, projected(n, _ASLEEP)) for n in sleepers),
    ]
    one_core = projected(1, _HERE)
    return [_row(kind, n, stages, each, own if kind in _MEASURED else one_core) for kind, n, each in times]


def _row(
    kind: str, num_workers: int, stages: Sequence[Stage], times: GenerationTimes, one_core: GenerationTimes
) -> Row:
    generation_s = times.rollout_s + times.update_s
    speedup = (one_core.rollout_s + one_core.update_s) / generation_s
    bounds = [stage.num_episodes / (num_workers * -(-stage.num_episodes // num_workers)) for stage in stages]
    return {
        "kind": kind,
        "cores": num_workers,
        "generation_s": generation_s,
        "rollout_s": times.rollout_s,
        "start_s": times.start_s,
        "episodes_s": times.busy_s / num_workers,
        "update_s": times.update_s,
        "speedup": speedup,
        "efficiency": speedup / num_workers,
        "bound": min(bounds),
    }


def _times(report: GenerationReport) -> GenerationTimes:
    """Return the times of a measured generation."""
    busy_s = sum(float(each.results.seconds.sum()) for each in report.populations)
    return GenerationTimes(start_s=float("nan"), rollout_s=report.rollout_s, update_s=report.update_s, busy_s=busy_s)


def _at_mean_speed(alone: Sequence[GenerationTimes]) -> GenerationTimes:
    """Return the times on a core of the mean speed of some cores, whose times these are."""
    return GenerationTimes(
        start_s=float("nan"),
        rollout_s=harmonic_mean(times.rollout_s for times in alone),
        update_s=harmonic_mean(times.update_s for times in alone),
        busy_s=harmonic_mean(times.busy_s for times in alone),
    )


def _asleep(num_workers: int, stages: Sequence[Stage]) -> GenerationTimes:
    """Return the times of a generation of sleeping workers, which have started before."""
    rollout_s = 0.0
    for stage in stages:
        sleep = stage.sleep_on(num_workers)
        with SleepersBackend(partial(Sleeper, sleep), num_workers, per_node=_ASLEEP.cores_per_node) as backend:
            roll_out_tasks([task.part(0, 1) for task in stage.tasks[:num_workers]], stage.generation, backend)
            start = perf_counter()
            roll_out_tasks(stage.tasks, stage.generation, backend)
            rollout_s += perf_counter() - start
    nan = float("nan")
    return GenerationTimes(start_s=nan, rollout_s=rollout_s, update_s=stages[-1].costs.update_s, busy_s=nan)


def _facts(rows: Sequence[Row]) -> dict[str, Any]:
    """Return efficiencies, and errors of the projection as fractions."""
    by_kind: dict[tuple[str, int], Row] = {(row["kind"], row["cores"]): row for row in rows}
    facts: dict[str, Any] = {}
    for (kind, cores), row in by_kind.items():
        if kind in {"measured", "projected"}:
            facts[f"{kind}_efficiency_{cores}"] = round(row["efficiency"], 3)
        if other := by_kind.get(({"measured": "projected here", "asleep": "projected asleep"}.get(kind, ""), cores)):
            facts[f"error_{kind}_{cores}"] = round(other["generation_s"] / row["generation_s"] - 1, 3)
    return facts


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows under the columns of the first one."""
    text = csv_text([list(rows[0]), *(list(map(_text, row.values())) for row in rows)])
    write_atomically(path, lambda file: file.write(text.encode()))


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def read_rows(path: Path) -> list[Row]:
    """Return the rows that `write_rows` wrote, with numbers where they are."""
    with path.open(newline="", encoding="utf-8") as file:
        return [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(file)]


def _value(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text
