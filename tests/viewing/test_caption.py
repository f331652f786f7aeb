"""Captions: all of a text where there is room, its ends where there is none."""

import numpy as np
import pytest
from PIL import ImageDraw

from shes.viewing.caption import captioned

LONG = "/home/somebody/experiments/point-gather/transfer/published/seed-3"
FACTS = ("after 80 generations", "12.3 s", "score 3.0", "time is up")


@pytest.fixture
def written(monkeypatch):
    """The lines of text that were written."""
    lines, original = [], ImageDraw.ImageDraw.text

    def text(self, place, text, *more, **options):
        lines.append(text)
        return original(self, place, text, *more, **options)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", text)
    return lines


def is_ink(picture):
    return picture.min(axis=2) > 120


@pytest.mark.parametrize("label", ["mine", LONG, "a name with many words, " * 8, "x" * 900])
@pytest.mark.parametrize("size", [64, 96, 160, 240, 320, 480, 1080])
def test_no_line_is_cut_and_half_of_the_picture_is_left(written, size, label):
    view = np.zeros((size, size, 3), np.uint8)
    picture = captioned(view, [(label, *FACTS), ("controller sees 2 values", "x -1.20", "y 3.00")])
    assert picture.shape == view.shape
    margin = 3
    assert is_ink(picture[: size // 8]).any()
    assert not is_ink(picture[:, -margin:]).any()
    assert not is_ink(picture[:, :margin]).any()
    assert not picture[size // 2 + 8 :].any()
    text = "".join(written)
    assert text.startswith(label[:2])
    if "…" not in text:
        letters = [
            c for c in "".join((label, *FACTS, "controller sees 2 values", "x -1.20", "y 3.00")) if c not in " ·"
        ]
        assert [c for c in text if c not in " ·"] == letters
    elif size >= 160:
        assert text.endswith("y 3.00")  # only the longest part is shortened


def test_a_short_caption_is_one_line_and_a_long_one_is_broken_between_its_parts(written):
    view = np.full((480, 480, 3), 255, np.uint8)
    low = captioned(view, [("mine", *FACTS), ()])
    assert written == ["mine · after 80 generations · 12.3 s · score 3.0 · time is up"]
    assert (low[28:] == 255).all()
    written.clear()
    captioned(view, [(LONG, *FACTS), ("x 1.00",)])
    assert written == [LONG, " · ".join(FACTS), "x 1.00"]
    written.clear()
    captioned(view[:240, :240], [(LONG, "untrained")])
    assert written == ["/home/somebody/experiments/point-gather/", "transfer/published/seed-3 · untrained"]


def test_where_there_is_no_room_the_middle_is_left_out(written):
    captioned(np.zeros((64, 200, 3), np.uint8), [(LONG * 2, *FACTS)])
    start, end = "".join(written).partition(" · ")[0].split("…")
    assert LONG.startswith(start)
    assert LONG.endswith(end)
    assert len(start) == pytest.approx(len(end), abs=1)
    assert "".join(written).endswith("score 3.0 · time is up")


def test_lines_are_broken_at_the_same_places_whatever_the_numbers_are(written):
    counts = set()
    for number in np.linspace(-20, 20, 41):
        written.clear()
        captioned(np.zeros((480, 480, 3), np.uint8), [[f"value of input {name} {number:.2f}" for name in "abcdefgh"]])
        counts.add(tuple(line.count("value") for line in written))
    assert len(counts) == 1
    assert len(counts.pop()) > 2
