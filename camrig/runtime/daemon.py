"""The daemon: builds the rig's devices, runs their workers and the control thread, and brings everything to rest."""

from __future__ import annotations

import gc
import logging
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field

from camrig import locate
from camrig.clock import Clock, RealClock
from camrig.config.rig_file import RigConfig
from camrig.detect import warm_up
from camrig.errors import CamrigError, HardwareError
from camrig.interfaces import Sink
from camrig.messages import FlightState, HeadAim, LinkReport
from camrig.pipeline import Settings
from camrig.runtime.build import make_sinks
from camrig.runtime.control import LEAST_TICK_S, TICK_S, Control, Devices
from camrig.runtime.drone_job import DroneJob
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.halt import halt
from camrig.runtime.head_job import HeadJob
from camrig.runtime.jobs import make_jobs
from camrig.runtime.link_counts import counted_of_all
from camrig.runtime.loans import Loans
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.notify import Notifier
from camrig.runtime.operator_status import View
from camrig.runtime.planner_link import PlannerLink
from camrig.runtime.status_line import status_line
from camrig.runtime.worker import Job, Worker, log_failure

log = logging.getLogger(__name__)

COMPILING_S = 600.0
"""Three quarters of a minute on a desktop computer; a small one may take ten times as long."""
BEAT_LIMIT_S = 15.0
"""A worker silent for longer is stuck: the watchdog is no longer fed. Opening a drone's link may take 10 s."""
JOIN_S, FLUSH_S, SUPERVISE_S = 5.0, 0.5, 0.2


