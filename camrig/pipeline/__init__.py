"""The whole flow as one pure function: ``step(state, inputs, rig, settings, now_s) -> (state, outputs)``."""

from camrig.pipeline.mission import Mission, MissionSettings
from camrig.pipeline.state import Inputs, Outputs, Settings, State, begin
from camrig.pipeline.step import rescan, step

__all__ = ["Inputs", "Mission", "MissionSettings", "Outputs", "Settings", "State", "begin", "rescan", "step"]
