"""Table 2: what is scored of a rig at rest, what is made of the scores, and the file of surveyed places."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest

from camrig.config.rig_file import load_rig
from camrig.errors import ConfigError, InputError
from camrig.experiments.surveyed import load_surveyed
from camrig.experiments.table2 import ESTIMATORS, METHODS, Method, Score
from camrig.experiments.table2_report import Report, as_json, as_markdown, rows


def score(scene: int, method: Method, mean_mm: float, published_mm: float) -> Score:
    errors = {"mean": mean_mm, "quality": 1.1 * mean_mm, "published": published_mm}
    return Score(scene, method, 2, {name: {"robot1": errors[name] / 1e3} for name in ESTIMATORS}, {"robot1": 0.0015})


SCORES = [
    each
    for scene in range(3)
    for each in (
        score(scene, "camrig", 3.0, 0.5),
        score(scene, "manual", 4.0 + scene, 0.4),
        score(scene, "arslan", 2.0, 0.4),
    )
]


def test_every_method_is_told_by_its_own_estimator() -> None:
    found = {row.method: row for row in rows(SCORES)}
    assert (found["camrig"].estimator, found["manual"].estimator) == ("published", "mean")
    assert found["camrig"].coverage == 0.5
    assert found["camrig"].over_manual is not None
    assert found["camrig"].over_manual.value == pytest.approx(0.1)
    assert found["arslan"].camrig_over is not None
    assert found["arslan"].camrig_over.value == pytest.approx(0.25)
    report = Report("A rig", "camrig experiment table2", {"cpu": "x", "cores": 1, "omp_num_threads": "1"}, {}, SCORES)
    table = [line for line in as_markdown(report).splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in table}) == 1
    assert "56.0" in table[3]
    assert len(as_json(report)["scores"]) == len(SCORES)  # type: ignore[arg-type]


def test_the_rig_of_the_table_is_one_that_camrig_runs() -> None:
    with as_file(files("camrig.experiments") / "table2.yaml") as path:
        config = load_rig(path)
    assert (len(config.rig.heads), len(config.rig.targets), len(config.rig.anchors)) == (3, 5, 4)
    assert all(head.auto_enable for head in config.rig.heads.values())
    assert METHODS[0] == "camrig"


def test_surveyed_places_are_read_or_all_their_faults_told(tmp_path: Path) -> None:
    path = tmp_path / "surveyed.csv"
    path.write_text("id,x_m,y_m,z_m\nrobot1,1,2,0.1\n\nrobot2, 0.5,1.5,0\n")
    places = load_surveyed(path, ["robot1", "robot2"])
    assert np.array_equal(places["robot1"], [1.0, 2.0, 0.1])
    path.write_text("id,x_m,y_m,z_m\nrobot1,1,2\nrobot3,1,2,3\nrobot1,nan,0,0\n")
    with pytest.raises(ConfigError) as caught:
        load_surveyed(path, ["robot1", "robot2"])
    assert len(caught.value.faults) == 4
    assert "robot2: is a target of the rig and not surveyed" in str(caught.value)
    path.write_text("name,x,y,z\n")
    with pytest.raises(InputError, match="the first line names the columns: id,x_m,y_m,z_m"):
        load_surveyed(path, ["robot1"])
    with pytest.raises(InputError, match="cannot be read"):
        load_surveyed(tmp_path / "none.csv", ["robot1"])
