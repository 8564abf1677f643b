"""Forms of tracks in files of others: each is read with its values, or named with the reason; none spoils another."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from common import refused
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.tracks import RecordingFrame, Track
from skd_evaluator.extensions.exchange.imports import UnusableError, trajectory_of
from skd_evaluator.extensions.exchange.readers import ImportRequest, listing, read_sources
from skd_sim import UsageError, load_scenario

TIMED = '<TimeReference><Timing domainAbsoluteRelative="absolute" scale="1" offset="0"/></TimeReference>'
ROAD = """<OpenDRIVE><road id="7" length="120"><planView>
<geometry s="0" x="10" y="20" hdg="0" length="50"><line/></geometry>
<geometry s="50" x="60" y="20" hdg="0" length="50"><arc curvature="0.02"/></geometry>
<geometry s="100" x="0" y="0" hdg="0" length="10"><spiral curvStart="0.02" curvEnd="0.02"/></geometry>
<geometry s="110" x="5" y="6" hdg="1.5707963267948966" length="10"><paramPoly3 pRange="normalized" aU="0" bU="10" cU="0"
 dU="0" aV="0" bV="0" cV="4" dV="0"/></geometry></planView>
<lanes><laneOffset s="0" a="1" b="0" c="0" d="0"/><laneSection s="0"><right>
<lane id="-1"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane>
<lane id="-2"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road></OpenDRIVE>"""


def world(x: float, y: float, **more: object) -> str:
    further = "".join(f' {key}="{value}"' for key, value in more.items())
    return f'<Position><WorldPosition x="{x}" y="{y}"{further}/></Position>'


LINE = "".join(f'<Vertex time="{t}">{world(1.4 * t - 2.8, 1)}</Vertex>' for t in range(5))
"""Along y = 1 from x = −2.8 to 2.8 m in 4 s."""


def follows(shape: str, name: str = "Walker", timed: str = TIMED, **attributes: str) -> str:
    further = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return (
        f'<ManeuverGroup><Actors><EntityRef entityRef="{name}"/></Actors><Maneuver><Event><Action><PrivateAction>'
        f"<RoutingAction><FollowTrajectoryAction{further}><TrajectoryRef><Trajectory><Shape>{shape}</Shape></Trajectory>"
        f"</TrajectoryRef>{timed}</FollowTrajectoryAction></RoutingAction></PrivateAction></Action></Event></Maneuver>"
        "</ManeuverGroup>"
    )


def speed(value: float, name: str = "Walker", how: str = 'dynamicsShape="step" value="0"') -> str:
    return (
        f'<Init><Actions><Private entityRef="{name}"><PrivateAction><LongitudinalAction><SpeedAction>'
        f"<SpeedActionDynamics {how}/><SpeedActionTarget>"
        f'<AbsoluteTargetSpeed value="{value}"/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>'
        "</Private></Actions></Init>"
    )


def xosc(folder: Path, board: str, *, about: str = "own", parameters: str = "") -> Path:
    path = folder / "a.xosc"
    path.write_text(
        f'<OpenSCENARIO><FileHeader description="{about}"/><ParameterDeclarations>{parameters}</ParameterDeclarations>'
        '<RoadNetwork><LogicFile filepath="road.xodr"/></RoadNetwork><Entities>'
        '<ScenarioObject name="Walker"><Pedestrian pedestrianCategory="pedestrian"/></ScenarioObject>'
        f'<ScenarioObject name="Ego"/></Entities><Storyboard>{board}</Storyboard></OpenSCENARIO>'
    )
    return path


def track(path: Path, name: str | None = "Walker") -> Track:
    (source,) = read_sources([path], ImportRequest(name))
    return source.found


PARAMETERS = "".join(
    f'<ParameterDeclaration name="{name}" value="{value}"/>'
    for name, value in (("half", "2.8"), ("halfway", "0.0"), ("who", "Walker"), ("left", "${-$half}"))
)


@pytest.mark.parametrize(
    ("x", "at"),
    [
        ("$left", -2.8),
        ("${-$half + 2 * $halfway}", -2.8),
        ("${round(pow(2, 3) / 3) - 5.8}", -2.8),
        ("${-2.8 * min(1, pi)}", -2.8),
    ],
)
def test_parameters_and_expressions_are_put_in(tmp_path: Path, x: str, at: float):
    board = follows(f"<Polyline>{LINE.replace('-2.8', x, 1)}</Polyline>", "$who")
    found = track(xosc(tmp_path, board, parameters=PARAMETERS))
    assert found.places[:, 0] == pytest.approx([at, -1.4, 0.0, 1.4, 2.8])


def test_a_file_for_carla_is_turned_over_and_that_is_said(tmp_path: Path):
    found = track(xosc(tmp_path, follows(f"<Polyline>{LINE}</Polyline>"), about="CARLA: a crossing"))
    assert found.places[:, 1] == pytest.approx(-np.ones(5))
    assert found.notes == ("y turned over, for CARLA's points right",)


def test_a_nurbs_is_the_circle_that_it_draws(tmp_path: Path):
    """A quarter of a circle of radius 5 about the origin, as every textbook has it."""
    points = [(0, 5, 0, 1), (2, 5, 5, math.sqrt(0.5)), (4, 0, 5, 1)]
    inner = "".join(f'<ControlPoint time="{t}" weight="{w}">{world(x, y)}</ControlPoint>' for t, x, y, w in points)
    knots = "".join(f'<Knot value="{value}"/>' for value in (0, 0, 0, 1, 1, 1))
    found = track(xosc(tmp_path, follows(f'<Nurbs order="3">{inner}{knots}</Nurbs>')))
    assert np.hypot(*found.places.T) == pytest.approx(np.full(len(found.times), 5.0))
    assert (found.times[0], found.times[-1]) == pytest.approx((0.0, 4.0))
    assert found.places[-1] == pytest.approx([0.0, 5.0], abs=1e-6)


def test_a_clothoid_without_change_is_an_arc_at_its_speed(tmp_path: Path):
    shape = f'<Clothoid curvature="0.1" curvaturePrime="0" length="{5 * math.pi}">{world(0, 0, h=0)}</Clothoid>'
    found = track(xosc(tmp_path, speed(2.0) + follows(shape, timed="")))
    assert found.places[-1] == pytest.approx([10.0, 10.0], abs=1e-5)
    assert found.times[-1] == pytest.approx(2.5 * math.pi, abs=1e-4)
    assert "at 2 m/s" in found.form


def test_lane_positions_are_places_on_the_opendrive(tmp_path: Path):
    (tmp_path / "road.xodr").write_text(ROAD)
    at = [
        '<LanePosition roadId="7" laneId="-1" s="20"/>',  # 1 − 1.5 m to the left of the line
        '<LanePosition roadId="7" laneId="-2" s="20" offset="0.5"/>',  # 1 − 3 − 1 + 0.5
        f'<RoadPosition roadId="7" s="{50 + 25 * math.pi / 2}" t="2"/>',  # an eighth of a circle of radius 50
        '<RoadPosition roadId="7" s="100" t="0"/>',
        '<RoadPosition roadId="7" s="110" t="0"/>',  # where the next piece begins
        '<RoadPosition roadId="7" s="115" t="0"/>',  # u = 5 and v = 1, turned to the left
    ]
    line = "".join(f'<Vertex time="{9 * n}"><Position>{one}</Position></Vertex>' for n, one in enumerate(at))
    found = track(xosc(tmp_path, follows(f"<Polyline>{line}</Polyline>")))
    half = math.sqrt(0.5)
    places = [[30.0, 19.5], [30.0, 17.5], [60.0 + 48.0 * half, 70.0 - 48.0 * half], [0.0, 0.0], [5.0, 6.0], [4.0, 11.0]]
    assert found.places == pytest.approx(np.array(places))


@pytest.mark.parametrize(
    ("how", "until"),
    [
        ('dynamicsShape="step" value="0" dynamicsDimension="time"', 5.6 / 2),
        ('dynamicsShape="linear" value="4" dynamicsDimension="rate"', 0.5 + (5.6 - 0.5) / 2),  # 0.5 m in 0.5 s
        ('dynamicsShape="linear" value="0.5" dynamicsDimension="time"', 0.5 + (5.6 - 0.5) / 2),
        ('dynamicsShape="linear" value="0.5" dynamicsDimension="distance"', 0.5 + (5.6 - 0.5) / 2),
    ],
)
def test_a_speed_that_is_reached_from_rest_says_when_who_follows_is_where(tmp_path: Path, how: str, until: float):
    found = track(xosc(tmp_path, speed(2.0, how=how) + follows(f"<Polyline>{LINE}</Polyline>", timed="")))
    assert (found.times[0], found.times[-1]) == pytest.approx((0.0, until))


@pytest.mark.parametrize(
    ("board", "says"),
    [
        (speed(1.4), "moves by SpeedAction; read are trajectories"),
        ("", "nothing in the file moves it"),
        (follows('<Nurbs order="4"><Knot value="0"/></Nurbs>'), "a NURBS of order 4 with 0 control points and 1 knots"),
        (follows(f"<Polyline>{LINE}</Polyline>", timed=""), "without times (TimeReference), and not at one speed"),
        (follows(f"<Polyline>{LINE.replace('-2.8', '$x0', 1)}</Polyline>"), "parameter '$x0' is not declared"),
        (follows(f"<Polyline>{LINE}</Polyline>", initialDistanceOffset="1.5"), "begins within its trajectory"),
        (follows(f"<Polyline>{LINE.replace(' time', ' late', 1)}</Polyline>"), "a vertex has no time"),
        (follows(f"<Polyline>{LINE.replace('WorldPosition', 'RelativeWorldPosition', 1)}</Polyline>"),
         "a vertex is at a RelativeWorldPosition"),
    ],
)  # fmt: skip
def test_what_openscenario_does_not_say_is_named_and_spoils_nobody_else(tmp_path: Path, board: str, says: str):
    with refused(says):
        track(xosc(tmp_path, board))
    with pytest.raises(UsageError, match="has no object whose track is read: 'Walker'"):
        track(tmp_path / "a.xosc", None)
    other = track(xosc(tmp_path, board + follows(f"<Polyline>{LINE}</Polyline>", "Other")), "Other")
    assert len(other.times) == 5
    found = {one.name: one for one in listing([tmp_path / "a.xosc"], Damage())}
    assert says in found["Walker"].why
    assert found["Other"].why == ""


def state(tag: str, tick: int, x: float, *, y: str = "<point><x>{x}</x><y>1</y></point>") -> str:
    return f"<{tag}><time><exact>{tick}</exact></time><position>{y.format(x=x)}</position></{tag}>"


def obstacle(number: int, version: str, ticks: list[int], y: str = "<point><x>{x}</x><y>1</y></point>") -> str:
    first, *rest = ticks
    states = "".join(state("state", tick, 0.14 * tick, y=y) for tick in rest)
    inner = f"<type>pedestrian</type>{state('initialState', first, 0.14 * first)}<trajectory>{states}</trajectory>"
    if version == "2018b":
        return f'<obstacle id="{number}"><role>dynamic</role>{inner}</obstacle>'
    return f'<dynamicObstacle id="{number}">{inner}</dynamicObstacle>'


@pytest.mark.parametrize("version", ["2018b", "2020a"])
def test_commonroad_of_both_versions_is_read_whoever_else_is_in_it(tmp_path: Path, version: str):
    box = "<rectangle><center><x>{x}</x><y>1</y></center></rectangle>"
    inner = obstacle(32, version, [0, 0, *range(1, 41)])  # the first state once more
    inner += obstacle(33, version, [0, 2, 1]) + obstacle(34, version, [0, 1, 2], box)
    path = tmp_path / "a.xml"
    path.write_text(f'<commonRoad commonRoadVersion="{version}" timeStepSize="0.1">{inner}</commonRoad>')
    found = track(path, "32")
    assert (len(found.times), found.times[-1], found.places[-1, 0]) == (41, pytest.approx(4.0), pytest.approx(5.6))
    for name, says in (("33", "times fall from 0.20 to 0.10 s"), ("34", "sets of places or times are not read")):
        with pytest.raises(UsageError, match=says):
            track(path, name)


def table(path: Path, times: np.ndarray, x: np.ndarray) -> Path:
    rows = [f"{time!r},{place!r},0.0" for time, place in zip(times.tolist(), x.tolist(), strict=True)]
    path.write_text("\n".join(["t,x,y", *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("times", "x", "says"),
    [
        (np.arange(0.0, 15.0, 5.0), np.array([-4.0, 0.0, 4.0]), "a position each 5 s, longer than --longest-gap 0.5 s"),
        (np.arange(0.0, 4001.0, 100.0), np.linspace(-2.8, 2.8, 41), "a position each 100 s"),
        (np.linspace(0.0, 0.0022, 41), np.linspace(-0.01, 0.01, 41), "positions a second: are times in s?"),
        (np.linspace(0.0, 4.0, 81), np.linspace(-280.0, 280.0, 81), "are positions in m and times in s?"),
        (np.linspace(0.0, 4.0, 81), 0.07 * np.arange(81) + 0.3 * (np.arange(81) % 2), "leaps to and fro by 0.28 m"),
        (np.r_[0:2:0.1, 3:5:0.1], np.linspace(-3.0, 3.0, 40), "a gap of 1.10 s, longer than --longest-gap 0.5 s"),
    ],
    ids=["sparse", "milliseconds", "hours", "centimetres", "two publishers", "a hole"],
)
def test_times_and_units_that_cannot_be_are_left_out(tmp_path: Path, times: np.ndarray, x: np.ndarray, says: str):
    (source,) = read_sources([table(tmp_path / "a.csv", times, x)], ImportRequest())
    with refused(says, error=UnusableError):
        trajectory_of(source, RecordingFrame(), 0.5, None)


def test_who_crosses_twice_is_cut_to_the_crossing_of_the_scenario(tmp_path: Path):
    """To the West at 3 s, to the East at 29 s; and at 37 s to the West once more."""
    times = np.linspace(0.0, 40.0, 401)
    x = np.interp(times, [0, 6, 26, 32, 34, 40], [4, -4, -4, 4, 4, -4])
    (source,) = read_sources([table(tmp_path / "a.csv", times, x)], ImportRequest())
    found = trajectory_of(source, RecordingFrame(), 0.5, load_scenario("crossing"))
    assert "crosses 3 times, taken is the first eastwards, at 29.0" in found.cut
    assert found.places[0, 0] < 0.0 < found.places[-1, 0]
    assert (np.diff(found.places[:, 0]) >= 0.0).all()


def test_a_trace_of_osi_is_read_as_its_mcap_is(tmp_path: Path):
    from osi3.osi_groundtruth_pb2 import GroundTruth
    from osi3.osi_sensorview_pb2 import SensorView

    def written(path: Path, kind: type) -> Path:
        with path.open("wb") as stream:
            for tick in range(41):
                message = kind()
                truth = message.global_ground_truth if kind is SensorView else message
                truth.timestamp.seconds, truth.timestamp.nanos = divmod(tick * 100_000_000, 10**9)
                one = truth.moving_object.add()
                one.id.value, one.base.position.x, one.base.position.y = 9, 0.14 * tick - 2.8, 1.0
                data = message.SerializeToString()
                stream.write(len(data).to_bytes(4, "little") + data)
        return path

    for path in (written(tmp_path / "a.osi", GroundTruth), written(tmp_path / "a_sv_b.osi", SensorView)):
        found = track(path, "9")
        assert found.places[:, 0] == pytest.approx(np.linspace(-2.8, 2.8, 41))
    cut = tmp_path / "cut.osi"
    cut.write_bytes((tmp_path / "a.osi").read_bytes()[:-7])
    damage = Damage(skip=True)
    (source,) = read_sources([cut], ImportRequest("9"), damage)
    assert (len(source.found.times), "cut short" in damage.lines[0]) == (40, True)
    (tmp_path / "a.txt").write_text("no scenario")
    with pytest.raises(UsageError, match=r"is of no format that is read; files end in \.xosc"):
        read_sources([tmp_path / "a.txt"], ImportRequest())


def test_the_command_lists_and_cuts(tmp_path: Path, skd_here):
    table(tmp_path / "a.csv", np.linspace(10.0, 14.0, 81), np.linspace(-2.8, 2.8, 81))
    done = skd_here("import", "a.csv", "--list", "--json")
    ((one,),) = json.loads(done.stdout)["files"].values()
    assert (one["name"], one["count"], one["begins"], one["ends"]) == ("a", 81, 10.0, 14.0)
    done = skd_here("import", "a.csv", "--from", 11, "--to", 13, "--out", "out", "--json")
    (one,) = json.loads(done.stdout)["files"]
    assert (one["positions"], one["starts"]) == (41, pytest.approx(11.0))
