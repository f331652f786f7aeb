"""The archive of a search for a way: what enters it, where walkers begin, and the way that comes out."""

from dataclasses import replace

import numpy as np
import pytest

from shes.evolution.state import PATIENCE, Archive
from shes.rollout.episodes import wander


def start():
    return Archive.start(np.array([[0, 0]]), np.array([[0.1, 0.2]]), state_size=3)


def entered(archive, steps, nodes, solved=()):
    """Return the archive with nodes whose states are their numbers of steps."""
    states = np.full((len(nodes), 3), np.array(steps, float)[:, None])
    return archive.entered(states, np.array(steps), np.array(nodes), is_success=np.isin(nodes, solved))


def by_cell(archive):
    """Return steps, first number of the state, node and times chosen of every cell."""
    rows = zip(archive.steps, archive.states[:, 0], archive.nodes, archive.chosen, strict=True)
    return {tuple(cell): tuple(map(int, row)) for cell, row in zip(archive.cells.tolist(), rows, strict=True)}


def grown(archive, parents, places):
    """Return the archive with more nodes."""
    chain = {"parents": parents, "positions": np.array(places, float), "places": places}
    return replace(archive, **{name: np.array([*getattr(archive, name), *chain[name]]) for name in chain})


def line(*places):
    """Return an archive with a chain of nodes at `places` after the reset."""
    return grown(start(), np.arange(len(places)), places)


def test_a_cell_keeps_the_place_reached_in_fewest_steps():
    archive = entered(line((1, 0), (-7, 2), (1, 0)), [20, 30, 20], [1, 2, 3])
    assert by_cell(archive) == {(0, 0): (0, 0, 0, 0), (1, 0): (20, 20, 1, 0), (-7, 2): (30, 30, 2, 0)}
    chosen = archive.chosen.copy()
    chosen[archive.cells.tolist().index([1, 0])] = 9
    archive = Archive(**{**vars(archive), "chosen": chosen})
    again = entered(grown(archive, [0] * 4, [(1, 0), (-7, 2), (1, 0), (0, 0)]), [10, 40, 5, 5], [4, 5, 6, 7])
    assert by_cell(again) == {(0, 0): (0, 0, 0, 0), (1, 0): (5, 5, 6, 9), (-7, 2): (30, 30, 2, 0)}
    assert by_cell(archive)[1, 0] == (20, 20, 1, 9)  # the archive before is as it was


def test_seldom_chosen_cells_with_steps_left_are_chosen_more():
    archive = entered(line((1, 0), (2, 0), (3, 0)), [10, 20, 31], [1, 2, 3])
    archive = Archive(**{**vars(archive), "chosen": np.array([3, 0, 8, 0])})
    drawn = np.bincount(archive.choose(np.random.default_rng(0), 20_000, 30), minlength=4) / 20_000
    weights = np.array([1 / 2, 1, 1 / 3, 0])
    assert drawn == pytest.approx(weights / weights.sum(), abs=0.01)
    assert set(archive.choose(np.random.default_rng(0), 50, 0)) == {0}  # there is always the reset


def test_the_way_is_the_shortest_chain_of_nodes_to_a_success():
    archive = grown(line((1, 0), (2, 0), (2, 5)), [2, 1], [(9, 9), (4, 4)])
    archive = entered(archive, [35, 20, 30], [4, 2, 3], solved=[4, 3])
    assert archive.way.tolist() == [[0.1, 0.2], [1, 0], [2, 0], [2, 5]]
    assert archive.way_steps == 30
    longer = entered(archive, [30], [5], solved=[5])
    assert longer.way_nodes is archive.way_nodes
    shorter = entered(archive, [29], [5], solved=[5])
    assert (shorter.way.tolist(), shorter.way_steps) == ([[0.1, 0.2], [1, 0], [4, 4]], 29)


