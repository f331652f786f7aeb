"""Captions: as much of a text as there is room for, and the inputs of a controller in words."""

import numpy as np
import pytest

from shes.viewing.playback import Playback, input_words
from shes.viewing.render import captioned

LONG = "/home/somebody/experiments/point-gather/transfer/published/seed-3"
FACTS = ("after 80 generations", "12.3 s", "score 3.0", "time is up")


@pytest.mark.parametrize("label", ["mine", LONG, "x" * 200])
@pytest.mark.parametrize("size", [64, 160, 1080])
def test_no_line_is_cut_and_half_of_the_picture_is_left(size, label):
    picture = captioned(np.zeros((size, size, 3), np.uint8), [(label, *FACTS), ("controller saw 2 values", "x -1.20")])
    ink = picture.min(axis=2) > 120
    assert ink[: size // 4].any()
    assert not ink[:, -3:].any()
    assert not ink[:, :3].any()
    assert not picture[size // 2 + 8 :].any()


def test_a_text_that_is_too_long_is_shortened_in_its_middle():
    texts = ("a" + "x" * 98 + "b", "a" + "x" * 48 + "y" + "x" * 49 + "b", "c" + "x" * 98 + "b", "a" + "x" * 98 + "c")
    whole, *others = (captioned(np.zeros((64, 200, 3), np.uint8), [[text]]) for text in texts)
    assert [(each == whole).all() for each in others] == [True, False, False]


def test_three_inputs_of_one_word_are_listed_and_four_are_not():
    names = ["food_1", "food_2", "food_3", "wall_1", "wall_2", "wall_3", "wall_4"]
    listed = ("food 1 0.00", "food 2 1.00", "food 3 2.00", "4 of wall up to 6.00")
    assert input_words(names, np.arange(7.0)) == ("controller saw 7 values", *listed)


def test_inputs_are_those_of_a_controller_and_shown_if_asked_for(tiny_run, kinds):
    def shown(run, **settings):
        return next(Playback(run, "best", **settings).play(3)).inputs

    first, *others = shown(tiny_run, sensors=True)
    assert first == "controller saw 25 values"
    summed = [word.split(" up to ")[0] for word in others if " of " in word]
    assert summed == ["4 of torso", "10 of food", "10 of poison"]
    assert shown(tiny_run) == shown(kinds["flat"], sensors=True) == ()
