"""Which level a generation perturbs: the signs of every member, and the populations that they fit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.es.mirror import MIRRORINGS
from shes.es.perturbation import PERTURBATIONS, ManyToMany, OneToMany, OneToManyHalves
from tests.es.textbook import group_signs

BOTH, CONTROLLER_ALONE, PRIMITIVE_ALONE = (True, True), (True, False), (False, True)
LEARNS = [BOTH, CONTROLLER_ALONE, PRIMITIVE_ALONE, (True,)]


def _signs(name, population=8, mirrored="quad", learns=BOTH, generation=0):
    return PERTURBATIONS.find(name)().signs(generation, population, mirrored, learns)


def test_many_to_many_quad_is_every_combination_of_signs_in_every_group():
    signs = _signs("many_to_many", 8)
    assert signs.tolist() == [[[1, 1], [1, -1], [-1, 1], [-1, -1]]] * 2


def test_many_to_many_pair_is_all_plus_and_all_minus():
    assert _signs("many_to_many", 6, "pair").tolist() == [[[1, 1], [-1, -1]]] * 3


def test_many_to_many_without_mirroring_is_a_group_for_each_member():
    assert _signs("many_to_many", 3, "none").tolist() == [[[1, 1]]] * 3


def test_one_to_many_takes_turns_and_begins_with_the_controller():
    controller, primitive = [[[1, 0], [-1, 0]]] * 4, [[[0, 1], [0, -1]]] * 4
    turns = [_signs("one_to_many", 8, generation=generation).tolist() for generation in range(5)]
    assert turns == [controller, primitive, controller, primitive, controller]


def test_one_to_many_halves_gives_the_first_half_of_the_population_to_the_controller():
    assert _signs("one_to_many_halves", 8).tolist() == [[[1, 0], [-1, 0]]] * 2 + [[[0, 1], [0, -1]]] * 2
    assert _signs("one_to_many_halves", 6, "none").tolist() == [[[1, 0]]] * 3 + [[[0, 1]]] * 3


@pytest.mark.parametrize("name", PERTURBATIONS)
@pytest.mark.parametrize("learns", [CONTROLLER_ALONE, PRIMITIVE_ALONE])
def test_with_a_frozen_level_every_way_perturbs_the_other_one_in_every_generation(name, learns):
    expected = np.array([[[1], [-1]]] * 4) * np.array(learns)
    for generation in range(3):
        assert np.array_equal(_signs(name, 8, learns=learns, generation=generation), expected)


@given(
    name=st.sampled_from(sorted(PERTURBATIONS)),
    mirrored=st.sampled_from(list(MIRRORINGS)),
    learns=st.sampled_from(LEARNS),
    generation=st.integers(0, 9),
    groups=st.integers(1, 6),
)
def test_signs_are_those_of_the_textbook(name, mirrored, learns, generation, groups):
    groups *= sum(learns)  # halves need a share for each level
    members = len(group_signs(mirrored, name, learns, groups, generation)[0])
    signs = PERTURBATIONS.find(name)().signs(generation, groups * members, mirrored, learns)
    assert [[tuple(member) for member in group] for group in signs.tolist()] == group_signs(
        mirrored, name, learns, groups, generation
    )
    assert signs.dtype == np.int8
    assert signs.shape == (groups, members, len(learns))
    for level, is_learning in enumerate(learns):
        of_level = signs[:, :, level]
        assert is_learning or not of_level.any()
        assert np.all(of_level.any(axis=1) == of_level.all(axis=1))  # a group perturbs a level as a whole or not at all


@given(
    name=st.sampled_from(sorted(PERTURBATIONS)),
    population=st.integers(1, 60),
    mirrored=st.sampled_from(list(MIRRORINGS)),
    learns=st.sampled_from(LEARNS),
)
def test_a_population_is_accepted_for_the_first_generation_or_never(name, population, mirrored, learns):
    way = PERTURBATIONS.find(name)()
    try:
        PERTURBATIONS.find(name)().signs(0, population, mirrored, learns)
    except ConfigError:
        for generation in (0, 1, 2):
            with pytest.raises(ConfigError):
                way.signs(generation, population, mirrored, learns)
        return
    for generation in (0, 1, 2):
        signs = way.signs(generation, population, mirrored, learns)
        assert signs.shape[0] * signs.shape[1] == population


@pytest.mark.parametrize(
    ("name", "population", "mirrored", "learns", "message"),
    [
        ("many_to_many", 10, "quad", BOTH, r"multiple of 4, .* 2 levels are perturbed, got 10\. .* 8 or 12\."),
        ("many_to_many", 7, "quad", CONTROLLER_ALONE, r"multiple of 2, .* 1 level is perturbed, got 7\. .* 6 or 8\."),
        ("one_to_many", 7, "quad", BOTH, r"multiple of 2, .* 1 level is perturbed, got 7\. .* 6 or 8\."),
        (
            "one_to_many_halves", 10, "quad", BOTH,
            r"multiple of 4, a group of 2 with 'quad' mirroring for each level that learns, got 10\. .* 8 or 12\.",
        ),
        ("one_to_many_halves", 3, "none", BOTH, r"multiple of 2, a group of 1 with 'none' .*got 3\. .* 2 or 4\."),
        ("one_to_many_halves", 3, "quad", BOTH, r"multiple of 4, .*got 3\. Set --population-size 4 or 8\."),
        ("one_to_many_halves", 0, "quad", BOTH, r"positive multiple of 4, .*got 0\. Set --population-size 4 or 8\."),
        ("one_to_many_halves", -4, "quad", BOTH, r"positive multiple of 4, .*got -4\."),
        ("one_to_many_halves", 7, "pair", CONTROLLER_ALONE, r"multiple of 2, a group of 2 .*got 7\."),
    ],
)  # fmt: skip
def test_a_population_that_does_not_fit_is_refused_with_one_that_does(name, population, mirrored, learns, message):
    with pytest.raises(ConfigError, match=message):
        PERTURBATIONS.find(name)().signs(0, population, mirrored, learns)
    for generation in (0, 1):
        with pytest.raises(ConfigError, match=message):
            PERTURBATIONS.find(name)().signs(generation, population, mirrored, learns)


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_an_unknown_mirroring_is_refused_by_every_way(name):
    with pytest.raises(UnknownNameError, match=r"mirroring 'quadd'. Did you mean 'quad'\?"):
        PERTURBATIONS.find(name)().signs(0, 8, "quadd", BOTH)


def test_an_unknown_perturbation_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"'one_to_mny'. Did you mean 'one_to_many'\?.*Set --perturbation\."):
        PERTURBATIONS.find("one_to_mny")


def test_names_make_their_classes():
    made = {name: type(PERTURBATIONS.find(name)()) for name in PERTURBATIONS}
    assert made == {"many_to_many": ManyToMany, "one_to_many": OneToMany, "one_to_many_halves": OneToManyHalves}


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_signs_belong_to_the_caller(name):
    first = _signs(name)
    before = first.copy()
    first[:] = 7
    assert np.array_equal(_signs(name), before)
