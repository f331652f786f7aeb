"""Checks of error messages: the class of the error, and the pieces that its message must contain."""

from contextlib import contextmanager

import pytest


def check_message(text, message):
    """Check that `text` has the pieces of `message` one after another; "..." in it stands for anything."""
    rest = text
    for piece in filter(None, map(str.strip, message.split("..."))):
        _, found, rest = rest.partition(piece)
        assert found, f"{piece!r} is not in its place in {text!r}"


@contextmanager
def raises(error, message):
    """Check that the block raises `error` with such a message, and give what `pytest.raises` gives."""
    with pytest.raises(error) as caught:
        yield caught
    check_message(str(caught.value), message)
