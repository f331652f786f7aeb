"""Random streams: every purpose and key has its own, and none ever changes."""

import re
from itertools import product
from pathlib import Path

import shes
from shes.streams import EpisodePurpose, Purpose, stream


def test_every_purpose_and_key_has_its_own_stream():
    keys = [(), (0,), (1,), (0, 0), (0, 1), (1, 0)]
    runs = [stream(seed, purpose, *key) for seed, purpose, key in product((0, 1), Purpose, keys)]
    episodes = [stream(seed, purpose) for seed, purpose in product((0, 1), EpisodePurpose)]
    for streams in (runs, episodes):
        assert len({each.integers(2**63).item() for each in streams}) == len(streams)


def test_the_streams_of_a_run_never_change():
    # A change here changes the results of every run: say so in the CHANGELOG.
    assert {purpose.name.lower(): purpose.value for purpose in Purpose} == {
        "initial_parameters": 0, "noise_index": 1, "training_episodes": 2, "evaluation_episodes": 3,
        "statistics_sample": 4, "fresh_episodes": 5, "snapshots": 7, "branches": 8, "exploration": 9, "replay": 10,
        "archive": 11, "starts": 12,
    }  # fmt: skip
    assert [purpose.name for purpose in EpisodePurpose] == ["RESET", "EXPLORATION_NOISE", "RANDOM_GOALS", "WANDERING"]
    assert stream(7, Purpose.BRANCHES, 3, 1).integers(10**6, size=3).tolist() == [208427, 417556, 366066]


def test_no_module_draws_twice_for_one_purpose():
    sources = {path: path.read_text(encoding="utf-8") for path in Path(shes.__file__).parent.rglob("*.py")}
    assert [path.name for path, text in sources.items() if "SeedSequence" in text] == ["streams.py"]
    for purposes in (Purpose, EpisodePurpose):
        pattern = rf"\b{purposes.__name__}\.([A-Z_]+)"
        uses = [(path, name) for path, text in sources.items() for name in re.findall(pattern, text)]
        assert len(uses) == len(set(uses))
        assert {name for _, name in uses} == set(purposes.__members__)
