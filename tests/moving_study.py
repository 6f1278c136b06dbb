"""How far off published positions are of robots under way, watched by heads that swing: error, bias, NEES.

python -m tests.moving_study --scenes 12 --seed 1

Three heads, each wrong by its own bias, mount and lens, swing at up to a given speed over three robots that drive round
a stadium (with ``stops`` they stand, start and brake, at 2 m/s2), wander just as the filter's model of their motion has
it, or stand, each a little tilted; four anchors lie on the floor. Corners are projected by OpenCV with the noise of
refined ones, most of which comes again in every frame of a camera, frames come fifteen times a second and camera, 40 to
120 ms late, a head's axes in turn every 75 ms. All of ``pipeline.step`` runs; an error is that of a published position
at the time it is published for, so what is guessed ahead counts too. Where robots wander nearly all is what camrig
reckons with, and NEES must be near its degrees of freedom.
"""

from __future__ import annotations

import argparse
import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy import stats

from camrig.fuse.settings import DEFAULTS
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import perturb, transform
from camrig.geometry.rotation import rotation_exp, rotation_z
from camrig.locate.camera_pose import MOUNT_COVARIANCE
from camrig.locate.sightings import UPRIGHT_SIGMA_RAD
from camrig.messages import AxisReading, LinkReport, LinkStatus, TagDetections, TargetStatus
from camrig.optimise import PlannerSettings
from camrig.pipeline import Inputs, MissionSettings, Settings, begin, step
from tests.robot_ways import ROBOT_M_S, Wandering, on_stadium, with_stops
from tests.watched_floor import MOUNT, REPEATING, Errors, Floor, detected

SPEEDS_DEG_S = (0.0, 10.0, 20.0, 30.0)
"""How fast heads swing at the most."""
SWING_RAD = math.radians(10.0)
FRAME_S, FRAME_LATE_S, FRAME_JITTER_S = 1.0 / 15.0, 0.08, 0.04
AXIS_S, AXIS_LATE_S, AXIS_NOISE_RAD = 0.075, 0.02, math.radians(0.01)
TICK_S, SETTLE_S = 0.04, 4.0
SETTINGS = Settings(PlannerSettings(visibility="image"), MissionSettings(aim=False))


