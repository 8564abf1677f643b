"""SUMO's driver models as cars under test: Krauss, IDM and EIDM, each as SUMO itself runs it, on SUMO's own lane.

Nothing of a law is here. At each decision SUMO's vehicle is put where the car is, at the car's speed, and its person
where the adversary is; SUMO takes a step, and the speed that its vehicle then has is what its driver wants.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import ClassVar, NamedTuple

import libsumo
import numpy as np
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

STEP = 0.1  # s
LANE_WIDTH = 8.0  # m; a lane as wide as this has place for a person beside the vehicle, and there is no sidewalk
LANE_END = 1000.0  # m from the crossing point, both ways: further than any episode goes
LANE, EGO, PERSON = "road_0", "ego", "adversary"

NETWORK = f"""<net version="1.20">
  <location netOffset="0,0" convBoundary="0,{-LANE_END},0,{LANE_END}" origBoundary="0,0,0,0" projParameter="!"/>
  <edge id="road" from="south" to="north">
    <lane id="{LANE}" index="0" speed="100" length="{2 * LANE_END}" width="{LANE_WIDTH}"
          shape="0,{-LANE_END} 0,{LANE_END}"/>
  </edge>
  <junction id="south" type="dead_end" x="0" y="{-LANE_END}" incLanes="" intLanes="" shape="0,{-LANE_END}"/>
  <junction id="north" type="dead_end" x="0" y="{LANE_END}" incLanes="{LANE}" intLanes="" shape="0,{LANE_END}"/>
</net>"""
TYPES = """<additional>
  <vType id="ego" carFollowModel="{model}" length="{length}" width="{width}" maxSpeed="{speed}" {attention}/>
  <vType id="person" vClass="pedestrian" length="{size}" width="{size}"/>
  <route id="along" edges="road"/>
</additional>"""
OPTIONS = (
    *("--step-length", str(STEP), "--step-method.ballistic", "true"),  # speeds change evenly in a step, as in SKD
    *("--default.speeddev", "0", "--collision.action", "none", "--time-to-teleport", "-1"),
    *("--save-state.precision", "17", "--no-step-log", "true", "--no-warnings", "true", "--duration-log.disable"),
)


class Setup(NamedTuple):
    """Who meets in SUMO: model and attributes of the driver, measures of the car (m), its speed (m/s), the person."""

    model: str
    attention: str
    length: float
    width: float
    speed: float
    size: float


class Moment(NamedTuple):
    """What a driver is told at a decision: place of the car's front along the lane (m), its speed, the person's place.

    A person's place is, to SUMO, that of their front (m, North), and is given in SUMO's plane, x East and y North.
    """

    along: float
    speed: float
    x: float
    y: float


class Sumo:
    """The simulation of this process: libsumo has one, which all drivers share."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self._setup: Setup | None = None
        self._empty = ""  # state of SUMO without anybody
        self._told: tuple[Moment, ...] | None = None  # all that its driver knows; None: it has not begun

    def begin(self, setup: Setup) -> None:
        """Begin anew, at SUMO's time 0: the driver drives at their speed, and far from everybody."""
        self._told = None
        with tempfile.TemporaryDirectory(prefix="skd-sumo-") as folder:
            state = Path(folder, "state.xml")
            if setup != self._setup:
                self._load(setup, Path(folder))
                libsumo.simulation.saveState(str(state))
                self._setup, self._empty = setup, state.read_text(encoding="utf-8")
            state.write_text(self._empty, encoding="utf-8")
            libsumo.simulation.loadState(str(state))
        libsumo.vehicle.add(EGO, "along", EGO, departPos="100", departSpeed=str(setup.speed))
        libsumo.person.add(PERSON, "road", 1.0, typeID="person")
        libsumo.person.appendWalkingStage(PERSON, ["road"], 2 * LANE_END)
        libsumo.person.setSpeed(PERSON, 0.0)  # they walk in SKD, and not in SUMO
        libsumo.simulationStep()
        self._told = ()

    def tell(self, setup: Setup, told: tuple[Moment, ...]) -> None:
        """Have its driver know this, in this order, and nothing else."""
        if setup == self._setup and told is self._told:
            return
        self.begin(setup)
        for moment in told:
            self.step(moment)
        self._told = told

    def decide(self, now: Moment, told: tuple[Moment, ...]) -> float:
        """Return the speed (m/s) that the driver wants a step later, who then knows `told`."""
        self._told = None  # as long as it is not known what came of the step
        speed = self.step(now)
        self._told = told
        return speed

    def step(self, now: Moment) -> float:
        """Tell the driver where everybody is; return the speed (m/s) that they want to have a step later.

        SUMO moves the person at the end of a step, so this decision goes by where they were at the one before. Their
        angle is said (North), or it would follow from where they were: who faces the car is a length nearer or further.

        Raises:
            RuntimeError: SUMO has taken the vehicle away.
        """
        libsumo.person.moveToXY(PERSON, "road", now.x, now.y, angle=0.0, keepRoute=2)
        libsumo.vehicle.moveTo(EGO, LANE, now.along)
        libsumo.vehicle.setPreviousSpeed(EGO, now.speed)
        libsumo.simulationStep()
        speed = float(libsumo.vehicle.getSpeed(EGO))
        if speed < 0.0:  # its value for no vehicle
            raise RuntimeError(f"SUMO has no vehicle after a step from {now}")
        return speed

    def _load(self, setup: Setup, folder: Path) -> None:
        files = folder / "road.net.xml", folder / "types.add.xml"
        for file, text in zip(files, (NETWORK, TYPES.format(**setup._asdict())), strict=True):
            file.write_text(text, encoding="utf-8")
        options = ["--net-file", str(files[0]), "--additional-files", str(files[1]), *OPTIONS]
        if libsumo.isLoaded():
            libsumo.load(options)
        else:
            libsumo.start(["sumo", *options])


