"""Bodies and cameras tied together: what each body's pictures say, joined into one world.

Of every body, the room among them, ``start`` says from where each picture was taken. Two cameras that saw a body at one
instant are tied; a camera on a head is what the head's base is, by the angles that the head said. From what is placed
so, marks and pictures are placed that no single camera could.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import ALWAYS, ROOM, Picture, Shot, Sighted, stops
from camrig.calibrate.start import Placed, agreed, place
from camrig.geometry.arrays import Transform
from camrig.geometry.pose import invert

Node = tuple[str, int]
"""A body at an instant."""


class Links:
    """Grows until nothing more hangs together.

    ``T_world_base`` by camera: its own pose or that of its head's base; ``T_world_body`` by body and instant; the marks
    of bodies in ``placed``.
    """

    def __init__(self, setup: Setup, shots: Sequence[Shot], sighted: Sequence[Sighted]) -> None:
        self._setup = setup
        self._T_base_camera = {
            name: [head.T_base_camera(aim) for aim in stops(shots, name)] for name, head in setup.heads.items()
        }
        self._seen: dict[str, list[Sighted]] = {}
        for each in sighted:
            self._seen.setdefault(setup.body_of(each.mark), []).append(each)
        anchors = {each.mark: setup.anchors[each.mark] for each in sighted if each.mark in setup.anchors}
        self.anchored = bool(anchors)
        self.placed: dict[str, Placed] = {
            body: place(seen, anchors if body == ROOM else dict([setup.frames[body]] if body in setup.frames else []))
            for body, seen in self._seen.items()
        }
        self.T_world_base: dict[str, Transform] = {}
        self.T_world_body: dict[Node, Transform] = {}
        self._root()
        while True:
            self._join()
            self._place_bodies()
            if not self._fill():
                break

    def is_placed(self, each: Sighted) -> bool:
        """Tell whether all poses that a mark in a picture depends on are known."""
        body = self._setup.body_of(each.mark)
        placed = self.placed[body]
        return (
            each.mark in placed.marks
            and each.picture.camera in self.T_world_base
            and (body, each.picture.instant) in self.T_world_body
        )

    def keep(self, cameras: set[str]) -> None:
        """Forget the cameras of which nothing is used."""
        self.T_world_base = {name: T for name, T in self.T_world_base.items() if name in cameras}

    def T_world_mark(self, mark: str) -> Transform:
        """Return the pose of a placed mark of the room."""
        return self.T_world_body[ROOM, ALWAYS] @ self.placed[ROOM].marks[mark]

    def shared(self) -> dict[tuple[str, str], int]:
        """Return what ties each two cameras: instants at which both saw a body, and marks of the room in both."""
        names, tied = tuple(self._setup.lenses), self._by_base()
        room = {name: {each.mark for each in self._seen.get(ROOM, ()) if each.picture.camera == name} for name in names}
        return {
            (a, b): len([node for node in tied[a].keys() & tied[b].keys() if node[0] != ROOM]) + len(room[a] & room[b])
            for k, a in enumerate(names)
            for b in names[k + 1 :]
        }

    def _base_camera(self, picture: Picture) -> Transform:
        own = self._T_base_camera.get(picture.camera)
        return own[picture.stop] if own else np.eye(4)

    def _by_base(self) -> dict[str, dict[Node, Transform]]:
        """Return ``T_base_body`` of each camera by body and instant."""
        votes: dict[str, dict[Node, list[Transform]]] = {name: {} for name in self._setup.lenses}
        for body, placed in self.placed.items():
            for picture, T_camera_body in placed.pictures.items():
                T = self._base_camera(picture) @ T_camera_body
                votes[picture.camera].setdefault((body, picture.instant), []).append(T)
        return {name: {node: agreed(T) for node, T in by_node.items()} for name, by_node in votes.items()}

    def _weight(self, name: str, node: Node) -> int:
        """Return how many instants of a moving body a view is worth: of the room, as many as marks are seen."""
        if node[0] != ROOM:
            return 1
        return max(1, sum(each.picture.camera == name for each in self._seen[ROOM]))

    def _root(self) -> None:
        """Place what says where the world is: anchors, cameras whose place is known or, without either, the first."""
        if self.anchored:
            self.T_world_body[ROOM, ALWAYS] = np.eye(4)
        self.T_world_base |= self._setup.kept
        if not self.anchored and not self.T_world_base:
            tied = self._by_base()
            self.T_world_base |= {name: np.eye(4) for name in [name for name in tied if tied[name]][:1]}
        self._place_bodies()

    def _join(self) -> None:
        """Place the cameras that saw what is placed, one by one, best tied first."""
        tied = self._by_base()
        while True:
            votes = {
                name: [
                    self.T_world_body[node] @ invert(T)
                    for node, T in tied[name].items()
                    if node in self.T_world_body
                    for _ in range(self._weight(name, node))
                ]
                for name in tied
                if name not in self.T_world_base
            }
            best = max(votes, key=lambda name: len(votes[name]), default=None)
            if best is None or not votes[best]:
                return
            self.T_world_base[best] = agreed(votes[best])
            self._place_bodies()

    def _place_bodies(self) -> None:
        votes: dict[Node, list[Transform]] = {}
        for name, by_node in self._by_base().items():
            for node, T in by_node.items() if name in self.T_world_base else ():
                votes.setdefault(node, []).append(self.T_world_base[name] @ T)
        for node, seen in votes.items():
            if node not in self.T_world_body:
                self.T_world_body[node] = agreed(seen)

    def _fill(self) -> bool:
        """Place marks and pictures by what is placed in the world; tell whether that gave anything new."""
        grown = False
        for body, seen in self._seen.items():
            before = self.placed[body]
            missing = {each.mark for each in seen} - before.marks.keys()
            if not missing and {each.picture for each in seen} <= before.pictures.keys():
                continue
            after = place(seen, before.marks, {**self._from_world(body, seen), **before.pictures})
            grown |= len(after.marks) > len(before.marks) or len(after.pictures) > len(before.pictures)
            self.placed[body] = after
        return grown

    def _from_world(self, body: str, seen: Sequence[Sighted]) -> Mapping[Picture, Transform]:
        """Return ``T_camera_body`` of pictures by where camera and body are known to be."""
        found = {}
        for picture in {each.picture for each in seen}:
            node = (body, picture.instant)
            if picture.camera in self.T_world_base and node in self.T_world_body:
                T_world_camera = self.T_world_base[picture.camera] @ self._base_camera(picture)
                found[picture] = invert(T_world_camera) @ self.T_world_body[node]
        return found