class Room(Floor):
    """A floor whose bodies move and whose heads swing; ``way`` is stadium, stops, wander or stand."""

    def __init__(self, seed: int, speed_deg_s: float, motion: str, way: str, seconds: float) -> None:
        errors = Errors(math.radians(0.1), mounts=True, lenses=True)
        super().__init__(seed, cameras=3, bodies=3, anchors=True, errors=errors, motion=motion)
        self.rate = math.radians(speed_deg_s) / SWING_RAD
        self.began = {name: self.rng.uniform(0.0, 6.0) for name in self.places}
        self.middle = {name: self.rng.uniform([1.8, 1.1], [3.2, 1.9]) for name in self.places}
        self.phase = {name: self.rng.uniform(0.0, math.tau, 2) for name in self.rig.cameras}
        self.bias = {name: self.rng.normal(size=2) * errors.pointing_rad for name in self.rig.cameras}
        self.mount = {name: self.rng.normal(size=6) * np.sqrt(np.diag(MOUNT_COVARIANCE)) for name in self.rig.cameras}
        self.way, self.wandering = (
            way,
            {name: Wandering(DEFAULTS.models[motion], seconds, self.rng) for name in self.places},
        )
        tilt_rad = np.array([UPRIGHT_SIGMA_RAD, UPRIGHT_SIGMA_RAD, 0.0])
        self.tilts = {name: rotation_exp(self.rng.normal(size=3) * tilt_rad) for name in self.places}
        keys = [tag.key for body in self.rig.targets.values() for tag in body.tags]
        keys += [anchor.key for anchor in self.rig.anchors]
        self.again = {
            name: {key: self.rng.normal(size=(4, 2)) * math.sqrt(REPEATING) for key in keys}
            for name in self.rig.cameras
        }
        centre = np.array([2.5, 1.5, 0.0])
        for name in self.rig.cameras:
            x, y, z = centre - self._base(name)[:3, 3]
            self.aims[name] = math.atan2(y, x), math.atan2(z, math.hypot(x, y))

    def robots(self, now_s: float) -> dict[str, Transform]:
        """Return the true ``T_world_body`` of every robot."""
        found = {}
        for name, middle in self.middle.items():
            match self.way:
                case "wander":
                    x, y, z, heading = self.wandering[name].at(now_s)
                case way:
                    driven_m = {"stadium": ROBOT_M_S * now_s, "stops": with_stops(now_s), "stand": 0.0}[way]
                    (x, y, heading), z = on_stadium(self.began[name] + driven_m), 0.0
            R = self.tilts[name] @ rotation_z(heading)
            found[name] = transform(R, np.array([middle[0] + x, middle[1] + y, z]))
        return found

    def angles(self, camera: str, now_s: float) -> Array:
        """Return pan and tilt (2,) that the head would report if it did so at once."""
        swing = SWING_RAD * np.sin(self.rate * now_s * np.array([1.0, 0.7]) + self.phase[camera])
        return np.array(self.aims[camera]) + swing * [1.0, 0.5] * (self.rate > 0.0)

    def speed_deg_s(self, now_s: float) -> float:
        """Return how fast the heads turn, on average."""
        turned = [self.angles(name, now_s + 0.01) - self.angles(name, now_s - 0.01) for name in self.rig.cameras]
        return math.degrees(float(np.mean([np.hypot(*each) for each in turned])) / 0.02)

    def frame(self, camera: str, now_s: float, number: int) -> TagDetections:
        """Return the tags of one frame."""
        kinematics = self.rig.heads[camera.replace("c", "h")].kinematics
        pan, tilt = self.angles(camera, now_s) + self.bias[camera]
        T = perturb(kinematics.T_world_camera(pan, tilt, MOUNT), self.mount[camera])
        robots = self.robots(now_s)
        listed = [(tag.key, robots[body.id]) for body in self.rig.targets.values() for tag in body.tags]
        listed += [(anchor.key, anchor.T_world_tag) for anchor in self.rig.anchors]
        lens, again = self.true_lenses[camera], self.again[camera]
        return detected(camera, now_s, number, T, lens, listed, self.rng, again=again)

    def _base(self, camera: str) -> Transform:
        return self.rig.heads[camera.replace("c", "h")].kinematics.T_world_base


@dataclass(frozen=True)
class Sample:
    """One published position: its error in metres, along the motion, NEES in space (3) and in the plane (2), and how
    fast heads turned meanwhile.
    """

    error_m: float
    along_m: float
    nees: float
    plane_nees: float
    speed_deg_s: float


def watched(room: Room, seconds: float) -> Iterator[Sample]:
    """Run the pipeline over the room and yield every published position once things have settled."""
    events: list[tuple[float, int, TagDetections | AxisReading]] = []
    numbers = count()

    def at(at_s: float, what: TagDetections | AxisReading) -> None:
        heapq.heappush(events, (at_s, next(numbers), what))

    for k, camera in enumerate(room.rig.cameras):
        for n in range(int(seconds / FRAME_S)):
            taken_s = (n + k / 3.0) * FRAME_S
            late_s = FRAME_LATE_S + room.rng.uniform(-FRAME_JITTER_S, FRAME_JITTER_S)
            at(taken_s + late_s, room.frame(camera, taken_s, n))
        for n in range(int(seconds / AXIS_S)):
            read_s, axis = n * AXIS_S + 0.01 * k, n % 2
            angle = float(room.angles(camera, read_s)[axis] + room.rng.normal() * AXIS_NOISE_RAD)
            head = camera.replace("c", "h")
            reading = AxisReading(head, ("pan", "tilt")[axis], angle, read_s, AXIS_NOISE_RAD, 0.0, AXIS_NOISE_RAD)
            at(read_s + AXIS_LATE_S, reading)
    state = begin(0.0)
    links = tuple(LinkReport(name, LinkStatus.UP, 0.0) for name in (*room.rig.cameras, *room.rig.heads))
    for tick in range(1, int(seconds / TICK_S)):
        now_s = tick * TICK_S
        arrived = []
        while events and events[0][0] <= now_s:
            arrived.append(heapq.heappop(events)[2])
        inputs = Inputs(
            tuple(each for each in arrived if isinstance(each, TagDetections)),
            tuple(each for each in arrived if isinstance(each, AxisReading)),
            links=links if tick == 1 else (),
        )
        state, outputs = step(state, inputs, room.rig, SETTINGS, now_s)
        if now_s < SETTLE_S:
            continue
        truth, speed_deg_s = room.robots(now_s), room.speed_deg_s(now_s - 0.1)
        for target in outputs.published.targets:
            if target.status is TargetStatus.TRACKED:
                error = target.position_m - truth[target.id][:3, 3]
                off_m, along_m = float(np.linalg.norm(error)), float(error @ truth[target.id][:3, 0])
                nees, plane_nees = (
                    float(error[:n] @ np.linalg.solve(target.covariance_m2[:n, :n], error[:n])) for n in (3, 2)
                )
                yield Sample(off_m, along_m, nees, plane_nees, speed_deg_s)


