"""The one thing that threads share: bounded, newest wins, nothing lost or doubled that fits."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.runtime.mailbox import Mailbox


@pytest.fixture
def busy_switching() -> Iterator[None]:
    """Let threads interrupt each other as often as the interpreter can."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before_s)


def test_one_place_keeps_the_newest() -> None:
    box: Mailbox[str] = Mailbox(1)
    box.put("old")
    box.put("new")
    assert box.take_all() == ("new",)
    assert box.take_all() == ()


def test_looking_leaves_the_newest_there() -> None:
    box: Mailbox[int] = Mailbox(3)
    assert box.newest() is None
    box.put(1)
    box.put(2)
    assert box.newest() == 2
    assert box.take_all() == (1, 2)
    assert box.newest() is None


def test_clearing_drops_what_waits() -> None:
    box: Mailbox[int] = Mailbox(2)
    box.put(1)
    box.clear()
    assert box.take_all() == ()


@given(st.integers(1, 5), st.lists(st.one_of(st.none(), st.integers())))
def test_it_holds_the_newest_of_what_was_put_since_the_last_taking(capacity: int, doings: list[int | None]) -> None:
    box: Mailbox[int] = Mailbox(capacity)
    expected: list[int] = []
    for item in doings:
        if item is None:
            assert box.take_all() == tuple(expected)
            expected = []
        else:
            box.put(item)
            expected = [*expected, item][-capacity:]
    assert box.newest() == (expected[-1] if expected else None)


@pytest.mark.usefixtures("busy_switching")
def test_nothing_is_lost_doubled_or_reordered_between_threads() -> None:
    writers, each = 4, 500
    box: Mailbox[tuple[int, int]] = Mailbox(writers * each)
    taken: list[tuple[int, int]] = []
    done = threading.Event()

    def write(writer: int) -> None:
        for number in range(each):
            box.put((writer, number))

    def read() -> None:
        while not done.is_set():
            taken.extend(box.take_all())

    threads = [threading.Thread(target=write, args=(writer,)) for writer in range(writers)]
    reader = threading.Thread(target=read)
    for thread in (reader, *threads):
        thread.start()
    for thread in threads:
        thread.join()
    done.set()
    reader.join()
    taken.extend(box.take_all())
    for writer in range(writers):
        assert [number for who, number in taken if who == writer] == list(range(each))
