"""From the checked ``planner:`` section to the settings of the pipeline."""

from __future__ import annotations

import math

from camrig.config.rig_file import RigConfig
from camrig.optimise import PlannerSettings
from camrig.pipeline import MissionSettings, Settings

MIN_TAG_PX = 20.0
"""A running rig counts a tag as seen from this projected side on: at decimate 1 all of 20 px are found."""


def settings_of(config: RigConfig, *, aim: bool = True) -> Settings:
    """Return the pipeline's settings; ``aim=False`` measures without ever commanding a motion."""
    planner = config.planner
    return Settings(
        planner=PlannerSettings(
            quality=planner.quality,
            visibility=planner.visibility,
            objective=planner.objective,
            margin_rad=math.radians(planner.margin_deg),
            min_separation_m=planner.min_separation_m,
            min_tag_px=MIN_TAG_PX,
            gain=planner.gain,
        ),
        mission=MissionSettings(period_s=planner.period_s, deadline_s=planner.deadline_s, aim=aim),
    )
