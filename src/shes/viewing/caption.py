"""Captions of videos: a bar of text at the upper edge of a picture, in as many lines as it needs."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from shes.drawing.drawer import Picture

_BAR, _INK = (28, 32, 38, 200), (240, 243, 246)
_FONT_PIXELS = (8, 14)
"""Smallest and largest font size; in between, a picture has room for a number of letters."""
_LETTERS = 48
_GAP = " · "
_MOST_OF_HEIGHT = 0.5
_SHORTEST = 5
"""Letters of a part of a caption that are always left."""


def captioned(view: Picture, paragraphs: Sequence[Sequence[str]]) -> Picture:
    """Return `view` with the parts of each paragraph in a bar at its upper edge.

    A line is broken between parts where that is possible. If the bar would cover more than half of the picture, the
    longest parts are shortened in the middle.
    """
    image = Image.fromarray(view)
    draw = ImageDraw.Draw(image, "RGBA")
    lines, size = _laid_out(tuple(map(tuple, paragraphs)), image.width, image.height)
    font, step, edge = ImageFont.load_default(size), _line_pixels(size), size // 2
    draw.rectangle([0, 0, image.width, step * len(lines) + edge - 1], _BAR)
    for number, text in enumerate(lines):
        draw.text((edge, step * (number + 0.5) + edge / 2), text, _INK, font, anchor="lm")
    return np.asarray(image)


def _line_pixels(font_size: int) -> int:
    return round(1.5 * font_size)


@lru_cache(maxsize=64)
def _laid_out(paragraphs: tuple[tuple[str, ...], ...], width: int, height: int) -> tuple[tuple[str, ...], int]:
    """Return the lines of a caption for a picture of this size in pixels, and the size of their font."""
    smallest, largest = _FONT_PIXELS
    size = min(max(2 * width // _LETTERS, smallest), largest)
    font = ImageFont.load_default(size)
    most = max(1, int(_MOST_OF_HEIGHT * height) // _line_pixels(size))

    def fits(text: str) -> bool:
        # Numbers have a constant width, so that lines are not broken at other places from frame to frame.
        return font.getlength(re.sub(r"-?\d+(?=\.\d)", "-00", text)) <= width - size

    def lines(limit: int) -> list[str]:
        return [text for parts in paragraphs for text in _broken([_shortened(each, limit) for each in parts], fits)]

    longest = max((len(part) for parts in paragraphs for part in parts), default=0)
    limits = range(_SHORTEST, longest + 1)
    too_long = bisect_left(limits, True, key=lambda limit: len(lines(limit)) > most)
    return tuple(lines(_SHORTEST + max(too_long - 1, 0))[:most]), size


def _shortened(text: str, limit: int) -> str:
    """Return `text` with at most `limit` letters: of a longer one the middle is left out."""
    if len(text) <= limit:
        return text
    end = (limit - 1) // 2
    return f"{text[: limit - 1 - end]}…{text[-end:]}"


def _broken(parts: Sequence[str], fits: Callable[[str], bool]) -> list[str]:
    """Return the lines of `parts`, in which a part begins a new line if it does not fit."""
    lines: list[str] = []
    for part in parts:
        if lines and fits(lines[-1] + _GAP + part):
            lines[-1] += _GAP + part
        else:
            lines += _broken_part(part, fits)
    return lines


def _broken_part(text: str, fits: Callable[[str], bool]) -> list[str]:
    """Return the lines of a `text` that may be too long for one: broken after a space or a slash, or anywhere."""
    lines: list[str] = []
    while not fits(text):
        most = max(1, bisect_left(range(1, len(text)), True, key=lambda count, left=text: not fits(left[:count])))
        end = max(text.rfind(mark, 0, most) for mark in " /") + 1 or most
        lines.append(text[:end])
        text = text[end:]
    return [*lines, text]
