"""What flows between threads goes through a small box that keeps the newest items (docs/decisions/0003)."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

ItemT = TypeVar("ItemT")


class Mailbox(Generic[ItemT]):
    """A bounded box between threads; when it is full the oldest item gives way. ``capacity`` 1 is "newest wins"."""

    def __init__(self, capacity: int) -> None:
        self._items: deque[ItemT] = deque(maxlen=capacity)
        self._lock = threading.Lock()

    def put(self, item: ItemT) -> None:
        """Add an item; never blocks."""
        with self._lock:
            self._items.append(item)

    def take_all(self) -> tuple[ItemT, ...]:
        """Remove and return all items, oldest first; never blocks."""
        with self._lock:
            items = tuple(self._items)
            self._items.clear()
        return items

    def newest(self) -> ItemT | None:
        """Return the newest item and leave it there; never blocks."""
        with self._lock:
            return self._items[-1] if self._items else None

    def clear(self) -> None:
        """Drop what is waiting."""
        self.take_all()
