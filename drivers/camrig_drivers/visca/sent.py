"""The last target that a VISCA head was sent, and when it makes sense to send it again."""

from __future__ import annotations

from dataclasses import dataclass

_RESEND_S = 2.0
"""A target that was not acknowledged is sent again after this long even if unchanged: it may have been lost."""
_SETTLE_S = 1.0


@dataclass(frozen=True, slots=True)
class Sent:
    """A target in counts, under which permit it was sent, and when."""

    counts: tuple[int, int]
    permit: object
    stamp_s: float
    way_s: float
    """How long the way there takes at the head's speed, from wherever it may have been."""
    acknowledged: bool

    @property
    def until_s(self) -> float:
        """When it must have been reached."""
        return self.stamp_s + self.way_s + _SETTLE_S

    @property
    def resend_s(self) -> float:
        """When it makes sense to send it again; sooner it would only interrupt a head that has understood."""
        return max(self.until_s, self.stamp_s + _RESEND_S) if self.acknowledged else self.stamp_s + _RESEND_S

    def names(self, counts: tuple[int, int]) -> bool:
        """Tell whether a reported position is the target."""
        return all(abs(count - target) <= 1 for count, target in zip(counts, self.counts, strict=True))
