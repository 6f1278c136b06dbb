"""The figures of ``camrig experiment table1``: errors as boxes, what cameras see, quality anywhere on the floor."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from camrig.experiments.configurations import Configuration, planned, scene_for
from camrig.experiments.estimators import Estimator
from camrig.experiments.photographs import photograph
from camrig.experiments.rooms import Room
from camrig.experiments.scenes import Place
from camrig.experiments.table1 import Job, Trial, room_of
from camrig.experiments.table1_figures import by_cell, own_estimator
from camrig.experiments.table1_report import Report
from camrig.geometry.arrays import Array
from camrig.report.experiment_figures import CameraView, camera_views, error_boxes
from camrig.report.plan_map import plan_panel

_ENDINGS = (".png", ".svg")
_SHOWN: tuple[Configuration, ...] = ("hold", "paper-sqp", "paper-ipopt")


def draw(report: Report, folder: Path) -> None:
    """Write the figures of a report into a folder, each as PNG and SVG. Needs matplotlib."""
    error_boxes(_paths(folder, "table1-errors"), _boxes(report.trials, report.own))
    modes = dict.fromkeys((trial.mode, trial.cameras, trial.targets) for trial in report.trials)
    first = {mode: Place(mode, cameras, targets, report.setup.seed) for mode, cameras, targets in reversed(modes)}
    condition = report.setup.conditions[0]
    rooms = {mode: room_of(Job(place, condition, ())) for mode, place in first.items()}
    shown = [name for name in (*_SHOWN, report.own) if name in report.setup.configurations]
    for mode, room in rooms.items():
        camera_views(_paths(folder, f"table1-views-{mode}"), {name: _views(room, name) for name in shown})
    panels = [
        (f"{mode} {room.place.cameras}, {room.place.targets}: {name}", scene_for(name, room), planned(name, room, _now))
        for mode, room in rooms.items()
        for name in shown[1:]
    ]
    for path in _paths(folder, "table1-quality"):
        plan_panel(path, panels)


def _paths(folder: Path, name: str) -> list[Path]:
    return [folder / f"{name}{ending}" for ending in _ENDINGS]


_now = time.perf_counter


def _boxes(trials: Sequence[Trial], own: Configuration) -> Mapping[str, Mapping[str, Mapping[str, Array]]]:
    """Return the errors in millimetres by condition, rig and method."""
    found: dict[str, dict[str, dict[str, Array]]] = {}
    for (mode, cameras, targets, condition), members in by_cell(trials):
        best = own_estimator(condition)
        methods: dict[str, tuple[Configuration, Estimator]] = {
            "hold, mean": ("hold", "mean"),
            "Arslan-like, mean": ("arslan", "mean"),
            "paper, SQP, 1/Q": ("paper-sqp", "quality"),
            "paper, IPOPT, 1/Q": ("paper-ipopt", "quality"),
            "paper, SQP, 1/Q, camrig's corners": ("paper-sqp", "quality refined"),
            "paper, SQP, camrig's estimate": ("paper-sqp", best),
            "camrig": (own, best),
        }
        found.setdefault(condition, {})[f"{mode} {cameras}, {targets}"] = {
            label: _errors_mm(members, *method) for label, method in methods.items()
        }
    return found


def _errors_mm(trials: Sequence[Trial], configuration: Configuration, estimator: Estimator) -> Array:
    vectors = [
        vector
        for trial in trials
        if trial.configuration == configuration
        for vector in trial.errors_m[estimator].values()
    ]
    return np.asarray(1e3 * np.linalg.norm(np.array(vectors).reshape(-1, 3), axis=1))


def _views(room: Room, configuration: Configuration) -> list[CameraView]:
    plan = planned(configuration, room, _now)
    views = []
    for name in room.rig.cameras:
        seen = photograph(room, name, plan.aims[name])
        corners = np.array([tag.corners_px for tag in seen.detected.tags]).reshape(-1, 4, 2)
        views.append(CameraView(name, seen.image, corners))
    return views
