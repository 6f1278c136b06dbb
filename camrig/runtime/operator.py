"""The operator's commands: one handler for all of them, whichever way they come in.

A request is an object ``{"command": "hold"}``; ``resume`` may name ``heads`` and ``drones``, ``arm`` and ``land`` name
a ``drone``, ``aim`` a ``head`` and its ``pan_deg``, its ``tilt_deg`` or both, ``lend`` a ``head`` and ``for_s``.
The answer is ``{"ok": true, ...}`` or ``{"ok": false, "error": <a sentence>, "exit_code": <of camrig.errors>}``.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from camrig.errors import CamrigError, HardwareError, InputError, PartialError
from camrig.locate import DroneHistory
from camrig.messages import FlightState, HeadAim
from camrig.runtime.operator_aim import operator_aim
from camrig.runtime.operator_checks import check_here, check_known, unreached
from camrig.runtime.operator_status import RecentEvents, View, status_of
from camrig.steer import take_off_obstacle

log = logging.getLogger(__name__)

RATE_WINDOW_S = 3.0
"""Frames and answers per second are counted over about this long."""
_SAMPLE_S = 0.4
_FAULT_CHARACTERS = 300


class Orders(Protocol):
    """What an operator may ask of the daemon. Any thread; nothing here waits for a device to have moved."""

    def view(self) -> View:
        """Return what the daemon knows now."""
        ...

    def hold(self) -> Mapping[str, str]:
        """Stop every head, hold every drone until ``resume``, take back what is lent; return what failed, by device."""
        ...

    def resume(self, devices: Collection[str]) -> None:
        """Let these heads move, and these drones, which are in the air, follow plans."""
        ...

    def aim(self, head: str, aim: HeadAim) -> None:
        """Send a head there, held or not, and keep plans from moving it until ``resume``."""
        ...

    def lend(self, head: str, for_s: float, *, renew: bool = False) -> Collection[str]:
        """Stop a head and let go of it and its camera for so long, 0: take them back; return both. It is held then.
        Raises InputError where a loan is to be renewed that is over.
        """
        ...

    def arm(self, drone: str) -> None:
        """Check, arm and climb to the lowest height of the box."""
        ...

    def land(self, drone: str) -> None:
        """Land where it is."""
        ...

    def rescan(self) -> None:
        """Scan the whole floor again."""
        ...


Id = Annotated[str, Field(max_length=100)]


class _Request(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Status(_Request):
    """How the rig is."""

    command: Literal["status"]


class Hold(_Request):
    """Stop every head, hold every drone."""

    command: Literal["hold"]


class Resume(_Request):
    """Let heads move, and drones in the air follow plans; none named = all heads. Drones are always named."""

    command: Literal["resume"]
    heads: Annotated[tuple[Id, ...], Field(max_length=256)] = ()
    drones: Annotated[tuple[Id, ...], Field(max_length=256)] = ()


class Aim(_Request):
    """Send a head somewhere; an axis that is not named stays where it is."""

    command: Literal["aim"]
    head: Id
    pan_deg: float | None = None
    tilt_deg: float | None = None


class Lend(_Request):
    """Let another program have a head and its camera for a while, as a calibration; 0: no longer.

    With ``renew`` for longer, which is refused once the loan is over.
    """

    command: Literal["lend"]
    head: Id
    for_s: Annotated[float, Field(ge=0.0, le=60.0)]
    renew: bool = False


class Arm(_Request):
    """Arm a drone and let it climb."""

    command: Literal["arm"]
    drone: Id


class Land(_Request):
    """Land a drone where it is."""

    command: Literal["land"]
    drone: Id


class Scan(_Request):
    """Scan the whole floor again."""

    command: Literal["scan"]


Request = Status | Hold | Resume | Aim | Lend | Arm | Land | Scan
_STATUS = Status(command="status").model_dump_json()
_REQUESTS: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="command")])

Answer = dict[str, object]


@dataclass
class Operator:
    """Obeys requests. ``handle`` may be called by any thread, ``watch`` by one, about once a second."""

    orders: Orders
    events: RecentEvents
    _samples: tuple[tuple[float, Mapping[str, int]], ...] = field(default=())

    def handle(self, request: object, sender: str) -> Answer:
        """Obey a decoded request and return its answer; logs both, with who sent it. Raises nothing on bad input."""
        asked, result = "a request", "done"
        try:
            parsed = _parsed(request)
            asked = parsed.model_dump_json()
            answer = {"ok": True, **self._obey(parsed)}
        except CamrigError as error:
            result = str(error)
            answer = {"ok": False, "error": result, "exit_code": error.exit_code}
        quiet = asked == _STATUS  # asked every second by whoever watches
        log.log(logging.DEBUG if quiet else logging.INFO, "operator: %s: %s: %s", sender, asked, result)
        return answer

    def watch(self) -> None:
        """Note what cameras and heads have delivered, for their rates."""
        view = self.orders.view()
        if self._samples and view.now_s < self._samples[-1][0] + _SAMPLE_S:
            return
        recent = (sample for sample in self._samples if sample[0] > view.now_s - RATE_WINDOW_S)
        self._samples = (*recent, (view.now_s, view.delivered))

    def _obey(self, request: Request) -> Answer:
        match request:
            case Status():
                view = self.orders.view()
                return status_of(view, self._rates_hz(view), self.events.latest)
            case Hold():
                return self._hold()
            case Resume():
                return self._resume(request)
            case Aim():
                return self._aim(request)
            case Lend(head=head, for_s=for_s, renew=renew):
                rig = self.orders.view().rig
                check_known(rig.name, "head", head, rig.heads)
                return {"devices": sorted(self.orders.lend(head, for_s, renew=renew))}
            case Arm(drone=drone):
                self._reach_drone(drone)
                self._check_room(drone)
                self.orders.arm(drone)
            case Land(drone=drone):
                self._reach_drone(drone)
                self.orders.land(drone)
            case Scan():
                self.orders.rescan()
        return {}

    def _hold(self) -> Answer:
        lent = self.orders.view().lent
        failed = self.orders.hold()
        view = self.orders.view()
        rig = view.rig
        heads = [name for name in sorted(rig.heads) if name not in lent]
        missed = {**unreached(view, (*heads, *rig.drones)), **failed}
        if missed:
            reasons = "; ".join(f"{name}: {reason}" for name, reason in sorted(missed.items()))
            told = f"; taken back from who has it: {', '.join(sorted(lent & rig.heads.keys()))}" if lent else ""
            raise PartialError(f"no stop reached {reasons} (none of them is moved again before resume){told}")
        taken_back = {"lent": sorted(lent & rig.heads.keys())} if lent else {}
        return {"heads": heads, "drones": sorted(rig.drones), **taken_back}

    def _resume(self, request: Resume) -> Answer:
        view = self.orders.view()
        rig = view.rig
        for name in request.heads:
            check_known(rig.name, "head", name, rig.heads)
            check_here(view, name)
        for name in request.drones:
            self._reach_drone(name)
        here = [name for name in rig.heads if name not in view.lent]
        heads = tuple(sorted(request.heads or (() if request.drones else here)))
        for name in rig.heads if not (heads or request.drones) else ():
            check_here(view, name)
        if not heads and not request.drones:
            raise InputError(f"rig '{rig.name}' has no heads to resume; a drone is resumed by its name")
        self.orders.resume((*heads, *request.drones))
        drones = {"drones": list(request.drones)} if request.drones else {}
        return {"heads": list(heads), "unreached": unreached(view, heads), **drones}

    def _aim(self, request: Aim) -> Answer:
        view = self.orders.view()
        name = request.head
        check_known(view.rig.name, "head", name, view.rig.heads)
        check_here(view, name)
        for reason in unreached(view, [name]).values():
            raise HardwareError(f"head {name} cannot be reached: {reason}")
        aim = operator_aim(view, name, request.pan_deg, request.tilt_deg)
        self.orders.aim(name, aim)
        return {"head": name, "pan_deg": math.degrees(aim.pan_rad), "tilt_deg": math.degrees(aim.tilt_rad)}

    def _reach_drone(self, drone: str) -> None:
        view = self.orders.view()
        check_known(view.rig.name, "drone", drone, view.rig.drones)
        for name, reason in unreached(view, [drone]).items():
            raise HardwareError(f"drone {name} cannot be reached: {reason}")

    def _check_room(self, drone: str) -> None:
        """Refuse a take-off beside a drone that flies, or is about to."""
        view = self.orders.view()
        places_m = {name: tuple(history.readings[-1].T_world_body[:3, 3].tolist()) for name, history in _told(view)}
        climbing = {name for name, health in view.health.items() if health.begins}
        grounded = {name for name, flight in view.state.flight.items() if flight is FlightState.GROUND} - climbing
        aloft_m = {name: place_m for name, place_m in places_m.items() if name not in grounded and name != drone}
        if drone in places_m and (reason := take_off_obstacle(drone, places_m[drone], aloft_m, view.rig)):
            raise HardwareError(f"drone {drone} is not armed: {reason}")

    def _rates_hz(self, view: View) -> dict[str, float]:
        samples = self._samples
        if not samples or view.now_s <= samples[0][0]:
            return {}
        since_s, before = samples[0]
        return {name: (count - before.get(name, 0)) / (view.now_s - since_s) for name, count in view.delivered.items()}


def _told(view: View) -> Iterable[tuple[str, DroneHistory]]:
    """Return the drones that have said where they are."""
    return ((name, history) for name, history in view.state.histories.drones.items() if history.readings)


def _parsed(request: object) -> Request:
    try:
        return _REQUESTS.validate_python(request)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, fault['loc']))} {fault['msg']}".strip() for fault in error.errors())
        # Escaped and cut: this text goes into a log, and the keys in it are the sender's.
        raise InputError(f"the request is not understood: {ascii(faults)[1:-1][:_FAULT_CHARACTERS]}") from error