def test_a_follower_begins_in_a_cell_of_the_way_as_it_is_now():
    archive = grown(line((3, 0), (2, 0), (1, 0), (0, 9)), [0, 5], [(2, 0), (0, 9)])  # cells are sorted by coordinates
    archive = entered(archive, [10, 20, 30, 40], [1, 2, 3, 4], solved=[4])
    archive = entered(archive, [12, 17], [5, 6]).after_slice()  # its second and last cell are reached in fewer steps
    for last_step, begun in ((30, {0: 0, 1: 10, 2: 12, 3: 30}), (29, {0: 0, 1: 10, 2: 12}), (0, {0: 0})):
        cells, numbers = archive.choose_on_way(np.random.default_rng(0), 200, last_step)
        assert dict(zip(numbers.tolist(), archive.steps[cells].tolist(), strict=True)) == begun
    assert archive.way.tolist() == [[0.1, 0.2], [3, 0], [2, 0], [1, 0], [0, 9]]
    assert sorted(archive.starts[:, 0]) == [10, 12, 30]  # so do episodes of training, but not at the reset


def test_nobody_begins_where_a_walker_lay():
    archive = entered(line((1, 0), (20, 0), (3, 0), (4, 0)), [10, 30, 40], [1, 3, 4], solved=[4]).after_slice()
    cells, numbers = archive.choose_on_way(np.random.default_rng(0), 200, 100)
    assert dict(zip(numbers.tolist(), archive.steps[cells].tolist(), strict=True)) == {0: 0, 1: 10, 3: 30}
    assert sorted(archive.starts[:, 0]) == [10, 30]
    later = entered(grown(archive, [0], [(20, 0)]), [90], [len(archive.parents)]).after_slice()
    assert sorted(later.starts[:, 0]) == [10, 30]  # there, somebody stood later than at the target


def test_a_walk_begins_in_any_direction():
    first = wander(np.random.default_rng(0), 3, 4000)[0]
    assert np.histogram(first, 4, (-np.pi, np.pi))[0] == pytest.approx(1000, abs=150)


def test_a_slice_forgets_nodes_that_lead_to_no_cell():
    archive = grown(line((1, 0), (2, 0), (2, 5)), [1, 4], [(7, 7), (8, 8)])  # nodes 4 and 5
    archive = entered(archive, [30], [5]).after_slice()
    assert archive.positions.tolist() == [[0.1, 0.2], [1, 0], [7, 7], [8, 8]]
    assert archive.parents.tolist() == [0, 0, 1, 2]
    assert archive.cells.tolist() == archive.positions[archive.nodes].round().tolist() == [[0, 0], [8, 8]]


def test_a_search_ends_slices_after_its_last_shorter_way():
    archive = line((1, 0))
    for _ in range(2 * PATIENCE):
        archive = archive.after_slice()
    assert (archive.stalled, archive.is_over) == (0, False)  # no way is known
    for steps in (30, 20):
        archive, node = grown(archive, [0], [(1, 0)]), len(archive.parents)
        archive = entered(archive, [steps], [node], solved=[node]).after_slice()
        for number in range(1, PATIENCE):
            archive = archive.after_slice()
            assert (archive.stalled, archive.is_over) == (number, False)
    going_on, archive = (archive.after_slice(goes_on=each) for each in (True, False))
    assert (going_on.is_over, archive.is_over, archive.states.shape, len(archive.cells)) == (False, True, (0, 3), 2)


def test_news_of_a_search_are_told_once():
    before = start()
    begun = entered(line((1, 0)), [10], [1])
    known = entered(begun, [20], [1], solved=[1])
    assert before.news(before) == known.news(known) == []
    assert begun.news(before) == ["the search for a way begins"]
    assert known.news(begun) == ["a way of 20 steps is known after 0 environment steps of search"]
    over = replace(known, states=known.states[:0])
    assert over.news(before)[2:] == over.news(known) == ["the search is over: the way has 20 steps"]
