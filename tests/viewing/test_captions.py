"""Captions: as much of a text as there is room for, and the inputs of a controller in words."""

import numpy as np
import pytest

from shes.viewing.playback import Playback
from shes.viewing.render import captioned

LONG = "/home/somebody/experiments/point-gather/transfer/published/seed-3"
FACTS = ("after 80 generations", "12.3 s", "score 3.0", "time is up")


@pytest.mark.parametrize("label", ["mine", LONG, "x" * 200])
@pytest.mark.parametrize("size", [64, 160, 1080])
def test_no_line_is_cut_and_half_of_the_picture_is_left(size, label):
    picture = captioned(np.zeros((size, size, 3), np.uint8), [(label, *FACTS), ("controller sees 2 values", "x -1.20")])
    ink = picture.min(axis=2) > 120
    assert ink[: size // 4].any()
    assert not ink[:, -3:].any()
    assert not ink[:, :3].any()
    assert not picture[size // 2 + 8 :].any()


def test_inputs_are_those_of_a_controller_and_shown_if_asked_for(tiny_run, kinds):
    def shown(run, **settings):
        return next(Playback(run, "best", **settings).play(3)).inputs

    first, *others = shown(tiny_run, sensors=True)
    assert first == "controller sees 25 values"
    summed = [word.split(" up to ")[0] for word in others if " of " in word]
    assert summed == ["4 of torso", "10 of food", "10 of poison"]
    assert shown(tiny_run) == shown(kinds["flat"], sensors=True) == ()
