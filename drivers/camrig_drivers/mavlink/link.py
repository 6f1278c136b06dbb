"""One wire (UDP port, TCP connection, serial line) and the vehicles behind it.

Whichever worker thread calls ``serve`` serves all vehicles of the link; that takes the link's one lock, so several
drones may share a port. A vehicle is known by system, component *and* the address it speaks from.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from camrig.clock import Clock
from camrig.errors import LinkLost
from camrig_drivers.mavlink.codec import Address, Decoder, Encoder, Seals
from camrig_drivers.mavlink.packets import Heard, Heartbeat, OwnHeartbeat, Said
from camrig_drivers.mavlink.signing import Signing
from camrig_drivers.mavlink.wire import Wire, WireUrl
from camrig_drivers.udp import Peer

_HEARTBEAT_S = 1.0
_MOVED_S = 2.5
"""A vehicle on the ground that is silent for this long may come back from another port: it has been restarted."""
_MAX_PEERS = 16
_TURN_S = 0.05
"""For so long one thread serves before another one may."""


class Station(Protocol):
    """A vehicle as its link sees it; all calls come from the thread that serves."""

    key: Address

    def hear(self, packet: Heard, now_s: float) -> None:
        """Take a packet of this vehicle."""
        ...

    @property
    def may_fly(self) -> bool:
        """Whether its vehicle may be in the air, as far as is known: then no other address speaks for it."""
        ...

    def intrude(self, what: str) -> None:
        """Learn that somebody else speaks with this vehicle's system id."""
        ...

    def speak(self, now_s: float) -> Iterable[Said]:
        """Return what to send to it now."""
        ...

    def due_s(self, now_s: float) -> float:
        """Return when to call ``speak`` next."""
        ...


@dataclass
class _Seat:
    """A station, and where its vehicle speaks from; ``rival`` is who speaks in its name from elsewhere."""

    station: Station
    peer: Peer | None
    heard_s: float = 0.0
    rival: Peer | None = None
    kept_for: Peer | None = None
    """Where a vehicle spoke from when it was lost in the air."""