def main() -> None:
    """Print the table as Markdown."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    asked.add_argument("--scenes", type=int, default=12)
    asked.add_argument("--seconds", type=float, default=16.0)
    asked.add_argument("--seed", type=int, default=1)
    asked.add_argument(
        "--motion", choices=("drives", "floor", "static"), default="drives", help="what the rig's file says"
    )
    asked.add_argument(
        "--way", choices=("stadium", "stops", "wander", "stand"), default="stadium", help="what robots do"
    )
    options = asked.parse_args()
    scenes: list[list[Sample]] = []
    print(
        "| heads swing to, deg/s | n | mean mm | 95 % mm | along mm | NEES | 95 %, scenes | in the plane | largest "
        "| past 5 sigma |"
    )
    print("|--|--|--|--|--|--|--|--|--|--|")
    for speed in SPEEDS_DEG_S:
        drawn = [
            list(
                watched(
                    Room(1000 * options.seed + k, speed, options.motion, options.way, options.seconds), options.seconds
                )
            )
            for k in range(options.scenes)
        ]
        scenes += drawn
        found = [sample for scene in drawn for sample in scene]
        error_mm = 1e3 * np.array([sample.error_m for sample in found])
        along_mm, nees = 1e3 * float(np.mean([s.along_m for s in found])), np.array([s.nees for s in found])
        print(
            f"| {speed:.0f} | {len(found)} | {error_mm.mean():.2f} | {np.quantile(error_mm, 0.95):.2f} "
            f"| {along_mm:.2f} | {nees.mean():.2f} | {_over_scenes(drawn)} "
            f"| {np.mean([sample.plane_nees for sample in found]):.2f} | {nees.max():.1f} | {(nees > 25.0).sum()} |",
            flush=True,
        )
    low, high = slope_interval(scenes, np.random.default_rng(options.seed))
    print(f"\nSlope of the error against the heads' speed: [{low:.4f}, {high:.4f}] mm per deg/s (95 %, over scenes)")


def _over_scenes(scenes: list[list[Sample]]) -> str:
    """Return the 95 % interval of the mean NEES: samples of one scene belong together, scenes do not."""
    means = np.array([np.mean([sample.nees for sample in scene]) for scene in scenes if scene])
    half = float(stats.t.ppf(0.975, len(means) - 1)) * means.std(ddof=1) / math.sqrt(len(means))
    return f"{means.mean() - half:.2f} to {means.mean() + half:.2f}"


def slope_interval(scenes: list[list[Sample]], rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the slope of error against speed, drawing whole scenes."""
    slopes = []
    for _ in range(1000):
        drawn = [sample for k in rng.integers(len(scenes), size=len(scenes)) for sample in scenes[k]]
        speed, error_mm = np.array([(sample.speed_deg_s, 1e3 * sample.error_m) for sample in drawn]).T
        slopes.append(float(np.polyfit(speed, error_mm, 1)[0]))
    low, high = np.quantile(slopes, [0.025, 0.975])
    return float(low), float(high)


if __name__ == "__main__":
    main()
