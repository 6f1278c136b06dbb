"""From the checked ``planner:`` and ``fusion:`` sections to the settings of the pipeline."""

from __future__ import annotations

import math

from camrig import fuse
from camrig.config.rig_file import RigConfig
from camrig.optimise import PlannerSettings
from camrig.pipeline import MissionSettings, Settings

MIN_TAG_PX = 16.0
MIN_TAG_PX_PER_DECIMATE = 8.0
"""A running rig counts a tag as seen from this narrow side on: at decimate 1 all of 16 px are found, at 2 of 24."""

MAX_INCIDENCE_RAD = math.radians(75.0)
"""A tag seen flatter than this off its normal does not count as seen."""

REACH_PERIODS = 1.5
"""Periods of planning within which a camera must be where a plan wants it."""


def settings_of(config: RigConfig, *, aim: bool = True) -> Settings:
    """Return the pipeline's settings; ``aim=False`` measures without ever commanding a motion."""
    planner = config.planner
    decimate = float(getattr(config.detector.section, "decimate", 1.0))
    readable_px = MIN_TAG_PX + MIN_TAG_PX_PER_DECIMATE * (decimate - 1.0)
    flattest_rad = MAX_INCIDENCE_RAD if planner.max_incidence_deg is None else math.radians(planner.max_incidence_deg)
    return Settings(
        planner=PlannerSettings(
            quality=planner.quality,
            visibility=planner.visibility,
            objective=planner.objective,
            margin_rad=math.radians(planner.margin_deg),
            min_separation_m=planner.min_separation_m,
            min_tag_px=readable_px if planner.min_tag_px is None else planner.min_tag_px,
            max_incidence_rad=flattest_rad,
            max_range_m=planner.max_range_m or math.inf,
            gain=planner.gain,
            motion_cost_per_s=planner.motion_cost_per_s,
            refined_corners=config.refine,
            reach_s=REACH_PERIODS * planner.period_s,
        ),
        mission=MissionSettings(period_s=planner.period_s, deadline_s=planner.deadline_s, aim=aim),
        fuse=fuse.Settings(estimator=config.fusion.estimator),
    )
