"""Overhead of the backends over that of processes: the time of one generation of Ant Gather at the paper's size.

`python benchmarks/backends.py --out results/backends.csv`: every round measures each backend in a process of its own,
one after the other, on the same work: the first generation of a run, after a few episodes that start the workers.
Prints medians over the rounds, and the median ratio to processes in the same round. Needs the extras `ray` and `mpi`
and an idle machine; with two cores, five to twelve minutes for a round.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from pathlib import Path
from time import perf_counter

from run import write_csv

from shes.cli.bench import evolution_strategy
from shes.evolution.algorithm import evolve
from shes.rollout.roll_out import roll_out_tasks
from shes.runs.build import build_backend
from shes.runs.make_config import make_config

BACKENDS = ("processes", "ray", "mpi")
OPEN_MPI = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # one rank more than cores
}


def measure(backend: str, preset: str, workers: int) -> float:
    """Return the seconds of a generation: its rollouts and its update."""
    os.environ["RAY_ADDRESS"] = "local"  # not a cluster that happens to run here
    config = make_config("ant-gather", preset, {"integrator": "euler", "backend": backend, "num_workers": workers})
    algorithm = evolution_strategy(config)
    state = algorithm.start(config.run.seed)
    with build_backend(config, algorithm.plan()) as started:
        settings = algorithm.hyperparameters
        work = settings.estimates[0](state, settings, algorithm.table.size, ())
        roll_out_tasks([task.part(0, 1) for task in work.tasks[:workers]], work.generation, started)
        start = perf_counter()
        next(evolve(state, algorithm.hyperparameters, algorithm.table, started))
        return perf_counter() - start


def command_for(backend: str, preset: str, workers: int) -> list[str]:
    """Return the command that prints the measurement of `backend`."""
    words = [str(Path(__file__)), "--measure", backend, "--preset", preset, "--workers", str(workers)]
    if backend != "mpi":
        return [sys.executable, *words]
    here = Path(sys.executable).parent / "mpiexec"
    return [
        str(here) if here.exists() else "mpiexec",
        "-n",
        str(workers + 1),
        sys.executable,
        "-m",
        "mpi4py.futures",
        *words,
    ]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--measure", choices=BACKENDS, help="print the seconds of one backend")
    asked = parser.parse_args()
    if asked.measure:
        print(measure(asked.measure, asked.preset, asked.workers))
        return
    rows: list[dict[str, object]] = []
    for number in range(asked.rounds):
        for backend in BACKENDS:
            command = command_for(backend, asked.preset, asked.workers)
            done = subprocess.run(
                command, env={**os.environ, **OPEN_MPI}, check=True, stdout=subprocess.PIPE, text=True
            )
            seconds = float(done.stdout.split()[-1])
            rows.append({"backend": backend, "round": number, "generation_s": round(seconds, 2)})
            print(f"{backend}: {seconds:.2f} s", flush=True)
    found = {name: [float(str(row["generation_s"])) for row in rows if row["backend"] == name] for name in BACKENDS}
    for name, times in found.items():
        ratio = statistics.median(each / own for each, own in zip(times, found["processes"], strict=True))
        print(f"{name}: median {statistics.median(times):.2f} s, {ratio:.3f} of processes")
    if asked.out:
        write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
