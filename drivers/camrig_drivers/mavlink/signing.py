"""MAVLink 2 signing of one link: the key, and time stamps that never go back.

A receiver refuses stamps that are not above the last one of the link, so a clock set back would silence us: the highest
stamp that may have been used is kept on disk, ahead of its use, and a new session starts above it.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from pathlib import Path

from camrig.errors import InputError

_log = logging.getLogger(__name__)

_EPOCH_S = 1_420_070_400
"""2015-01-01, from which stamps count in units of 10 us."""
_UNITS_PER_S = 100_000
_RESERVED = 15 * _UNITS_PER_S
_KEY_BYTES = 32


def read_key(path: Path) -> bytes:
    """Return the 32 bytes of a key file, which holds them raw or as 64 hexadecimal digits; raises InputError."""
    try:
        data, mode = path.read_bytes(), path.stat().st_mode
    except OSError as error:
        raise InputError(f"signing key {path} cannot be read: {error.strerror or error}") from error
    if mode & 0o007:
        raise InputError(f"signing key {path} is open to everybody on this host: chmod o= {path}")
    if len(data) == _KEY_BYTES:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != _KEY_BYTES:
        raise InputError(
            f"signing key {path} must hold 32 bytes or 64 hexadecimal digits: openssl rand -hex 32 > {path}"
        )
    return key


def state_folder() -> Path:
    """Return where stamps are kept: systemd's state directory, else the user's."""
    if systemd := os.environ.get("STATE_DIRECTORY"):
        return Path(systemd.split(":")[0])
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "camrig"


class Signing:
    """What a link signs with. The first ``begin`` raises InputError where the stamp cannot be kept.

    A disk that fills up later ends no flight: stamps still ascend, and what was kept matters only to the next session
    of a clock that was set back.
    """

    def __init__(
        self, key_file: Path, link_id: int, folder: Path | None = None, wall_s: Callable[[], float] = time.time
    ) -> None:
        self.key_file = key_file
        self.link_id = link_id
        self.key = b""
        self._store = (folder or state_folder()) / f"mavlink-signing-{link_id}"
        self._wall_s = wall_s
        self._limit = 0
        self._last = 0

    def begin(self) -> int:
        """Read the key anew; return a stamp above all that this link has used.

        Only the first time does that go by what is kept: a link that is opened again and again while its vehicle is
        switched off must not run ahead, for whoever is a minute behind is not heard.
        """
        self.key = read_key(self.key_file)
        if not self._last:
            kept = self._kept()
            self._keep(max(self._now(), kept) + _RESERVED)
            self._last = kept
        return self.stamp(self._last + 1)

    def _kept(self) -> int:
        try:
            return int(self._store.read_text("ascii"))
        except (OSError, ValueError):
            return 0

    def stamp(self, at_least: int) -> int:
        """Return the stamp of the next frame: now, or ``at_least`` where that is later."""
        self._last = stamp = max(self._now(), at_least)
        if stamp >= self._limit:
            try:
                self._keep(stamp + _RESERVED)
            except InputError as error:
                _log.error("%s; signed on without", error)
        return stamp

    def _now(self) -> int:
        return int((self._wall_s() - _EPOCH_S) * _UNITS_PER_S)

    def _keep(self, limit: int) -> None:
        self._limit = limit
        fresh = self._store.with_suffix(".new")
        try:
            self._store.parent.mkdir(parents=True, exist_ok=True)
            fresh.write_text(f"{limit}\n", "ascii")
            fresh.replace(self._store)
        except OSError as error:
            raise InputError(
                f"the stamp of signing link {self.link_id} cannot be kept at {self._store}: {error.strerror or error}"
            ) from error
