"""Which poses a calibration adjusts, in which order, and how what pictures show hangs on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from camrig.calibrate.chains import Chains, Indices
from camrig.calibrate.links import Links
from camrig.calibrate.normal import Priors, TagViews
from camrig.calibrate.setup import OnHead, Setup
from camrig.calibrate.sighted import ROOM, Shot, Sighted, stops
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens

_MOUNT_SIGMA = np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1])
"""One sigma of how a camera sits on a head, in metres and radians, before the pictures said anything."""

_CORNERS = 4
"""Of a view; a board with more is several views."""


class Poses:
    """All poses of a calibration: bases (cameras or what carries them), stops, mounts, bodies by instant, marks.

    ``start`` (n, 4, 4), ``held`` (n,), ``priors``; ``views`` of the sighted, and ``row`` (m,) which of them each is.
    """

    def __init__(self, setup: Setup, links: Links, shots: Sequence[Shot], sighted: Sequence[Sighted]) -> None:
        self._setup = setup
        self._place: dict[tuple[str, str, int], int] = {}
        self._T: list[Transform] = []
        self._held: list[bool] = []
        self._priors: list[tuple[int, Array]] = []
        free = {name: name not in setup.kept for name in links.T_world_base}
        if not links.anchored and all(free.values()):
            free[next(iter(free))] = False
        for name, T in links.T_world_base.items():
            self._add(("base", name, 0), T, free[name])
            if name in setup.heads:
                seen_at = {each.picture.stop for each in sighted if each.picture.camera == name}
                aims = {k: aim_rad for k, aim_rad in enumerate(stops(shots, name)) if k in seen_at}
                self._add_head(name, setup.heads[name], aims)
        seen = list(dict.fromkeys((setup.body_of(each.mark), each.mark) for each in sighted))
        nodes = {(setup.body_of(each.mark), each.picture.instant) for each in sighted}
        for body, instant in sorted(nodes):
            if body != ROOM:
                self._add(("body", body, instant), links.T_world_body[body, instant], True)
        # Of each body one mark is held, the one that all others hang on, or body and marks could change places.
        first = {
            body: min((m for b, m in seen if b == body), key=list(links.placed[body].marks).index) for body, _ in seen
        }
        for body, mark in seen:
            T = links.T_world_mark(mark) if body == ROOM else links.placed[body].marks[mark]
            self._add(("mark", mark, 0), T, mark not in setup.anchors if body == ROOM else mark != first[body])
        self.start = np.stack(self._T)
        self.held: npt.NDArray[np.bool_] = np.array(self._held)
        at = np.array([pose for pose, _ in self._priors], dtype=np.int64)
        self.priors = Priors(at, self.start[at], np.array([known for _, known in self._priors]).reshape(-1, 6, 6))
        self.lenses: list[Lens] = [setup.lenses[name] for name in links.T_world_base]
        self.row, self.views = self._views(list(links.T_world_base), sighted)

    def at(self, kind: str, name: str, number: int = 0) -> int:
        """Return the place of a pose: of kind ``base``, ``stop``, ``mount``, ``body`` or ``mark``; -1: none."""
        return self._place.get((kind, name, number), -1)

    def stop_of(self, pose: int) -> str | None:
        """Return the camera whose head's stop a pose is, None where it is something else."""
        kind, name, _ = list(self._place)[pose]
        return name if kind == "stop" else None

    def names(self, kind: str) -> list[tuple[str, int]]:
        """Return all poses of a kind, by name and number."""
        return [(name, number) for what, name, number in self._place if what == kind]

    def _add(self, key: tuple[str, str, int], T: Transform, free: bool) -> int:
        self._place[key] = len(self._T)
        self._T.append(T)
        self._held.append(not free)
        return self._place[key]

    def _add_head(self, name: str, head: OnHead, aims: Mapping[int, tuple[float, float]]) -> None:
        for k, aim_rad in aims.items():
            stop = self._add(("stop", name, k), head.T_base_mount(aim_rad), True)
            self._priors.append((stop, head.information(aim_rad)))
        mount = self._add(("mount", name, 0), head.T_mount_camera, head.find_mount)
        if head.find_mount:
            self._priors.append((mount, np.diag(_MOUNT_SIGMA**-2)))

    def _chain(self, each: Sighted) -> tuple[int, int, int, int, int]:
        camera, stop, instant = each.picture
        body = self._setup.body_of(each.mark)
        return (
            self.at("base", camera),
            self.at("stop", camera, stop),
            self.at("mount", camera),
            self.at("body", body, instant),
            self.at("mark", each.mark),
        )

    def _views(self, cameras: list[str], sighted: Sequence[Sighted]) -> tuple[Indices, TagViews]:
        """Write out what pictures show, four points at a time."""
        row = np.repeat(np.arange(len(sighted)), [-(-len(each.pixels) // _CORNERS) for each in sighted])
        chains = np.array([self._chain(each) for each in sighted], dtype=np.int64)
        lens = np.array([cameras.index(each.picture.camera) for each in sighted], dtype=np.int64)
        # A camera without a head has one pose; where none has a head, no view has more.
        camera = chains[:, :3] if self._setup.heads else chains[:, :1]
        parts = [_by_four(each) for each in sighted]
        return row, TagViews(
            lens[row],
            Chains(camera[row], chains[row, 3:]),
            np.concatenate([points for points, _, _ in parts]),
            np.concatenate([pixels for _, pixels, _ in parts]),
            np.concatenate([sigma for _, _, sigma in parts]),
        )


def _by_four(each: Sighted) -> tuple[Array, Array, Array]:
    """Return (k, 4, 3) points, (k, 4, 2) pixels and their (k, 4) sigma: 1, of the last point repeated infinite."""
    n = len(each.pixels)
    rows = np.minimum(np.arange(-(-n // _CORNERS) * _CORNERS), n - 1)
    sigma = np.where(np.arange(len(rows)) < n, 1.0, np.inf)
    return (
        each.points_m[rows].reshape(-1, _CORNERS, 3),
        each.pixels[rows].reshape(-1, _CORNERS, 2),
        sigma.reshape(-1, _CORNERS),
    )
