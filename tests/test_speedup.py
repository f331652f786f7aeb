"""The projection of speed-up in `benchmarks/speedup.py`: the assumptions in its first lines, and all of it once."""

import math

import pytest

from benchmarks import speedup
from shes.machine import core_numbers
from shes.runs.make_config import make_config

TINY = {"population_size": 8, "hidden": (4,), "horizon": 10, "evaluation_horizon": 10, "noise_table_size": 1_000_000}


@pytest.mark.parametrize(
    ("share_s", "num_results", "message_s", "state_bytes", "num_workers", "seconds"),
    [
        (9.0, 4, 0.0, 0, 4, 9.0),  # the slowest worker's share, if messages cost nothing
        (9.0, 4, 0.5, 0, 4, 4 * 0.5 + 9.0 + 0.5),  # the last of four workers is asked last
        (1.0, 100, 0.5, 0, 4, 100 * 0.5 + 0.5),  # the main process handles one result after the other
        (0.0, 1, 0.0, 1_250_000_000, 24, 1.0),  # one node receives the policies once
        (0.0, 1, 0.0, 1_250_000_000, 25, 2.0),  # two nodes are two levels of a tree
        (0.0, 1, 0.0, 1_250_000_000, 600, 5.0),
    ],
)
def test_a_projection_follows_its_assumptions(share_s, num_results, message_s, state_bytes, num_workers, seconds):
    found = speedup.project(share_s, num_results, message_s, state_bytes, num_workers)
    assert found == pytest.approx(seconds, abs=10 * speedup.LATENCY_S)
    assert found >= seconds + 2 * speedup.LATENCY_S


BRANCHES = {"primitive_estimate": "interval", "primitive_view": "proprioception"}


@pytest.mark.parametrize(
    ("algorithm", "settings", "workers"),
    [("shes", BRANCHES, [1]), ("es", {}, [1]), pytest.param("shes", {}, [1, 2], marks=pytest.mark.extras)],
)
def test_speed_ups_are_measured_and_projected(algorithm, settings, workers):
    where = {"backend": "serial" if workers == [1] else "processes"}
    config = make_config("point-gather", "smoke", {**TINY, **settings, **where, "algorithm": algorithm})
    rows = list(speedup.measure_speedup(config, workers, cores=(4, 16), samples=2))
    assert [(row["kind"], row["cores"]) for row in rows] == [
        *[("alone", 1)] * len(core_numbers()[: max(workers)]),
        *[("measured", n) for n in workers],
        *[("projected", n) for n in (*workers[1:], 4, 16)],
    ]
    for row in rows:
        assert row["generation_s"] == row["rollout_s"] + row["update_s"]
        assert row["speedup"] == pytest.approx(row["efficiency"] * row["cores"])
        assert all(math.isfinite(row[name]) and row[name] > 0 for name in list(row)[2:])


def test_the_command_line_chooses_what_is_measured(monkeypatch, tmp_path):
    asked = []
    row = {"kind": "measured", "cores": 1, "generation_s": 2.0, "speedup": 1.0}
    monkeypatch.setattr(speedup, "measure_speedup", lambda *given: asked.append(given) or [row])
    words = "--env point-gather --policies 8 --algorithms es --workers 1 3 --cores 4 --integrator rk4"
    monkeypatch.setattr("sys.argv", ["speedup.py", *words.split(), "--out", str(tmp_path / "a.csv")])
    speedup.main()
    ((config, workers, cores),) = asked
    values = config.values
    assert (values["algorithm"], values["population_size"], values["integrator"]) == ("es", 8, "rk4")
    assert (workers, cores) == ([1, 3], [4])
    assert (tmp_path / "a.csv").read_text().splitlines()[1].startswith("point-gather,es,measured,1,2")