class Link:
    """Builds nothing but itself; the first vehicle that joins opens the wire, the last one closes it.

    A wire that fails is closed at once, so that whoever joins next opens it anew.
    """

    def __init__(self, url: str, clock: Clock, signing: Signing | None = None) -> None:
        self.url = url
        self._parsed = WireUrl.parse(url)
        self._clock = clock
        self._signing = signing
        self._door = threading.Lock()
        self._turn = threading.Lock()
        self._wire: Wire | None = None
        self._trouble = "it is closed"
        self._seats: dict[Address, _Seat] = {}
        self._strangers: set[Address] = set()
        self._lost_in_flight: dict[Address, Peer] = {}
        self._seals = Seals()
        self._encoder = Encoder()
        self._decoders: dict[Peer, Decoder] = {}
        self._heartbeat_s = 0.0

    def join(self, station: Station) -> None:
        """Take a vehicle in. Raises LinkLost, and InputError for a signing key or stamp that is not to be had."""
        with self._my_turn(), self._losing():
            if self._wire is None:
                self._open()
            assert self._wire is not None
            kept_for = None if self._wire.remote else self._lost_in_flight.get(station.key)
            self._seats[station.key] = _Seat(station, self._wire.remote, kept_for=kept_for)

    def _open(self) -> None:
        self._seals = Seals(self._signing)
        self._encoder = Encoder(self._seals)
        self._wire = self._parsed.open()
        self._heartbeat_s = self._clock.now_s()
        self._strangers.clear()
        self._decoders.clear()

    def leave(self, station: Station) -> None:
        """Forget a vehicle, but not where one that may be in the air spoke from; twice is allowed."""
        with self._my_turn():
            seat = self._seats.pop(station.key, None)
            if seat is not None and seat.peer is not None:
                self._lost_in_flight.pop(station.key, None)
                if station.may_fly:
                    self._lost_in_flight[station.key] = seat.peer
            if not self._seats:
                self._shut("it is closed")

    def _shut(self, trouble: str) -> None:
        if self._wire is not None:
            self._wire.close()
            self._wire, self._trouble = None, trouble

    @property
    def refused(self) -> int:
        """How many frames were not signed, or not by the key, since the wire was opened."""
        return self._seals.refused

    def strangers(self) -> list[Address]:
        """Return the autopilots that have been heard and that nobody here drives."""
        return sorted(self._strangers.copy())

    def serve(self, timeout_s: float, enough: Callable[[], bool]) -> None:
        """Receive and send for all vehicles until ``enough``, at most ``timeout_s``; where another thread is doing
        it already, wait for it instead. Raises LinkLost.

        Others get their turn in between: one that opens must not keep those that fly from their orders.
        """
        deadline_s = self._clock.now_s() + timeout_s
        ended = False
        while not ended:
            with self._my_turn(max(0.0, deadline_s - self._clock.now_s())) as mine, self._losing():
                ended = self._serve(deadline_s, enough) if mine else True

    def _serve(self, deadline_s: float, enough: Callable[[], bool]) -> bool:
        """Serve for one turn; return whether it is ``enough`` or the time is over."""
        turn_s = self._clock.now_s() + _TURN_S
        while self._wire is not None:
            due_s = self._exchange(self._wire)
            now_s = self._clock.now_s()
            if enough() or now_s >= deadline_s:
                return True
            if now_s >= turn_s:
                return False
            self._wire.wait(min(due_s, deadline_s, turn_s) - now_s)
        raise LinkLost(f"{self.url}: {self._trouble}")

    def wake(self) -> None:
        """Make the thread that serves look for orders now; any thread."""
        current = self._wire
        if current is not None:
            current.wake()

    def serve_now(self) -> None:
        """Receive and send at once, here or in the thread that serves already; any thread. Raises LinkLost."""
        if not self._turn.acquire(blocking=False):
            self.wake()
            return
        try:
            with self._losing():
                if self._wire is not None:
                    self._exchange(self._wire)
        finally:
            self._turn.release()

    @contextlib.contextmanager
    def _my_turn(self, timeout_s: float = -1.0) -> Iterator[bool]:
        """Wait for the link behind its door, so that the thread that had it last does not get it always."""
        with self._door:
            mine = self._turn.acquire(timeout=timeout_s)
        try:
            yield mine
        finally:
            if mine:
                self._turn.release()

    @contextlib.contextmanager
    def _losing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            trouble = str(error.strerror or error)
            self._shut(trouble)
            raise LinkLost(f"{self.url}: {trouble}") from error
        except LinkLost as error:
            self._shut(str(error))
            raise

    def _exchange(self, wire: Wire) -> float:
        """Receive all there is, send all that is due; return when more will be."""
        for peer, data in wire.received():
            now_s = self._clock.now_s()
            for address, packet in self._decoder(peer).feed(data):
                self._route(peer, address, packet, now_s)
        now_s = self._clock.now_s()
        self._send_heartbeats(wire, now_s)
        due_s = self._heartbeat_s
        for seat in self._seats.values():
            if seat.peer is not None:
                for said in seat.station.speak(now_s):
                    wire.send(self._encoder.encode(said, seat.station.key), seat.peer)
                due_s = min(due_s, seat.station.due_s(now_s))
        return due_s

    def _send_heartbeats(self, wire: Wire, now_s: float) -> None:
        if now_s < self._heartbeat_s:
            return
        self._heartbeat_s = now_s + _HEARTBEAT_S
        for peer in {seat.peer for seat in self._seats.values() if seat.peer is not None}:
            wire.send(self._encoder.encode(OwnHeartbeat(), (0, 0)), peer)

    def _decoder(self, peer: Peer) -> Decoder:
        if peer not in self._decoders:
            if len(self._decoders) >= _MAX_PEERS:
                del self._decoders[next(iter(self._decoders))]
            self._decoders[peer] = Decoder(self._seals)
        return self._decoders[peer]

    def _route(self, peer: Peer, address: Address, packet: Heard, now_s: float) -> None:
        autopilot = isinstance(packet, Heartbeat) and packet.is_autopilot
        seat = self._seats.get(address)
        if seat is None:
            if autopilot:
                self._greet_stranger(peer, address)
        elif self._speaks_for(seat, peer, now_s, autopilot=autopilot):
            seat.heard_s = now_s
            seat.station.hear(packet, now_s)

    def _greet_stranger(self, peer: Peer, address: Address) -> None:
        self._strangers.add(address)
        for (system, _), seat in self._seats.items():
            if system == address[0]:
                seat.station.intrude(f"component {address[1]} at {_text(peer)}")

    def _speaks_for(self, seat: _Seat, peer: Peer, now_s: float, *, autopilot: bool) -> bool:
        """Whether a packet comes from the seat's vehicle; a heartbeat takes a free seat, or one deserted on the ground.

        While the seat's vehicle may fly, who else speaks for it is another aircraft: set-points would move that one.
        """
        if seat.peer == peer:
            if seat.rival is not None:
                seat.station.intrude(f"the same component at {_text(seat.rival)}")
                seat.rival = None
            return True
        if not autopilot:
            return False
        if seat.peer is None and seat.kept_for not in {None, peer}:
            seat.station.intrude(
                f"one at {_text(seat.kept_for)} was lost in flight, now one speaks at {_text(peer)}; "
                "if it is the same, restart camrig"
            )
            return False
        if seat.peer is None or (now_s - seat.heard_s > _MOVED_S and not seat.station.may_fly):
            seat.peer, seat.rival = peer, None
            self._heartbeat_s = now_s
            return True
        if now_s - seat.heard_s > _MOVED_S:
            seat.station.intrude(f"the same component at {_text(peer)}")
        seat.rival = peer
        return False


def _text(peer: Peer | None) -> str:
    return f"{peer[0]}:{peer[1]}" if peer else "nowhere"
