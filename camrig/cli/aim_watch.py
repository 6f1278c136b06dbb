"""What ``camrig aim`` sees of a head in a daemon's status, and whether that means that it is there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from camrig.cli.operating import Answer, part
from camrig.errors import InputError
from camrig.report.terminal_head import HeadPicture, way
from camrig.runtime.operator_client import ask

STILL_S = 0.3
"""For so long it must not have moved to be there."""
MOST_DOUBT_DEG = 1.0
"""An angle may be off by its two sigma, but by no more, to count as reached."""
_ROUNDED_DEG = 0.01

Angles = tuple[float, float]


@dataclass(frozen=True)
class Look:
    """One look at a head; angles are (pan, tilt), None where unknown or where no operator wants anything."""

    head: str
    stamp_s: float
    link: str
    reason: str
    control: str
    present_deg: Angles | None
    sigma_deg: Angles | None
    wanted_deg: Angles | None
    limits_deg: tuple[Angles, Angles]

    def picture(self) -> HeadPicture:
        """Return what is drawn of it."""
        state = (
            f"link {self.link}, controlled by the {self.control}"
            if self.control != "held"
            else f"link {self.link}, held"
        )
        return HeadPicture(
            self.head, *self.limits_deg, self.present_deg, self.sigma_deg, self.wanted_deg, state, self.link != "up"
        )

    def sentence(self) -> str:
        """Say it on one line."""
        return f"{self.head}: {_place(self)}; link {self.link}, {self.control}"

    def as_json(self) -> dict[str, object]:
        """Return it as one JSON object."""
        pan_deg, tilt_deg = self.present_deg or (None, None)
        return {
            "head": self.head,
            "link": self.link,
            "control": self.control,
            "pan_deg": pan_deg,
            "tilt_deg": tilt_deg,
            "sigma_deg": None if self.sigma_deg is None else list(self.sigma_deg),
        }


@dataclass(frozen=True)
class Verdict:
    """How it ended; ``reason`` says where the head is or why it is not there, None where nobody waited for that."""

    head: str
    look: Look
    target_deg: Angles
    lasted_s: float
    arrived: bool
    reason: str | None

    def as_json(self) -> dict[str, object]:
        """Return it as one JSON object."""
        return {
            **self.look.as_json(),
            "wanted_pan_deg": round(self.target_deg[0], 3),
            "wanted_tilt_deg": round(self.target_deg[1], 3),
            "arrived": self.arrived,
            "reason": "interrupted" if self.reason is None else self.reason,
            "lasted_s": round(self.lasted_s, 3),
        }


def look_at(path: Path, head: str) -> Look:
    """Ask a daemon for its status and return what it says of a head; raises InputError where it has no such head."""
    status = ask(path, {"command": "status"})
    heads = part(status, "heads")
    if head not in heads:
        names = ", ".join(sorted(heads)) or "none"
        raise InputError(f"rig '{status.get('rig')}' has no head '{head}'; its heads are {names}")
    found = part(heads, head)
    limits = part(found, "limits")
    pan_limits, tilt_limits = _pair(limits, "pan_deg"), _pair(limits, "tilt_deg")
    return Look(
        head=head,
        stamp_s=_number(status, "stamp_s") or 0.0,
        link=str(found.get("link")),
        reason=str(found.get("reason")),
        control=str(found.get("control")),
        present_deg=_both(found),
        sigma_deg=_pair(found, "sigma_deg"),
        wanted_deg=_both(part(found, "aim")),
        limits_deg=(pan_limits or (-180.0, 180.0), tilt_limits or (-90.0, 90.0)),
    )


def judge(
    looks: Sequence[Look], target_deg: Angles, tolerance_deg: float, lasted_s: float, timeout_s: float
) -> Verdict | None:
    """Return the verdict that the looks so far, oldest first, allow; None while it may still come there."""
    last = looks[-1]

    def verdict(reason: str, *, arrived: bool = False) -> Verdict:
        return Verdict(last.head, last, target_deg, lasted_s, arrived, reason)

    if last.link != "up":
        return verdict(f"its link is {last.link} ({last.reason}); it is not moved again when that comes back")
    if last.wanted_deg is None or max(map(abs, way(target_deg, last.wanted_deg))) > _ROUNDED_DEG:
        now = {"held": "it is held", "planner": "it follows plans again"}.get(last.control, "it has another aim")
        return verdict(f"somebody took it from this aim: {now}")
    if _arrived(looks, target_deg, tolerance_deg):
        return verdict(f"{_place(last)} after {lasted_s:.1f} s", arrived=True)
    if lasted_s < timeout_s:
        return None
    if last.present_deg is None:
        return verdict(f"after {lasted_s:.0f} s its position is unknown")
    pan_deg, tilt_deg = way(target_deg, last.present_deg)
    return verdict(f"after {lasted_s:.0f} s it is at {_place(last)}, off by {pan_deg:.2f} and {tilt_deg:.2f} deg")


def _arrived(looks: Sequence[Look], target_deg: Angles, tolerance_deg: float) -> bool:
    last = looks[-1]
    since = [look for look in looks if look.stamp_s >= last.stamp_s - STILL_S]
    known = [look.present_deg for look in since if look.present_deg is not None]
    if last.present_deg is None or len(known) < len(since) or looks[0].stamp_s > last.stamp_s - STILL_S:
        return False
    still = all(max(map(abs, way(place, last.present_deg))) <= 0.5 * tolerance_deg for place in known)
    sigmas_deg = last.sigma_deg or (0.0, 0.0)
    doubts_deg = (min(2.0 * sigma, MOST_DOUBT_DEG) for sigma in sigmas_deg)
    lefts_deg = way(target_deg, last.present_deg)
    return still and all(abs(a) <= tolerance_deg + b for a, b in zip(lefts_deg, doubts_deg, strict=True))


def _place(look: Look) -> str:
    if look.present_deg is None:
        return "position unknown"
    return f"pan {look.present_deg[0]:.2f} deg, tilt {look.present_deg[1]:.2f} deg"


def _both(found: Answer) -> Angles | None:
    pan_deg, tilt_deg = _number(found, "pan_deg"), _number(found, "tilt_deg")
    return None if pan_deg is None or tilt_deg is None else (pan_deg, tilt_deg)


def _pair(found: Answer, key: str) -> Angles | None:
    match found.get(key):
        case [int() | float() as first, int() | float() as second]:
            return float(first), float(second)
    return None


def _number(found: Answer, key: str) -> float | None:
    value = found.get(key)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None
