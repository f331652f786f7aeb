"""A soak test: training whose workers and whose main process are killed again and again, against an undisturbed run.

`python benchmarks/soak.py --out results/soak` (extra `ray`; about two hours) trains Point Gather for 45 minutes on a
Ray cluster of this machine. Every 20 seconds a random worker is killed, and three times the main process, after which
the run is resumed. The memory of every process is sampled, Ray's own ones included. Then a serial run without any
disturbance makes as many generations, and the two are compared: every array of the last checkpoint, and every column of
the tables but times.

Writes `soak.csv` (what was done and found), `memory.csv` (every sample: process, age, resident memory) and `soak.log`.
`--backend processes` needs no extra. Exit code 1 if any number differs.
"""

from __future__ import annotations

import argparse
import csv
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory
from time import monotonic, sleep, time
from typing import Any

import numpy as np
import psutil
from run import write_csv

from shes.runs.folder import provenance
from shes.runs.tables import read_csv

SAMPLE_S = 5.0
SHES = [sys.executable, "-m", "shes"]


@contextmanager
def ray_cluster() -> Iterator[list[str]]:
    """Start a Ray cluster on this machine, with a token of its own; yield the flags that use it."""
    os.environ |= {"RAY_ADDRESS": "127.0.0.1:6399", "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token_hex(32)}
    ray = str(Path(sys.executable).with_name("ray"))
    start = [ray, "start", "--head", "--port", "6399", "--num-cpus", "2", "--include-dashboard", "false"]
    subprocess.run(start, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield ["--backend", "ray"]
    finally:
        subprocess.run([ray, "stop", "--force"], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@contextmanager
def no_cluster() -> Iterator[list[str]]:
    """Yield the flags of worker processes."""
    yield ["--backend", "processes"]


class Soak:
    """A run under disturbance."""

    def __init__(self, path: Path, flags: list[str], backend: str, log: Path, seed: int) -> None:
        """Train into `path` with `flags`, which choose `backend`; log to `log`. `seed` chooses the victims."""
        self.path, self.flags, self.backend = path, flags, backend
        self.samples: list[dict[str, Any]] = []
        self.worker_kills = self.main_kills = 0
        self._random = np.random.default_rng(seed)
        self._log = log.open("w")
        self._start = monotonic()
        self._main: subprocess.Popen[bytes] | None = None

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return monotonic() - self._start

    def begin(self) -> None:
        """Start the run, or resume it."""
        if (self.path / "checkpoints" / "last.npz").is_file():
            words = ["resume", str(self.path), *self.flags]
        else:
            words = ["train", "point-gather", "--generations", "1000000", "--workers", "2", *self.flags]
            words += ["--out", str(self.path)]
        self._main = subprocess.Popen([*SHES, *words], stdout=self._log, stderr=self._log)

    def workers(self) -> list[psutil.Process]:
        """Return the workers that live: actors of the cluster, or children of the main process."""
        assert self._main is not None
        if self.backend == "ray":
            return [each for each in psutil.process_iter(["name"]) if "ray::RayActor" in (each.info["name"] or "")]
        return psutil.Process(self._main.pid).children()

    def daemons(self) -> list[psutil.Process]:
        """Return the processes of the cluster that manage it."""
        names = ("raylet", "gcs_server")
        return [each for each in psutil.process_iter(["name"]) if each.info["name"] in names]

    def kill_worker(self) -> None:
        """Kill a random worker."""
        workers = self.workers()
        if workers:
            with suppress(psutil.NoSuchProcess):
                workers[self._random.integers(len(workers))].kill()
                self.worker_kills += 1

    def kill_main(self) -> None:
        """Kill the main process, and resume the run."""
        assert self._main is not None
        self._main.kill()
        self._main.wait()
        self.main_kills += 1
        self.begin()

    def check(self) -> None:
        """Raise if the run has ended by itself."""
        assert self._main is not None
        if self._main.poll() is not None:
            raise SystemExit(f"the run ended with exit code {self._main.returncode}; see {self._log.name}")

    def sample(self) -> None:
        """Note the memory of every process."""
        assert self._main is not None
        kinds = {"main": [psutil.Process(self._main.pid)], "worker": self.workers(), "ray": self.daemons()}
        for kind, process in ((kind, each) for kind, group in kinds.items() for each in group):
            with suppress(psutil.NoSuchProcess):
                if process.status() == psutil.STATUS_ZOMBIE:
                    continue
                self.samples.append({
                    "time_s": round(self.seconds, 1),
                    "process": f"{kind} {process.pid}",
                    "name": process.name(),
                    "age_s": round(time() - process.create_time()),
                    "rss_mb": round(process.memory_info().rss / 1e6, 1),
                })  # fmt: skip

    def abandon(self) -> None:
        """Kill the main process if it runs still: the soak was interrupted."""
        if self._main is not None and self._main.poll() is None:
            self._main.kill()
            self._main.wait()

    def end(self) -> int:
        """Stop the run as Ctrl-C does, and let it end with the next generation; return its number of generations."""
        assert self._main is not None
        self._main.send_signal(signal.SIGINT)
        self._main.wait(timeout=120)
        generations = int(read_csv(self.path / "progress.csv")["generation"][-1]) + 1
        # The last generation of a run is evaluated; that of one that was stopped may not be.
        last = ["resume", str(self.path), *self.flags, "--generations", str(generations)]
        subprocess.run([*SHES, *last], check=True, timeout=600, stdout=self._log, stderr=self._log)
        self._log.close()
        return generations


def numbers(path: Path) -> dict[str, np.ndarray]:
    """Return every array of the last checkpoint, and every column of the tables but times and rates, by name."""
    with np.load(path / "checkpoints" / "last.npz") as arrays:
        found = {name: arrays[name] for name in arrays.files}
    for table in ("progress.csv", "evaluation.csv"):
        with (path / table).open(newline="") as file:
            header, *rows = csv.reader(file)
        for column, name in enumerate(header):
            if not name.endswith("_s"):
                found[f"{table}: {name}"] = np.array([row[column] for row in rows])
    return found


def growth_of_lives(samples: list[dict[str, Any]], kind: str) -> float:
    """Return the largest growth of a process's memory from the first to the second half of its life, in MB.

    The first 30 seconds are left out, and so are processes with fewer than eight samples.
    """
    lives = [
        [each["rss_mb"] for each in samples if each["process"] == name and each["age_s"] >= 30]
        for name in {each["process"] for each in samples if each["process"].startswith(kind)}
    ]
    grown = [np.median(life[len(life) // 2 :]) - np.median(life[: len(life) // 2]) for life in lives if len(life) >= 8]
    return float(max(grown, default=np.nan))


def growth_of_workers(samples: list[dict[str, Any]], length_s: float) -> float:
    """Return the growth of the workers' memory from the first third of the soak to the last, in MB.

    No worker lives for long: medians at an age of 10 to 60 seconds.
    """
    own = [each for each in samples if each["process"].startswith("worker") and 10 <= each["age_s"] <= 60]
    first = [each["rss_mb"] for each in own if each["time_s"] < length_s / 3]
    last = [each["rss_mb"] for each in own if each["time_s"] > 2 * length_s / 3]
    return float(np.median(last) - np.median(first)) if first and last else float("nan")


def main() -> None:
    """Disturb a run, repeat it undisturbed, compare, and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the tables")
    parser.add_argument("--minutes", type=float, default=45.0, help="length of the disturbed run")
    parser.add_argument("--every", type=float, default=20.0, help="seconds between two kills of a worker")
    parser.add_argument("--main-kills", type=int, default=3, help="kills of the main process")
    parser.add_argument("--backend", choices=["ray", "processes"], default="ray", help="backend of the disturbed run")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    length = 60 * asked.minutes
    with TemporaryDirectory() as folder:
        disturbed, serial = Path(folder) / "disturbed", Path(folder) / "serial"
        with ray_cluster() if asked.backend == "ray" else no_cluster() as flags, ExitStack() as stack:
            soak = Soak(disturbed, flags, asked.backend, asked.out / "soak.log", seed=1)
            stack.callback(soak.abandon)
            soak.begin()
            main_kills = [length * (i + 1) / (asked.main_kills + 1) for i in range(asked.main_kills)]
            next_kill, next_sample = asked.every, SAMPLE_S
            while soak.seconds < length:
                sleep(0.2)
                soak.check()
                if main_kills and soak.seconds > main_kills[0]:
                    main_kills.pop(0)
                    soak.kill_main()
                if soak.seconds > next_kill:
                    next_kill += asked.every
                    soak.kill_worker()
                if soak.seconds > next_sample:
                    next_sample += SAMPLE_S
                    soak.sample()
            generations = soak.end()
        print(f"{generations} generations; {soak.worker_kills} workers and {soak.main_kills} main processes killed")
        words = ["train", "point-gather", "--generations", str(generations), "--backend", "serial"]
        subprocess.run([*SHES, *words, "--out", str(serial)], check=True, stdout=subprocess.DEVNULL)
        first, second = numbers(disturbed), numbers(serial)
    same = [name for name in first if name in second and np.array_equal(first[name], second[name], equal_nan=False)]
    different = sorted(first.keys() ^ second.keys() | (first.keys() & second.keys()) - set(same))
    write_csv(asked.out / "memory.csv", soak.samples)
    facts = {
        "backend": asked.backend,
        "minutes": asked.minutes,
        "generations": generations,
        "workers killed": soak.worker_kills,
        "main processes killed": soak.main_kills,
        "arrays and columns compared": len(first),
        "arrays and columns that differ": len(different),
        "workers sampled": len({each["process"] for each in soak.samples if each["process"].startswith("worker")}),
        "largest growth of a main process in its life, MB": round(growth_of_lives(soak.samples, "main"), 1),
        "largest growth of a worker in its life, MB": round(growth_of_lives(soak.samples, "worker"), 1),
        "growth of workers of the same age over the soak, MB": round(growth_of_workers(soak.samples, length), 1),
        "largest growth of a process of Ray, MB": round(growth_of_lives(soak.samples, "ray"), 1),
        "commit": provenance("cpu")["git_commit"],
    }
    write_csv(asked.out / "soak.csv", [{"measure": name, "value": value} for name, value in facts.items()])
    for name, value in facts.items():
        print(f"{name}: {value}")
    if different:
        raise SystemExit(f"different: {', '.join(different)}")


if __name__ == "__main__":
    main()
