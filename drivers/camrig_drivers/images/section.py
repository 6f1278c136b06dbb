"""The ``source:`` section of a camera that reads pictures."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator


class ImagesSection(BaseModel):
    """``path`` is a folder, a glob or a video. Frames come at ``fps``, or when the file ``stamps`` says."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    path: Annotated[str, Field(min_length=1)]
    fps: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    stamps: Annotated[str, Field(min_length=1)] | None = None
    loop: bool = False

    @model_validator(mode="after")
    def _one_time(self) -> ImagesSection:
        if self.fps is not None and self.stamps is not None:
            raise ValueError("give fps or stamps, not both")
        return self