@dataclass
class Daemon:
    """One rig at work: ``start``, ``supervise`` until it returns, then ``stop``, which is also the way out of errors.

    ``extra_sinks`` receive everything that is published. ``held`` heads stay still until ``resume``, whatever the
    configuration says.
    """

    config: RigConfig
    settings: Settings
    extra_sinks: Sequence[Sink] = ()
    clock: Clock = field(default_factory=RealClock)
    notifier: Notifier = field(default_factory=Notifier)
    held: frozenset[str] = frozenset()
    remark: str = ""
    """Stands at the end of the status line."""
    successor: RigConfig | None = None
    """The configuration that another daemon is to run once this one has stopped: a reload."""
    control: Control = field(init=False)
    devices: Devices = field(init=False)
    _guardian: GuardianLink = field(init=False)
    _workers: list[Worker] = field(default_factory=list)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _news: threading.Event = field(default_factory=threading.Event)
    _asked_to_stop: bool = False
    _asked_to_reload: bool = False
    _ready: bool = False
    _stopped: bool = False
    _control_failure: BaseException | None = None
    _open: ExitStack = field(default_factory=ExitStack)

    def start(self) -> None:
        """Start everything; heads with ``enable: auto`` may move from here on, nothing else."""
        try:
            self._start()
        except BaseException:
            self.stop()
            raise

    def _start(self) -> None:
        loading = "loading machine code; after an installation it is compiled first, for a minute or two"
        self.notifier.starting(loading, COMPILING_S)
        log.info(loading)
        locate.warm_up()  # before anything is open: no thread must be silent for so long
        if self.config.refine:
            warm_up()
        # What is loaded by now stays: to look for garbage in it would stop all threads for a tenth of a second.
        gc.freeze()
        self._open.callback(gc.unfreeze)
        self._guardian = GuardianLink()
        self._open.callback(self._guardian.close)
        self.devices = make_jobs(self.config, self.clock, self._guardian, self._news, self.held)
        planner = PlannerLink(self.config.rig, self.settings.planner, self.clock)
        self._open.callback(planner.close)
        sinks = [*make_sinks(self.config), *self.extra_sinks]
        for sink in sinks:
            sink.open(self.config.rig)
            self._open.callback(sink.close)
        links: Mailbox[LinkReport] = Mailbox(256)
        self.control = Control(self.config.rig, self.settings, self.devices, planner, sinks, links, self.clock)
        jobs: list[Job] = [*self.devices.heads.values(), *self.devices.drones.values(), *self.devices.cameras.values()]
        self._workers = [Worker(job, self.clock, links, self._stopping.set) for job in jobs]
        control = threading.Thread(target=self._run_control, name="control", daemon=True)
        for worker in self._workers:
            worker.start()
        control.start()
        self._open.callback(control.join, JOIN_S)
        self._ready = True
        self.notifier.ready()

    def supervise(self, until_s: float = float("inf"), reload: Callable[[], RigConfig] | None = None) -> None:
        """Block until a stop is requested, every camera's recording has ended, a worker failed, or ``until_s``.

        A reload that is requested calls ``reload``, for the configuration that is to follow this one; where that
        raises a CamrigError, this one goes on.

        Raises the CamrigError of a device that is not what was configured, and HardwareError once the guardian is
        gone; any other failure is re-raised as it is.
        """
        while not (self._stopping.wait(SUPERVISE_S) or self._asked_to_stop) and self.clock.now_s() < until_s:
            if not self._guardian.alive():
                raise HardwareError("the guardian process is gone: nothing would stop the heads if this daemon died")
            if self._beating():
                self.notifier.alive()
            self.notifier.status(self.status_line())
            if self._asked_to_reload and reload is not None and self._succeeded(reload):
                break
            cameras = [worker for worker in self._workers if worker.job.name in self.devices.cameras]
            if cameras and all(worker.ended for worker in cameras):
                self._stopping.wait(FLUSH_S)  # let the last detections pass through the pipeline
                break
        for failure in (self._control_failure, *(worker.failed for worker in self._workers)):
            if failure is not None:
                raise failure

    def _succeeded(self, reload: Callable[[], RigConfig]) -> bool:
        """Ask for the configuration that is to follow; tell whether there is one."""
        self._asked_to_reload = False
        self.notifier.reloading()
        try:
            self.successor = reload()
        except CamrigError as error:
            log.error("reload refused, the rig runs on as it was: %s", error)  # noqa: TRY400 - a sentence, no bug
            self.remark = f"reload refused: {' '.join(str(error).split())}"
            self.notifier.status(self.status_line())
            self.notifier.ready()
            return False
        log.info("reload: the heads are stopped and the new configuration is started")
        return True

    def request_reload(self) -> None:
        """Ask ``supervise`` for a reload; any thread, and signal handlers."""
        self._asked_to_reload = True

    @property
    def reload_requested(self) -> bool:
        """Whether a reload was asked for that nobody has begun."""
        return self._asked_to_reload

    def request_stop(self) -> None:
        """Ask ``supervise`` to return; any thread, and signal handlers."""
        self._asked_to_stop = True  # a handler must take no lock: the thread that it interrupts may hold it

    def stop(self) -> None:
        """Bring the rig to rest: motion first, then threads, processes and outputs; twice is allowed.

        A drone that is landing goes on landing: held, it would hover with nobody left to bring it down. ``held``
        then has the heads that were waiting for an operator's ``resume``, where they were or where they were aimed.
        """
        if not self._stopped:
            heads = [job for job in self._actuators() if isinstance(job, HeadJob)]
            self.held = frozenset(job.name for job in heads if job.held or job.aimed is not None)
        self._stopped = True
        halt([job for job in self._actuators() if not job.landing])
        if self._ready and self.successor is None:
            self.notifier.stopping()
        elif self._ready:
            self.notifier.alive()
        self._stopping.set()
        for worker in self._workers:
            worker.request_stop()
        stuck = [worker.job.name for worker in self._workers if not self._joined(worker)]
        if stuck:
            log.error("did not end within %.0f s: %s", JOIN_S, ", ".join(stuck))
        self._open.close()

    def _joined(self, worker: Worker) -> bool:
        """Wait for a worker's end, and tell the watchdog: each may take its time, and nobody supervises any more."""
        ended = worker.join(JOIN_S)
        self.notifier.alive()
        return ended

    def hold(self) -> Mapping[str, str]:
        """Stop every head and hold every drone, until ``resume``; return what failed. Any thread.

        What is lent is taken back: who has it is told when it asks for more time, and it is stopped when it is opened.
        """
        failed = halt(self._actuators())
        self.loans.end()
        return failed

    def _actuators(self) -> list[HeadJob | DroneJob]:
        return [*self.devices.heads.values(), *self.devices.drones.values()] if hasattr(self, "devices") else []

    def resume(self, devices: Collection[str]) -> None:
        """Operator's order: these heads may move, these drones follow plans from where they are; any thread."""
        for job in self._actuators():
            if job.name in devices:
                job.resume()

    def aim(self, head: str, aim: HeadAim) -> None:
        """Operator's order: this head goes there and no plan moves it before ``resume``; any thread."""
        self.devices.heads[head].aim(aim)

    def lend(self, head: str, for_s: float, *, renew: bool = False) -> Collection[str]:
        """Operator's order: stop a head, and let go of it and its camera for so long; then it is held; any thread.

        A loan that is to be renewed and is over raises InputError, a daemon that is about to end HardwareError.
        """
        if renew:
            return self.loans.renew(head, for_s)
        job = self.devices.heads[head]
        if for_s > 0.0:
            if self.successor is not None or self.stop_requested:
                raise HardwareError("the rig is being reloaded or stopped: ask again")
            halt([job])
        return self.loans.lend(job, for_s)

    @property
    def loans(self) -> Loans:
        """What other programs have of this rig now."""
        return Loans(self.config.rig, self.clock, self._workers)

    def arm(self, drone: str) -> None:
        """Operator's order: check, arm and climb to the lowest height of the box; any thread."""
        self.devices.drones[drone].arm()

    def land(self, drone: str) -> None:
        """Operator's order: land where it is; any thread."""
        self.devices.drones[drone].land()

    def rescan(self) -> None:
        """Operator's order: scan the whole floor again; any thread."""
        self.control.rescan()

    def view(self) -> View:
        """Return what is known now; any thread, once started."""
        published, heads = self.control.latest, self.devices.heads
        return View(
            rig=self.config.rig,
            state=self.control.state,
            targets=published.targets if published else (),
            delivered={
                **{name: job.frames for name, job in self.devices.cameras.items()},
                **{name: job.answers for name, job in heads.items()},
            },
            enabled=frozenset(name for name, job in heads.items() if job.enabled),
            now_s=self.clock.now_s(),
            aimed={name: aim for name, job in heads.items() if (aim := job.aimed) is not None},
            statistics=counted_of_all((self.devices.cameras, heads, self.devices.drones), self._workers),
            health={name: job.health for name, job in self.devices.drones.items() if job.health is not None},
            lent=self.loans.lent,
            flown=frozenset(name for name, job in self.devices.drones.items() if job.follows_plans),
        )

    @property
    def airborne(self) -> tuple[str, ...]:
        """The drones that did not stand on the ground when they were heard of last; any thread, once started.

        A link that is lost brings no drone down: what was in the air before counts as in the air.
        """
        grounded = (FlightState.GROUND, None)
        return tuple(name for name, job in self.devices.drones.items() if job.flight not in grounded)

    @property
    def stop_requested(self) -> bool:
        """Whether somebody or something asked the daemon to end."""
        return self._asked_to_stop or self._stopping.is_set()

    def status_line(self) -> str:
        """Return the state of the rig in one line."""
        return status_line(self.config.rig, self.control, self.remark)

    def _beating(self) -> bool:
        """Tell whether every thread that is still at work has done a turn lately."""
        beats_s = [self.control.beat_s, *(worker.beat_s for worker in self._workers if not worker.ended)]
        return self.clock.now_s() - min(beats_s) < BEAT_LIMIT_S

    def _run_control(self) -> None:
        try:
            while not self._stopping.wait(LEAST_TICK_S):
                self._news.wait(TICK_S - LEAST_TICK_S)
                self._news.clear()
                self.control.tick()
        except BaseException as error:
            log_failure(log, "control", error)
            self._control_failure = error
            self._stopping.set()
