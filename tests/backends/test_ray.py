"""The ray backend on a cluster of two nodes on this machine: the same numbers, whatever happens to the nodes."""

import re
import sys
import types
from pathlib import Path

import psutil
import pytest

import shes
from shes.backends.ray import RayBackend
from shes.errors import ConfigError
from tests.backends.clusters import add_node, ray_cluster
from tests.backends.workers import Worker
from tests.e2e import runs
from tests.messages import raises

pytestmark = pytest.mark.timeout(600)  # the first test waits for the cluster


@pytest.fixture(scope="module")
def cluster():
    """A cluster of two nodes. The last tests add nodes and remove them; to start another cluster takes too long."""
    pytest.importorskip("ray")
    with ray_cluster(2) as started:
        yield started


@pytest.fixture(scope="module")
def shared(cluster):
    with RayBackend(lambda: Worker(at_once=1), sys.maxsize) as made:
        yield made


@pytest.fixture
def free_cluster(cluster, shared):
    """The same cluster without workers."""
    shared.close()
    return cluster


@pytest.fixture
def backend(shared):
    shared.told = []
    shared.on_event = shared.told.append
    shared.broadcast(100)
    return shared


def test_an_address_where_nothing_answers_is_an_error(monkeypatch):
    def init(**_):
        raise ConnectionError

    exceptions = types.SimpleNamespace(RayError=OSError)
    ray = {"is_initialized": lambda: False, "remote": lambda **_: lambda cls: cls, "exceptions": exceptions}
    monkeypatch.setitem(sys.modules, "ray", types.SimpleNamespace(**ray, init=init))
    for address in ("localhost:1", "nonsense", "auto"):
        monkeypatch.setenv("RAY_ADDRESS", address)
        message = f"no Ray cluster answers at '{address}': ... Set the environment variable RAY_ADDRESS to HOST:PORT"
        with raises(ConfigError, message):
            RayBackend(Worker, 2)


@pytest.mark.extras
def test_every_cpu_of_every_node_has_a_worker(backend, tmp_path):
    assert backend.num_workers == 2
    assert len({pid for pid, _ in backend.map([("meet", tmp_path)] * 8)}) == 2
    assert set(backend.map([("node", 0)] * 40)) == {("0", 100), ("1", 100)}


class HeardError(Exception):
    """Raised by who hears of an event."""


@pytest.mark.extras
def test_a_cluster_without_a_free_cpu_is_told_of(backend, monkeypatch):
    def hear(event):
        raise HeardError(event)

    list(backend.map([("where", 0)] * 4))  # its workers have both CPUs
    monkeypatch.setattr("shes.backends.ray.REPORTED_S", 0.05)
    with RayBackend(Worker, 1) as second:
        second.on_event, second.silence_limit_s = hear, 0.2  # a twentieth of a second between two looks
        with pytest.raises(HeardError, match="no worker has started yet: every CPU of the Ray cluster is taken"):
            list(second.map([("add", 1)]))


@pytest.mark.extras
def test_a_state_is_stored_once_for_all_workers(backend, monkeypatch):
    import ray

    stored, put = [], ray.put
    monkeypatch.setattr(ray, "put", lambda value: stored.append(value) or put(value))
    backend.broadcast(b"x" * 1_000_000)
    assert [len(state) for _, state in backend.map([("where", 0.01)] * 20)] == [1_000_000] * 20
    assert len(stored) == 1


@pytest.mark.extras
def test_a_worker_that_dies_is_replaced_and_its_tasks_done_again(backend, tmp_path):
    tasks = [("add", 1), ("die_once", tmp_path / "marker"), *[("add", i) for i in range(2, 30)]]
    assert list(backend.map(tasks)) == [101, 100, *range(102, 130)]
    (event,) = backend.told
    assert re.fullmatch(r"worker \d+ on \S+ died \(.*\); \d+ tasks are done again", event)
    assert set(backend.map([("where", 0.01)] * 4))  # it works on


@pytest.mark.extras
def test_ray_accepts_the_cluster_file():
    util = pytest.importorskip("ray.autoscaler._private.util")
    yaml = pytest.importorskip("yaml")
    config = yaml.safe_load((Path(__file__).parents[2] / "examples" / "cluster" / "ray_cluster.yaml").read_text())
    util.validate_config(util.prepare_config(config))


@pytest.mark.extras
def test_a_node_that_joins_in_mid_generation_gets_work(free_cluster):
    with RayBackend(lambda: Worker(at_once=1), 3) as backend:  # not more, whatever joins
        backend.broadcast(100)
        results = backend.map([("node", 0.05)] * 800)
        next(results)
        node = add_node(free_cluster, "new")
        assert set(results) == {("0", 100), ("1", 100), ("new", 100)}
        assert backend.num_workers == 3
    free_cluster.remove_node(node)


@pytest.mark.extras
def test_a_lost_node_and_a_resume_without_it_change_no_number(free_cluster, tmp_path, monkeypatch):
    ray, wait, nodes = pytest.importorskip("ray"), RayBackend.wait, list(free_cluster.worker_nodes)

    def end_node_and_wait(backend, timeout_s):
        if nodes and any(worker.tasks and is_on_last(worker) for worker in backend.workers):
            alive = len(alive_nodes())
            free_cluster.remove_node(nodes.pop(), allow_graceful=False)
            runs.wait_until(lambda: len(alive_nodes()) < alive, "Ray knows that the node is lost")
        return wait(backend, timeout_s)

    def alive_nodes():
        return [node for node in ray.nodes() if node["Alive"]]

    def is_on_last(worker):
        return psutil.Process(int(worker.name.partition(" ")[0])).environ()["SHES_TEST_NODE"] == "1"

    monkeypatch.setattr(RayBackend, "wait", end_node_and_wait)
    path, settings = tmp_path / "run", {"population_size": 64, "horizon": 200}
    runs.train_tiny(path, **settings, generations=8, backend="ray", chunk_size=1)
    assert not nodes
    assert any(re.search(r"; [1-9]\d* tasks are done again", line) for line in runs.log_lines(path))
    shes.resume(path, generations=10)
    assert runs.differences(runs.train_tiny(tmp_path / "longer", **settings, generations=10), path) == []