SUMO = Sumo()


class SumoDriver:
    """A driver of SUMO's, in the simulation that all drivers of a process share.

    A driver is what they have been told, and that is kept here. Where the simulation's driver knows something else, as
    after another object was asked, SUMO begins anew and is told all of it again. (EIDM has a memory by its law, but
    SUMO's other vehicles, too, carry more than their speed.)
    """

    control_period = STEP
    model: ClassVar[str]
    attention: ClassVar[str]
    """Attributes by which SUMO's driver errs at random; all are 0 here."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take measures and speed from the scenario; the driver draws nothing.

        Raises:
            UsageError: the road has curves, or the adversary is no disc.
        """
        if not scenario.road.straight:
            raise UsageError(f"sumo_drivers knows straight roads only; that of scenario {scenario.name} has curves")
        car, radius = scenario.car, scenario.adversary.radius
        if radius is None:
            raise UsageError(
                f"sumo_drivers puts a person on the lane, and the adversary of scenario {scenario.name} is a "
                f"{scenario.adversary.kind}"
            )
        self._front, self._radius = car.front, radius
        measures = car.front + car.rear, car.width, car.start_speed, 2.0 * radius
        self._setup = Setup(self.model, self.attention, *measures)
        self._told: tuple[Moment, ...] = ()
        SUMO.begin(self._setup)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²) with which the car has, a step later, the speed that SUMO's driver wants."""
        SUMO.tell(self._setup, self._told)
        now = Moment(LANE_END + car.y + self._front, car.speed, adversary.x, adversary.y + self._radius)
        self._told = (*self._told, now)
        return (SUMO.decide(now, self._told) - car.speed) / STEP


class Krauss(SumoDriver):
    """SUMO's default driver (Krauß 1998): drives so that they could stop if whoever is ahead braked."""

    model, attention = "Krauss", 'sigma="0"'


class Idm(SumoDriver):
    """SUMO's Intelligent Driver Model (Treiber, Hennecke and Helbing 2000)."""

    model, attention = "IDM", ""


class Eidm(SumoDriver):
    """SUMO's Extended Intelligent Driver Model (Salles, Kaufmann and Reuss 2020), with its memory."""

    model, attention = "EIDM", 'sigmaleader="0" sigmagap="0" sigmaerror="0"'
